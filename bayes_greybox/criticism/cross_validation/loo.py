"""Leave-one-out from one run: closed forms given η, Pareto-smoothed importance sampling, exact refits."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_greybox.criticism.convergence import convergence
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.sampling import RunOptions, sample_posterior

from .fold_densities import fold_densities, fold_parameters
from .folds import Folds
from .psis import count_draws, khat_threshold, log_mean, relative_efficiency, smoothed
from .row_densities import kept_densities, row_densities

Refit = Callable[[Posterior, str, list[int]], Posterior]
"""(posterior, equation, observations) -> posterior of that equation without these observations."""

WEIGHTED_NOTE = (
    "Noise(tails=...) gave each row its weight by its own residual, which a prediction cannot know: elpd is too high, "
    "and compares with that of fits with the same tails alone."
)
"""Warning about the densities of rows that the noise weights by their own residuals."""


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
        lines = [
            f"elpd {self.elpd:.2f} ± {self.se:.2f} nats over {self.words}, {self.p_eff:.1f} effective sampled "
            f"parameters, worst Pareto k {self.worst_k:.2f}, {self.refits} exact refits",
            *(f"- {note}" for note in self.notes),
        ]
        return "\n".join(lines)


@dataclass(frozen=True)
class Estimates:
    """Values of the folds of one equation, [n_fold] each: elpd, log of the plain mean density, k̂, and if refitted."""

    elpd: Float[np.ndarray, " n_fold"]
    log_mean: Float[np.ndarray, " n_fold"]
    khat: Float[np.ndarray, " n_fold"]
    refitted: Bool[np.ndarray, " n_fold"]
    r_eff: float


def refit_without(posterior: Posterior, equation: str, rows: Sequence[int], progress: bool = False) -> Posterior:
    """Run NUTS again without some observations of one equation; all that was fixed before sampling stays as it was.

    Observations are rows of the data, or whitened coefficients if R is singular.
    """
    without = {equation: posterior.equations[equation].without(rows)}
    options = RunOptions("Fitting without what is left out", programs=posterior.programs)
    return sample_posterior(
        posterior.model, posterior.data, posterior.sampling, progress=progress, equations=without, options=options
    )


def leave_folds_out(
    posterior: Posterior, folds: Folds | None, at_most: int | None, refit: Refit | None, max_refits: int, progress: bool
) -> Loo:
    """Leave folds out, single observations if `folds` is None, by importance sampling over the draws of one run.

    elpd_F = log Σ_s w_Fs p(y_F | y₋F, η_s), with w_Fs ∝ 1/p(y_F | y₋F, η_s) Pareto-smoothed (Vehtari et al. 2024;
    Bürkner, Gabry & Vehtari 2021, section 2.3, for models whose observations are not independent given η). Arguments
    are those of `cross_validate`; the `pointwise` values are comparable between models of the same data.
    """
    posterior.require_rows("Leave-one-out and other folds are found")
    n_draw = count_draws(posterior, at_most)

    def blocks(run: Posterior, name: str, index: np.ndarray | None = None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        stored = kept_densities(run, name) if folds is None and index is None and at_most is None else None
        if stored is not None:
            return iter([(np.arange(stored.shape[1]), stored)])
        if folds is None:
            return row_densities(posterior, name, run.draws(name, at_most), index)
        return fold_densities(posterior, name, fold_parameters(run, name, at_most), folds.members[name], index)

    estimates = {}
    for name in posterior.equations:
        r_eff = relative_efficiency(posterior, name, n_draw)
        parts = [smoothed(part, -part, r_eff) for _, part in blocks(posterior, name)]
        elpd, mean, khat = map(np.concatenate, zip(*parts, strict=True))
        estimates[name] = Estimates(elpd, mean, khat, np.zeros(len(elpd), bool), r_eff)
    threshold = khat_threshold(n_draw)
    flagged = [(name, int(i)) for name, each in estimates.items() for i in np.flatnonzero(~(each.khat <= threshold))]
    what = "observations" if folds is None else {"block": "blocks", "trajectory": "trajectories"}[folds.scheme]
    total = sum(len(each.elpd) for each in estimates.values())
    share = f"{len(flagged)} of {total} {what} have Pareto k above {threshold:.2f}"
    notes = [*([] if folds is None else folds.notes), *([WEIGHTED_NOTE] if weighted(posterior) else [])]
    if flagged and refit is not None and len(flagged) <= max_refits:
        warnings: list[str] = []
        for name, i in flagged:
            rows = [i] if folds is None else folds.members[name][i].tolist()
            about = f"observation {i}" if folds is None else f"{folds.scheme} {i}"
            without = refitted_without(posterior, name, rows, refit, progress, about, warnings)
            ((_, values),) = blocks(without, name, np.array([i]))
            estimates[name].elpd[i] = log_mean(values)[0]
            estimates[name].refitted[i] = True
        notes += [f"{share}; their values come from exact refits.", *warnings]
    elif flagged:
        limit = "" if refit is None else f", more than max_refits={max_refits}"
        notes.append(f"{share}{limit}, and were not refitted: elpd and its standard error are not reliable.")
    return result(estimates, threshold, notes, folds)


def refitted_without(
    posterior: Posterior, equation: str, rows: list[int], refit: Refit, progress: bool, about: str, notes: list[str]
) -> Posterior:
    """Fit again without some observations, and add a note if that run has not converged."""
    if refit is refit_without:
        without = refit_without(posterior, equation, rows, progress=progress)
    else:
        without = refit(posterior, equation, rows)
    verdict = convergence(without)
    if not verdict.mixed:
        notes.append(f"The refit without {about} of {equation!r} has not converged: {verdict.reasons[0]}")
    return without


def weighted(posterior: Posterior) -> bool:
    """Return True if the noise weights rows by their residuals, so that a row influences its own prediction."""
    noise = posterior.model.noise
    asked, estimates = getattr(noise, "tails", None), getattr(noise, "found", None)
    return asked is not None and (estimates is None or any("degrees" in each for each in estimates.values()))


def result(estimates: Mapping[str, Estimates], threshold: float, notes: Sequence[str], folds: Folds | None) -> Loo:
    """Join the values of all equations."""
    pointwise, mean, khat, refitted = (
        np.concatenate([getattr(each, field) for each in estimates.values()])
        for field in ("elpd", "log_mean", "khat", "refitted")
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
        notes=tuple(notes),
        **({} if folds is None else {"scheme": folds.scheme, "block": folds.block, "words": folds.words}),
    )
