"""Leave-one-out from one run: closed forms given η, Pareto-smoothed importance sampling, exact refits."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_greybox.criticism.convergence import convergence
from bayes_greybox.inference.posterior import Posterior

from .fold_densities import fold_densities, fold_parameters
from .folds import Folds
from .psis import count_draws, khat_threshold, log_mean, relative_efficiency, smoothed
from .refits import refit_without
from .row_densities import kept_densities, log_likelihood_group, pointwise_loo, row_densities
from .weighted_rows import NOTE, weighted

__all__ = ["Loo", "leave_folds_out", "log_likelihood_group", "loo", "pointwise_loo", "refitted_without", "result"]

Refit = Callable[[Posterior, str, list[int]], Posterior]
"""(posterior, equation, observations) -> posterior of that equation without these observations."""


@dataclass(frozen=True)
class Loo:
    """Cross-validation of one model; equations one after the other.

    What is left out at once, a fold, is one observation, or what `scheme` says.

    Attributes:
        elpd: Expected log predictive density, summed over the folds, in nats.
        se: Its standard error from the scatter over folds, √(n var). It takes them as independent: for single rows
            of dense time series it is too small.
        p_eff: Effective number of sampled parameters, Σ log mean p(y_F | y₋F, η) − elpd. θ and f are
            integrated out of both parts, so it counts what the data still say about η and γ.
        worst_k: Largest Pareto k̂ among the folds that rely on importance sampling.
        n_bad: Folds that still have k̂ above the threshold.
        threshold: min(1 − 1/log₁₀ S, 0.7) for S draws (Vehtari, Simpson, Gelman, Yao & Gabry 2024).
        pointwise: elpd of each fold; user's units.
        khat: Pareto k̂ of each fold as measured, also where a refit replaced it.
        refitted: Folds whose elpd comes from an exact refit.
        equation: Index of the equation each fold belongs to.
        row: Its index within the equation.
        r_eff: Relative efficiency of the draws, one for each equation.
        notes: Sentences on what to beware of, and on how the folds were chosen.
        scheme: "loo", "block", "trajectory" or "future".
        block: Rows of a block, time stamps of a step into the future; None where there is neither.
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


def loo(
    posterior: Posterior,
    at_most: int | None = None,
    *,
    refit: Refit | None = refit_without,
    max_refits: int = 10,
    progress: bool = True,
) -> Loo:
    """Leave-one-out by Pareto-smoothed importance sampling over the draws of one run.

    elpd_i = log Σ_s w_is p(y_i | y₋ᵢ, η_s), with w_is ∝ 1/p(y_i | y₋ᵢ, η_s) smoothed (Vehtari et al. 2024;
    Bürkner, Gabry & Vehtari 2021, section 2.3, for models whose observations are not independent given η).

    Args:
        posterior: Fitted model.
        at_most: Thin the draws evenly to this many; None: all.
        refit: How to fit again without the observations whose k̂ is above the threshold; None: not at all.
        max_refits: With more such observations than this there are no refits, and `notes` says so.
        progress: Whether refits show their progress.

    Returns:
        The result; its `pointwise` values are comparable between models of the same data.

    Raises:
        InputError: Fewer than 25 draws.
    """
    return leave_folds_out(posterior, None, at_most, refit=refit, max_refits=max_refits, progress=progress)


def leave_folds_out(
    posterior: Posterior,
    folds: Folds | None,
    at_most: int | None = None,
    *,
    refit: Refit | None = refit_without,
    max_refits: int = 10,
    progress: bool = True,
) -> Loo:
    """`loo` with several observations left out at once: w_Fs ∝ 1/p(y_F | y₋F, η_s).

    Args:
        posterior: Fitted model.
        folds: What is left out together; None: single observations.
        at_most: As for `loo`.
        refit: As for `loo`.
        max_refits: As for `loo`.
        progress: As for `loo`.

    Raises:
        InputError: Fewer than 25 draws.
    """
    posterior.require_rows("Leave-one-out and other folds are found")
    n_draw = count_draws(posterior, at_most)
    names = tuple(posterior.equations)

    def blocks(run: Posterior, name: str, index: np.ndarray | None = None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        kept = kept_densities(run, name) if folds is None and index is None and at_most is None else None
        if kept is not None:
            return iter([(np.arange(kept.shape[1]), kept)])
        if folds is None:
            return row_densities(posterior, name, run.draws(name, at_most), index)
        return fold_densities(posterior, name, fold_parameters(run, name, at_most), folds.members[name], index)

    efficiency = {name: relative_efficiency(posterior, name, n_draw) for name in names}
    parts = {name: [smoothed(part, -part, efficiency[name]) for _, part in blocks(posterior, name)] for name in names}
    elpd, spread, khat = ({name: np.concatenate([part[i] for part in parts[name]]) for name in names} for i in range(3))
    threshold = khat_threshold(n_draw)
    flagged = [(name, int(i)) for name in names for i in np.flatnonzero(~(khat[name] <= threshold))]
    refitted = {name: np.zeros(len(elpd[name]), bool) for name in names}
    what = "observations" if folds is None else {"block": "blocks", "trajectory": "trajectories"}[folds.scheme]
    found = f"{len(flagged)} of {sum(map(len, elpd.values()))} {what} have Pareto k above {threshold:.2f}"
    notes = [*([] if folds is None else folds.notes), *([NOTE] if weighted(posterior) else [])]
    if flagged and refit is not None and len(flagged) <= max_refits:
        warnings: list[str] = []
        for name, i in flagged:
            rows = [i] if folds is None else folds.members[name][i].tolist()
            about = f"observation {i}" if folds is None else f"{folds.scheme} {i}"
            without = refitted_without(posterior, name, rows, refit, progress, about, warnings)
            ((_, values),) = blocks(without, name, np.array([i]))
            elpd[name][i] = log_mean(values)[0]
            refitted[name][i] = True
        notes += [f"{found}; their values come from exact refits.", *warnings]
    elif flagged:
        limit = "" if refit is None else f", more than max_refits={max_refits}"
        notes.append(f"{found}{limit}, and were not refitted: elpd and its standard error are not reliable.")
    return result(elpd, spread, khat, refitted, threshold, efficiency, notes, folds)


def refitted_without(
    posterior: Posterior, equation: str, rows: list[int], refit: Refit, progress: bool, about: str, notes: list[str]
) -> Posterior:
    """Fit again without some observations, and note it if that run has not converged."""
    if refit is refit_without:
        without = refit_without(posterior, equation, rows, progress=progress)
    else:
        without = refit(posterior, equation, rows)
    verdict = convergence(without)
    if not verdict.mixed:
        notes.append(f"The refit without {about} of {equation!r} has not converged: {verdict.reasons[0]}")
    return without


def result(
    elpd: dict[str, np.ndarray],
    spread: dict[str, np.ndarray],
    khat: dict[str, np.ndarray],
    refitted: dict[str, np.ndarray],
    threshold: float,
    efficiency: dict[str, float],
    notes: list[str],
    folds: Folds | None,
) -> Loo:
    """The result from values by equation."""
    pointwise, mean, k, exact = (np.concatenate(list(a.values())) for a in (elpd, spread, khat, refitted))
    return Loo(
        elpd=float(pointwise.sum()),
        se=float(np.sqrt(len(pointwise) * np.var(pointwise, ddof=1))),
        p_eff=float(mean.sum() - pointwise.sum()),
        worst_k=float(np.max(k[~exact], initial=-np.inf)),
        n_bad=int(np.sum(~(k[~exact] <= threshold))),
        threshold=threshold,
        pointwise=pointwise,
        khat=k,
        refitted=exact,
        equation=np.concatenate([np.full(len(a), i) for i, a in enumerate(elpd.values())]),
        row=np.concatenate([np.arange(len(a)) for a in elpd.values()]),
        r_eff=tuple(efficiency.values()),
        notes=tuple(notes),
        **({} if folds is None else {"scheme": folds.scheme, "block": folds.block, "words": folds.words}),
    )
