"""Convergence of the sampler: one verdict, with reasons in plain words and what to try."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jaxtyping import Array, Float

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.remembering import remembered
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.gp.kernels import KERNELS, Kernel, log_spectral_density
from bayes_greybox.running.compiling import compiled

from .judged import in_words, judged

MAX_R_HAT, MIN_ESS, MIN_E_BFMI, MAX_TREE_DEPTH, SATURATED_SHARE = 1.01, 400, 0.3, 10, 0.01
"""Limits of the criteria of `convergence`; at most `SATURATED_SHARE` of the draws may reach the tree depth."""

SHORT_SHARE = 0.75
"""Share of `MIN_ESS` from which on effective sample sizes are only somewhat too small: the Monte Carlo standard error
is then at most 15 % larger than at `MIN_ESS`."""

NEGLIGIBLE_AMPLITUDE, QUANTILE = 0.1, 0.05
"""Multiple of σ below which length scales of f follow their prior and are not judged; quantile of the others that
the basis must resolve."""

UNSEEN_SQUARE, FINER_FACTOR, THINNED = 1.0, 4, 200
"""Mean square that finer features would add to f, over σ² and summed over the rows, below which the rows cannot show
them: a single feature of this size gains half a nat. Most features considered, over those of the basis; draws used."""

WIDEST, LARGEST_BASIS = 4.0, 400
"""Widest domain that is recommended, and most features of automatic refits.

There, images behind the walls multiply the prior variance of f by nearly the same factor everywhere on the data, to
within 9 % whatever the length scale, which the amplitude compensates; at boundary 2 it is up to 34 %."""

SHORT_VERDICT = "Converged, but more draws would make the ends of intervals more precise:"
"""Verdict on chains that agree and have somewhat too few effective draws."""

_log_density = compiled(log_spectral_density, static_argnums=0)
"""Compiled, since operation by operation all draws take half a second."""


@dataclass(frozen=True)
class Verdict:
    """A judgement of a fit.

    Attributes:
        ok: True if every check passed.
        reasons: Failed checks, one sentence each with what to try; empty if `ok`.
        short: True if the only failures are effective sample sizes slightly below the limit.
    """

    ok: bool
    reasons: tuple[str, ...] = ()
    short: bool = False

    @property
    def mixed(self) -> bool:
        """True if the chains agree, so that the fit can be relied on except for its last digits."""
        return self.ok or self.short

    def __str__(self) -> str:
        if self.ok:
            return "Converged: every check passed."
        verdict = SHORT_VERDICT if self.short else "Not converged; do not rely on this fit:"
        return "\n- ".join([verdict, *self.reasons])


@remembered
def convergence(posterior: Posterior) -> Verdict:
    """Judge a run by the criteria of Vehtari et al. 2021 and Betancourt 2016.

    Rank-normalised R̂ ≤ 1.01, bulk and tail ESS ≥ 400 (sampled hyperparameters, θ and γ), no divergences,
    E-BFMI ≥ 0.3 in every chain, and a tree depth that at most 1 % of the draws reach. On the feature path the basis
    must also resolve the 5 % quantile of each posterior length scale (Riutort-Mayol et al. 2023, section 4.3), unless
    the discrepancy is negligible beside the noise. A domain that is narrow for long ones (see `boundary_needed`) is
    acceptable: it makes the prior variance of f uneven by a third at most.

    The weights or values of f are not judged: given the hyperparameters they are drawn exactly and independently, and
    the largest of hundreds of R̂ would exceed 1.01 by chance. A quantity that never varies, such as the coefficient of
    a term that no draw includes, has no R̂ and is left out. See `judged.judged` for the quantities.

    Effective sample sizes show how precise means (bulk) and ends of intervals (tail) are, and 400 is a rule of thumb:
    chains that fail only this, and have three quarters of it, are `short`.
    """
    table = convergence_table(posterior)
    table.index = pd.Index([in_words(posterior, str(name)) for name in table.index], name="variable")
    varying = table.loc[table["varies"]]
    stats = posterior.idata["sample_stats"].dataset
    n_chain, n_draw = stats.sizes["chain"], stats.sizes["draw"]
    apart, sizes = list(_agreement(varying, n_chain)), list(_sample_sizes(varying, n_chain, n_draw))
    others = [*_sampler_failures(stats), *_resolution(posterior)]
    reasons = (*apart, *sizes, *others)
    ess = varying[["ess_bulk", "ess_tail"]].to_numpy(float)
    short = bool(sizes) and not apart and not others and bool(ess.size and np.all(ess >= SHORT_SHARE * MIN_ESS))
    return Verdict(not reasons, reasons, short)


def convergence_table(posterior: Posterior) -> pd.DataFrame:
    """Return R̂, effective sample sizes and Monte Carlo error of every quantity that `convergence` judges.

    The table is indexed by variable, such as "ydot_theta[y**3]", with columns r_hat, ess_bulk, ess_tail, mcse (of the
    mean, in the unit of the variable) and varies. A quantity that takes one value in all draws has NaN.
    """
    rows = {name: (*precision_of(draws), bool(np.ptp(draws) > 0)) for name, draws in judged(posterior)}
    columns = ["r_hat", "ess_bulk", "ess_tail", "mcse", "varies"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("variable")


def precision_of(draws: Float[np.ndarray, "n_chain n_draw"]) -> tuple[float, float, float, float]:
    """Return R̂, bulk and tail effective sample size, and the Monte Carlo error of the mean; NaN without variation."""
    if not np.ptp(draws) > 0 or draws.shape[1] < 4:
        return np.nan, np.nan, np.nan, np.nan
    stats, sd = array_stats(), draws.std()
    scaled = (draws - draws.mean()) / sd
    # Chains that are each stuck at a different value have no variance within: R̂ is rightly infinite.
    with np.errstate(divide="ignore", invalid="ignore"):
        return (
            float(stats.rhat(scaled, method="rank")) if len(draws) > 1 else np.nan,
            float(stats.ess(scaled, method="bulk")),
            float(stats.ess(scaled, method="tail", prob=(0.05, 0.95))),
            sd * float(stats.mcse(scaled, method="mean")),
        )


def features_needed(posterior: Posterior, boundary: tuple[float, ...] | None = None) -> dict[str, tuple[int, ...]]:
    """Return the features per variable that the posterior length scales need, for equations whose basis has too few.

    m ≥ a L/ℓ resolves the length scale ℓ, with a from Riutort-Mayol et al. 2023, Sec. 4.2, and ℓ the 5 % quantile of
    its posterior in half-widths of the box; L are those of the domain of the fit, or of a new boundary. Nothing is
    needed if the discrepancy is negligible, as its length scales then follow their prior, or if the rows cannot show
    finer features (`UNSEEN_SQUARE`).
    """
    needed = {}
    for name, kernel, basis, lengths in _bases(posterior):
        shortest = np.quantile(lengths, QUANTILE, axis=0)
        per_variable = np.array(basis.per_variable)
        present = HilbertBasis(boundary or basis.boundary, basis.per_variable)
        required = np.ceil(kernel.features_per_unit * present.half_widths / shortest).astype(int)
        finer = np.clip(required, per_variable, FINER_FACTOR * per_variable)
        if np.any(required > per_variable) and _added_square(posterior, name, present, finer) > UNSEEN_SQUARE:
            needed[name] = tuple(np.maximum(required, per_variable).tolist())
    return needed


def boundary_needed(posterior: Posterior) -> dict[str, tuple[float, ...]]:
    """Return the boundary factors L in each direction that the posterior length scales need, if a domain is too narrow.

    L ≥ b ℓ keeps f from its images behind the walls, with b from Riutort-Mayol et al. 2023, Sec. 4.2. A domain is too
    narrow if it is so for the 5 % quantile of ℓ; the one needed suits its median, but is `WIDEST` at most. Nothing is
    needed if the discrepancy is negligible, as its length scales then follow their prior.
    """
    needed = {}
    for name, kernel, basis, lengths in _bases(posterior):
        per_length = kernel.boundary_per_length
        narrow = per_length * np.quantile(lengths, QUANTILE, axis=0) > basis.half_widths
        wider = np.minimum(per_length * np.median(lengths, axis=0), WIDEST)
        if np.any(narrow & (wider > basis.half_widths)):
            needed[name] = tuple(np.where(narrow, np.maximum(wider, basis.half_widths), basis.half_widths).tolist())
    return needed


def array_stats() -> Any:
    """Return ArviZ's statistics of plain arrays, the same in both of its generations."""
    from arviz_stats.base.array import array_stats  # three seconds, so not at the top

    return array_stats


def _agreement(table: pd.DataFrame, n_chain: int) -> Iterator[str]:
    if n_chain < 2:
        yield "There is one chain, and R̂ compares chains: run chains=4."
    r_hat = table["r_hat"].to_numpy(float)
    high = np.flatnonzero(r_hat > MAX_R_HAT)
    if high.size:
        worst = int(high[r_hat[high].argmax()])
        yield (
            f"R̂ is {_beyond(r_hat[worst], MAX_R_HAT)} for {table.index[worst]}, above {MAX_R_HAT}{_others(high)}: "
            "the chains disagree; raise tune and draws, and if it stays, look at the chains for several modes (a "
            "kernel that is not orthogonal to the dictionary makes them)."
        )


def _sample_sizes(table: pd.DataFrame, n_chain: int, n_draw: int) -> Iterator[str]:
    if n_chain * n_draw < MIN_ESS:
        yield (
            f"There are {n_chain * n_draw} draws in all, too few for an effective sample size of {MIN_ESS}: "
            f"raise draws to at least {math.ceil(2 * MIN_ESS / n_chain)} in each chain."
        )
        return
    for part in ("bulk", "tail"):
        ess = table[f"ess_{part}"].to_numpy(float)
        low = np.flatnonzero(ess < MIN_ESS)
        if low.size:
            worst = low[ess[low].argmin()]
            # Draws that would bring the worst one to the threshold, with a quarter to spare.
            needed = math.ceil(1.25 * n_draw * MIN_ESS / max(ess[worst], 1.0) / 100) * 100
            yield (
                f"The {part} effective sample size is {ess[worst]:.0f} for {table.index[worst]}, below {MIN_ESS}"
                f"{_others(low)}: raise draws to about {needed}."
            )


def _others(failed: np.ndarray) -> str:
    return f", as it is for {len(failed) - 1} more" if len(failed) > 1 else ""


def _beyond(value: float, limit: float) -> str:
    """Write a number with enough digits to show that it is above its limit: 1.0103, not 1.01, above 1.01."""
    texts = [f"{value:.{digits}g}" for digits in range(3, 9)]
    return next((text for text in texts if float(text) > limit), texts[-1])


def _sampler_failures(stats: xr.Dataset) -> Iterator[str]:
    diverging, energy = stats["diverging"].to_numpy(), stats["energy"].to_numpy()
    if count := int(diverging.sum()):
        yield (
            f"There were {count} divergences in {diverging.size} draws: parts of the posterior were not "
            "reached; raise target_accept towards 0.99."
        )
    # E-BFMI = Σ (E_n − E_{n−1})² / Σ (E_n − Ē)²  (Betancourt 2016, Eq. 22)
    spread = np.sum((energy - energy.mean(axis=1, keepdims=True)) ** 2, axis=1)
    steps = np.sum(np.diff(energy, axis=1) ** 2, axis=1)
    worst = float(np.min(steps / np.where(spread > 0, spread, np.inf)))
    if energy.shape[1] > 3 and worst < MIN_E_BFMI:
        yield (
            f"E-BFMI is {worst:.2g}, below {MIN_E_BFMI}: the sampler crosses the tails of the posterior too "
            "slowly; raise tune, or choose a prior with lighter tails."
        )
    share = float(np.mean(stats["n_steps"].to_numpy() >= 2**MAX_TREE_DEPTH - 1))
    if share > SATURATED_SHARE:
        yield (
            f"{share:.0%} of the draws used up the tree depth of {MAX_TREE_DEPTH}: the steps are far too "
            "small for the posterior's shape; raise tune, or remove terms that are nearly collinear."
        )


def _resolution(posterior: Posterior) -> Iterator[str]:
    for name, needed in features_needed(posterior).items():
        frame = posterior.equations[name].frame
        assert frame.basis is not None
        short = [v for v, m, now in zip(frame.variables, needed, frame.basis.per_variable, strict=True) if m > now]
        text = str(needed[0]) if len(set(needed)) == 1 else f"({', '.join(map(str, needed))})"
        yield (
            f"The discrepancy of {name!r} wants shorter length scales in {', '.join(map(repr, short))} than "
            f"its {frame.basis.size} features resolve: raise OrthogonalGP(features=...) to at least {text}."
        )


def _bases(posterior: Posterior) -> Iterator[tuple[str, Kernel, HilbertBasis, Float[Array, "n_draw n_var"]]]:
    """Yield equation, kernel, basis and draws of the length scales, where f has features and is not negligible."""
    gp = posterior.model.discrepancy
    if gp is None or gp.path != "hsgp":
        return
    for name, equation in posterior.equations.items():
        hyper, basis = posterior.draws(name).hyper, equation.frame.basis
        if basis is not None and np.median(hyper.amplitude) >= NEGLIGIBLE_AMPLITUDE * np.median(hyper.sigma):
            yield name, KERNELS[gp.kernel], basis, hyper.length_scale


def _added_square(posterior: Posterior, equation: str, present: HilbertBasis, per_variable: np.ndarray) -> float:
    """Return the expected square that more features add to f, over σ² and summed over the rows.

    The variance of a feature is the spectral density at its frequency: averaged over the box, f has Σ_j S(√λ_j) ⟨ψ_j²⟩.
    """
    gp, hyper = posterior.model.discrepancy, posterior.draws(equation).hyper
    assert gp is not None
    pick = np.linspace(0, len(hyper.sigma) - 1, min(THINNED, len(hyper.sigma))).astype(int)

    def variance(basis: HilbertBasis) -> np.ndarray:
        frequency = basis.frequency
        log_density = [
            _log_density(KERNELS[gp.kernel], frequency, hyper.amplitude[i] / hyper.sigma[i], length)
            for i, length in zip(pick, hyper.length_scale[pick], strict=True)
        ]
        return np.exp(np.asarray(log_density)) @ basis.mean_square

    added = variance(HilbertBasis(present.boundary, tuple(per_variable.tolist()))) - variance(present)
    return posterior.n_obs * float(np.mean(np.maximum(0.0, added)))
