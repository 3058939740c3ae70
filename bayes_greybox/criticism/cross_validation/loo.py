"""Result of cross-validation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_greybox.inference.posterior import Posterior

from .folds import Folds


@dataclass(frozen=True)
class Loo:
    """Cross-validation of one model; equations one after the other.

    A fold, left out at once, is one observation or a set of them, see `scheme`.

    Attributes:
        elpd: Expected log predictive density, summed over the folds, in nats.
        se: Standard error of `elpd` from the scatter over folds, √(n var). It assumes independent folds, and is too
            small for single rows of dense time series.
        p_eff: Effective number of sampled parameters, Σ log mean p(y_F | y₋F, η) − elpd. θ and f are integrated out of
            both parts, so it counts η and γ only.
        worst_k: Largest Pareto k̂ among the folds that rely on importance sampling.
        n_bad: Folds that still have k̂ above the threshold.
        threshold: min(1 − 1/log₁₀ S, 0.7) for S draws (Vehtari, Simpson, Gelman, Yao & Gabry 2024).
        pointwise: elpd of each fold; user's units.
        khat: Pareto k̂ of each fold before any refit.
        refitted: True for folds whose elpd comes from an exact refit.
        equation: Index of the equation of each fold.
        row: Index of the fold within the equation.
        r_eff: Relative efficiency of the draws, one for each equation.
        notes: Warnings, and sentences on the choice of folds.
        scheme: "loo", "block", "trajectory" or "future".
        block: Rows of a block, or time stamps of a step into the future; None for other schemes.
        words: The folds in words.
    """

    elpd: float
    se: float
    p_eff: float
    worst_k: float
    n_bad: int
    threshold: float
    pointwise: Float[np.ndarray, " n_fold"]
    khat: Float[np.ndarray, " n_fold"]
    refitted: Bool[np.ndarray, " n_fold"]
    equation: Int[np.ndarray, " n_fold"]
    row: Int[np.ndarray, " n_fold"]
    r_eff: tuple[float, ...]
    notes: tuple[str, ...] = ()
    scheme: str = "loo"
    block: int | None = None
    words: str = "single rows"

    @property
    def refits(self) -> int:
        """Number of exact refits."""
        return int(self.refitted.sum())

    def __str__(self) -> str:
        figures = (
            f"elpd {self.elpd:.2f} ± {self.se:.2f} nats over {self.words}, {self.p_eff:.1f} effective sampled "
            f"parameters, worst Pareto k {self.worst_k:.2f}, {self.refits} exact refits"
        )
        return "\n".join([figures, *(f"- {note}" for note in self.notes)])


class Estimates(NamedTuple):
    """Values of the folds of one equation, [n_fold] each: elpd, log of the plain mean density, k̂, and if refitted."""

    elpd: Float[np.ndarray, " n_fold"]
    log_mean: Float[np.ndarray, " n_fold"]
    khat: Float[np.ndarray, " n_fold"]
    refitted: Bool[np.ndarray, " n_fold"]
    r_eff: float


def weighted(posterior: Posterior) -> bool:
    """Return True if the noise weights rows by their residuals, so that a row influences its own prediction."""
    noise = posterior.model.noise
    asked, estimates = getattr(noise, "tails", None), getattr(noise, "found", None)
    return asked is not None and (estimates is None or any("degrees" in each for each in estimates.values()))


def joined(
    posterior: Posterior, estimates: Mapping[str, Estimates], threshold: float, notes: Sequence[str],
    folds: Folds | None,
) -> Loo:  # fmt: skip
    """Join the values of all equations; `folds` is None for single rows."""
    pointwise, mean, khat, refitted = map(np.concatenate, zip(*(each[:4] for each in estimates.values()), strict=True))
    settings = {} if folds is None else {"scheme": folds.scheme, "block": folds.block, "words": folds.words}
    before = [] if folds is None else list(folds.notes)
    if weighted(posterior):
        before.append(
            "Noise(tails=...) gave each row its weight by its own residual, which a prediction cannot know: elpd is "
            "too high, and compares with that of fits with the same tails alone."
        )
    return Loo(
        elpd=float(pointwise.sum()),
        se=float(np.sqrt(len(pointwise) * np.var(pointwise, ddof=1))),
        p_eff=float(mean.sum() - pointwise.sum()),
        worst_k=float(np.max(khat[~refitted], initial=-np.inf)),
        n_bad=int(np.sum(~(khat[~refitted] <= threshold))),
        threshold=threshold,
        pointwise=pointwise,
        khat=khat,
        refitted=refitted,
        equation=np.concatenate([np.full(len(each.elpd), i) for i, each in enumerate(estimates.values())]),
        row=np.concatenate([np.arange(len(each.elpd)) for each in estimates.values()]),
        r_eff=tuple(each.r_eff for each in estimates.values()),
        notes=(*before, *notes),
        **settings,
    )
