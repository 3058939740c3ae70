"""Leave-one-out from one run: closed forms given η, Pareto-smoothed importance sampling, exact refits."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_greybox.data.errors import InputError
from bayes_greybox.inference.posterior import Posterior

from .convergence import array_stats, convergence
from .leave_out import refit_without
from .pointwise import log_likelihood_group, pointwise_blocks, pointwise_loo

__all__ = ["Loo", "log_likelihood_group", "loo", "pointwise_loo"]

MIN_DRAWS = 25
"""Fewer draws have no tail for Pareto smoothing to fit."""

Refit = Callable[[Posterior, str, list[int]], Posterior]
"""(posterior, equation, observations) -> posterior of that equation without these observations."""


@dataclass(frozen=True)
class Loo:
    """Leave-one-out cross-validation of one model; equations one after the other.

    Attributes:
        elpd: Expected log predictive density, summed over the observations, in nats.
        se: Its standard error from the scatter over observations, √(n var). It takes them as independent: for
            dense time series it is too small.
        p_eff: Effective number of sampled parameters, Σ log mean p(y_i | y₋ᵢ, η) − elpd. θ and f are
            integrated out of both parts, so it counts what the data still say about η and γ.
        worst_k: Largest Pareto k̂ among the observations that rely on importance sampling.
        n_bad: Observations that still have k̂ above the threshold.
        threshold: min(1 − 1/log₁₀ S, 0.7) for S draws (Vehtari, Simpson, Gelman, Yao & Gabry 2024).
        pointwise: elpd of each observation; user's units.
        khat: Pareto k̂ of each observation as measured, also where a refit replaced it.
        refitted: Observations whose elpd comes from an exact refit.
        equation: Index of the equation each observation belongs to.
        row: Its index within the equation.
        r_eff: Relative efficiency of the draws, one for each equation.
        notes: Sentences on what to beware of.
    """

    elpd: float
    se: float
    p_eff: float
    worst_k: float
    n_bad: int
    threshold: float
    pointwise: Float[np.ndarray, " n_obs"]
    khat: Float[np.ndarray, " n_obs"]
    refitted: Bool[np.ndarray, " n_obs"]
    equation: Int[np.ndarray, " n_obs"]
    row: Int[np.ndarray, " n_obs"]
    r_eff: tuple[float, ...]
    notes: tuple[str, ...] = ()

    @property
    def refits(self) -> int:
        """Number of exact refits."""
        return int(self.refitted.sum())

    def __str__(self) -> str:
        lines = [
            f"elpd {self.elpd:.2f} ± {self.se:.2f} nats, {self.p_eff:.1f} effective sampled parameters, "
            f"worst Pareto k {self.worst_k:.2f}, {self.refits} exact refits",
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
    group = posterior.idata["posterior"].dataset
    n_draw = group.sizes["chain"] * group.sizes["draw"]
    n_draw = n_draw if at_most is None else min(n_draw, at_most)
    if n_draw < MIN_DRAWS:
        raise InputError(f"Leave-one-out needs at least {MIN_DRAWS} posterior draws, not {n_draw}: raise draws.")
    names = tuple(posterior.equations)
    efficiency = tuple(_relative_efficiency(posterior, name, n_draw) for name in names)
    parts = [_smoothed(posterior, name, at_most, r_eff) for name, r_eff in zip(names, efficiency, strict=True)]
    elpd, spread, khat = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    equation = np.concatenate([np.full(len(part[0]), i) for i, part in enumerate(parts)])
    row = np.concatenate([np.arange(len(part[0])) for part in parts])

    threshold = min(1 - 1 / math.log10(n_draw), 0.7)
    flagged = np.flatnonzero(~(khat <= threshold))
    refitted = np.zeros(len(elpd), bool)
    notes: list[str] = []
    found = f"{len(flagged)} of {len(elpd)} observations have Pareto k above {threshold:.2f}"
    if len(flagged) and refit is not None and len(flagged) <= max_refits:
        for i in flagged:
            name = names[equation[i]]
            elpd[i] = _exact(posterior, name, int(row[i]), at_most, refit, progress, notes)
        refitted[flagged] = True
        notes.insert(0, f"{found}; their values come from exact refits.")
    elif len(flagged):
        limit = "" if refit is None else f", more than max_refits={max_refits}"
        notes.append(f"{found}{limit}, and were not refitted: elpd and its standard error are not reliable.")
    return Loo(
        elpd=float(elpd.sum()),
        se=float(np.sqrt(len(elpd) * np.var(elpd, ddof=1))),
        p_eff=float(spread.sum() - elpd.sum()),
        worst_k=float(np.max(khat[~refitted], initial=-np.inf)),
        n_bad=int(np.sum(~(khat[~refitted] <= threshold))),
        threshold=threshold,
        pointwise=elpd,
        khat=khat,
        refitted=refitted,
        equation=equation,
        row=row,
        r_eff=efficiency,
        notes=tuple(notes),
    )


def _smoothed(
    posterior: Posterior, equation: str, at_most: int | None, r_eff: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """elpd_i, log mean p(y_i | y₋ᵢ, η) and k̂_i of each observation of one equation."""
    stats = array_stats()
    parts = []
    for _, block in pointwise_blocks(posterior, equation, posterior.draws(equation, at_most)):
        values = block.T
        log_weight = np.full(values.shape, -math.log(values.shape[1]))
        khat = np.zeros(len(values))
        # Without any spread there is nothing to smooth, and PSIS refuses.
        varies = np.ptp(values, axis=1) > 0
        if varies.any():
            log_weight[varies], khat[varies] = stats.psislw(values[varies], r_eff=r_eff, axis=-1)
        elpd = np.logaddexp.reduce(log_weight + values, axis=1)
        parts.append((elpd, np.logaddexp.reduce(values, axis=1) - math.log(values.shape[1]), khat))
    elpd, spread, khat = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return elpd, spread, khat


def _exact(
    posterior: Posterior,
    equation: str,
    row: int,
    at_most: int | None,
    refit: Refit,
    progress: bool,
    notes: list[str],
) -> float:
    """One observation by an exact refit: the mean of p(y_i | y₋ᵢ, η) over p(η | y₋ᵢ)."""
    if refit is refit_without:
        without = refit_without(posterior, equation, [row], progress=progress)
    else:
        without = refit(posterior, equation, [row])
    verdict = convergence(without)
    if not verdict.ok:
        notes.append(f"The refit without observation {row} of {equation!r} has not converged: {verdict.reasons[0]}")
    draws = without.draws(equation, at_most)
    ((_, values),) = pointwise_blocks(posterior, equation, draws, np.array([row]))
    return float(np.logaddexp.reduce(values.ravel()) - math.log(values.size))


def _relative_efficiency(posterior: Posterior, equation: str, n_draw: int) -> float:
    """Effective over actual draws, mean over hyperparameters and coefficients of the equation, at most 1."""
    group = posterior.idata["posterior"].dataset
    if group.sizes["chain"] < 2 or group.sizes["draw"] < 4:
        return 1.0
    stats, sizes = array_stats(), []
    for name in ("sigma", "amplitude", "length_scale", "theta"):
        if f"{equation}_{name}" not in group:
            continue
        values = group[f"{equation}_{name}"].to_numpy()
        for draws in np.moveaxis(values.reshape(*values.shape[:2], -1), -1, 0):
            if np.ptp(draws) > 0:
                sizes.append(float(stats.ess(draws / draws.std(), method="mean")))
    return min(1.0, float(np.mean(sizes)) / n_draw) if sizes else 1.0
