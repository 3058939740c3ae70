"""Has the sampler converged: one verdict, with reasons in plain words and what to try."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.remembering import remembered
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.gp.kernels import KERNELS, log_spectral_density
from bayes_greybox.running.compiling import compiled

from .judged import in_words, judged

MAX_R_HAT = 1.01
MIN_ESS = 400
NEAR = 0.75
"""From this share of `MIN_ESS` on, effective sample sizes that are too small are only somewhat so: the Monte Carlo
standard error, which goes with the inverse root, is then at most 15 % larger than with all of them."""

MIN_E_BFMI = 0.3
MAX_TREE_DEPTH = 10
SATURATED_SHARE = 0.01
"""Share of draws that may use up the tree depth."""

NEGLIGIBLE_AMPLITUDE = 0.1
"""Below this multiple of σ the discrepancy's length scales are those of their prior and are not judged."""

UNSEEN = 1.0
"""Mean square of what finer features would add to f, in units of σ² and summed over the rows, below which no row shows
whether it is there: a single feature of this size gains half a nat."""

FINER = 4
"""Of features that are called for, as many times those of the basis are looked at for this."""

THINNED = 200
"""Draws on which it is found."""

QUANTILE = 0.05
"""The basis must resolve all but the shortest five percent of each length scale's posterior."""

_log_density = compiled(log_spectral_density, static_argnums=0)
"""For as many draws, operation by operation takes half a second."""

WIDEST = 4.0
"""Widest domain that is called for. With it images behind the walls multiply the prior variance of f by nearly the same
everywhere on the data, to within 9 % whatever the length scale, and the amplitude takes that up; at boundary 2 it is up
to 34 %. Of a variable that f does not depend on the length scale has no upper end, but the features' cost grows."""

LARGEST_BASIS = 400
"""Automatic refits stop at this many features."""

SHORT = "Converged, but more draws would make the ends of intervals more precise:"
"""What is said of chains that agree and have somewhat too few effective draws."""


@dataclass(frozen=True)
class Verdict:
    """Whether a fit can be trusted.

    Attributes:
        ok: Whether every check passed.
        reasons: What failed, one sentence each with what to try; empty if `ok`.
        short: Whether all that failed is the size of an effective sample, and not by far.
    """

    ok: bool
    reasons: tuple[str, ...] = ()
    short: bool = False

    @property
    def mixed(self) -> bool:
        """Whether the chains agree, so that the fit can be relied on: `ok`, or but for the last digits."""
        return self.ok or self.short

    def __str__(self) -> str:
        if self.ok:
            return "Converged: every check passed."
        said = SHORT if self.short else "Not converged; do not rely on this fit:"
        return "\n".join([said, *(f"- {reason}" for reason in self.reasons)])


@remembered
def convergence(posterior: Posterior) -> Verdict:
    """Judge a run by the criteria of Vehtari et al. 2021 and Betancourt 2016.

    Rank-normalised R̂ ≤ 1.01, bulk and tail ESS ≥ 400 (sampled hyperparameters, θ and γ), no divergences,
    E-BFMI ≥ 0.3 in every chain, and a tree depth that is used up in at most 1 % of the draws. On the feature
    path the basis must also resolve the 5 % quantile of each posterior length scale (Riutort-Mayol et al.
    2023, section 4.3), unless the discrepancy is negligible beside the noise. That its domain is narrow for long ones
    (see `boundary_needed`) is no reason: the prior variance of f is uneven by no more than a third for that.

    The weights or values of f are not judged: given the hyperparameters they are drawn exactly and
    independently, and the largest of hundreds of R̂ would exceed 1.01 by chance alone. A quantity that never
    varies, such as the coefficient of a term that no draw includes, has no R̂ and is left out.

    R̂ and divergences tell whether the chains found the posterior at all; the effective sample sizes tell how precise
    means (bulk) and ends of intervals (tail) are, and 400 of them is a rule of thumb. Chains that pass all but that,
    and have three quarters of it, are `short`: said, but not in the words for a fit that nobody can rely on.

    What is judged is what answers rest on (see `judged.judged`). Where the noise hides f in every chain its amplitude
    and length scales have no say, as the data do not tell them; f at two rows stands in their place. A chain that has
    found an f of its own brings them back.
    """
    table = convergence_table(posterior)
    table.index = pd.Index([in_words(posterior, str(name)) for name in table.index], name="variable")
    varying = table.loc[table["varies"]]
    stats = posterior.idata["sample_stats"].dataset
    n_chain, n_draw = stats.sizes["chain"], stats.sizes["draw"]
    apart, sizes = list(_agreement(varying, n_chain)), list(_sizes(varying, n_chain, n_draw))
    others = [
        *_divergences(stats["diverging"].to_numpy()),
        *_energy(stats["energy"].to_numpy()),
        *_tree_depth(stats["n_steps"].to_numpy()),
        *_resolution(posterior),
    ]
    reasons = (*apart, *sizes, *others)
    ess = varying[["ess_bulk", "ess_tail"]].to_numpy(float)
    short = bool(sizes) and not apart and not others and bool(ess.size and np.all(ess >= NEAR * MIN_ESS))
    return Verdict(not reasons, reasons, short)


def convergence_table(posterior: Posterior) -> pd.DataFrame:
    """R̂, effective sample sizes and Monte Carlo error of every quantity that `convergence` judges.

    Returns:
        A table indexed by variable, such as "ydot_theta[y**3]", with columns r_hat, ess_bulk, ess_tail, mcse
        (of the mean, in the unit of the variable) and varies. A quantity that takes one value in all draws
        has NaN for all.
    """
    stats = array_stats()
    rows = {}
    for name, draws in judged(posterior):
        varies = bool(np.ptp(draws) > 0)
        if varies and draws.shape[1] >= 4:
            sd = draws.std()
            scaled = (draws - draws.mean()) / sd
            # Chains that are each stuck at a value of their own have no variance within: R̂ is infinite,
            # which is right.
            with np.errstate(divide="ignore", invalid="ignore"):
                r_hat = float(stats.rhat(scaled, method="rank")) if len(draws) > 1 else np.nan
                bulk = float(stats.ess(scaled, method="bulk"))
                tail = float(stats.ess(scaled, method="tail", prob=(0.05, 0.95)))
                mcse = sd * float(stats.mcse(scaled, method="mean"))
            rows[name] = (r_hat, bulk, tail, mcse, varies)
        else:
            rows[name] = (np.nan, np.nan, np.nan, np.nan, varies)
    columns = ["r_hat", "ess_bulk", "ess_tail", "mcse", "varies"]
    table = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
    table.index.name = "variable"
    return table


def features_needed(posterior: Posterior, boundary: tuple[float, ...] | None = None) -> dict[str, tuple[int, ...]]:
    """Features per variable that the posterior length scales call for, for equations whose basis has too few.

    m ≥ a L/ℓ resolves the length scale ℓ, with a from Riutort-Mayol et al. 2023, Sec. 4.2, and ℓ the 5 % quantile of
    its posterior in half-widths of the box. Where the discrepancy is negligible its length scales are those of the
    prior, and where the rows cannot show what finer features add (`UNSEEN`) these would change nothing: then nothing is
    called for.

    Args:
        posterior: Fitted model.
        boundary: L in each direction of a domain that the features would have; None: that of the fit.

    Returns:
        Features per variable by equation; empty if all is resolved.
    """
    gp = posterior.model.discrepancy
    if gp is None or gp.path != "hsgp":
        return {}
    per_unit = KERNELS[gp.kernel].features_per_unit
    needed = {}
    for name, equation in posterior.equations.items():
        basis = equation.frame.basis
        if basis is None or _negligible(posterior, name):
            continue
        shortest = np.quantile(posterior.draws(name).hyper.length_scale, QUANTILE, axis=0)
        per_variable = np.array(basis.per_variable)
        half_widths = basis.half_widths if boundary is None else np.array(boundary)
        required = np.ceil(per_unit * half_widths / shortest).astype(int)
        if not np.any(required > per_variable):
            continue
        held = HilbertBasis(boundary or basis.boundary, basis.per_variable)
        finer = HilbertBasis(held.boundary, tuple(np.clip(required, per_variable, FINER * per_variable).tolist()))
        if _added(posterior, name, held, finer) > UNSEEN:
            needed[name] = tuple(int(m) for m in np.maximum(required, per_variable))
    return needed


def boundary_needed(posterior: Posterior) -> dict[str, tuple[float, ...]]:
    """Boundary factors that the posterior length scales call for, for equations whose domain is surely too narrow.

    L ≥ b ℓ keeps f from its images behind the walls, with b from Riutort-Mayol et al. 2023, Sec. 4.2. It is surely
    too small if it is so for the 5 % quantile of ℓ; called for is what holds its median, `WIDEST` at most. Where the
    discrepancy is negligible its length scales are those of the prior, and nothing is.

    Returns:
        L in each direction by equation; empty if all domains are wide enough.
    """
    gp = posterior.model.discrepancy
    if gp is None or gp.path != "hsgp":
        return {}
    per_length = KERNELS[gp.kernel].boundary_per_length
    needed = {}
    for name, equation in posterior.equations.items():
        basis = equation.frame.basis
        if basis is None or _negligible(posterior, name):
            continue
        lengths = posterior.draws(name).hyper.length_scale
        sure = per_length * np.quantile(lengths, QUANTILE, axis=0) > basis.half_widths
        held = np.minimum(per_length * np.median(lengths, axis=0), WIDEST)
        if np.any(sure & (held > basis.half_widths)):
            needed[name] = tuple(np.where(sure, np.maximum(held, basis.half_widths), basis.half_widths).tolist())
    return needed


def array_stats() -> Any:
    """ArviZ's statistics of plain arrays, the same in both of its generations."""
    from arviz_stats.base.array import array_stats  # three seconds, so not at the top

    return array_stats


def _agreement(table: pd.DataFrame, n_chain: int) -> Iterator[str]:
    if n_chain < 2:
        yield "There is one chain, and R̂ compares chains: run chains=4."
    high = {name: r_hat for name, r_hat in _values(table, "r_hat") if r_hat > MAX_R_HAT}
    if high:
        worst = max(high, key=lambda name: high[name])
        yield (
            f"R̂ is {_beyond(high[worst], MAX_R_HAT)} for {worst}, above {MAX_R_HAT}{_others(high)}: "
            "the chains disagree; raise tune and draws, and if it stays, look at the chains for several modes (a "
            "kernel that is not orthogonal to the dictionary makes them)."
        )


def _sizes(table: pd.DataFrame, n_chain: int, n_draw: int) -> Iterator[str]:
    if n_chain * n_draw < MIN_ESS:
        yield (
            f"There are {n_chain * n_draw} draws in all, too few for an effective sample size of {MIN_ESS}: "
            f"raise draws to at least {math.ceil(2 * MIN_ESS / n_chain)} in each chain."
        )
        return
    for what in ("bulk", "tail"):
        low = {name: ess for name, ess in _values(table, f"ess_{what}") if ess < MIN_ESS}
        if low:
            worst = min(low, key=lambda name: low[name])
            # As many draws as would bring the worst one to the threshold, with a quarter to spare.
            needed = math.ceil(1.25 * n_draw * MIN_ESS / max(low[worst], 1.0) / 100) * 100
            yield (
                f"The {what} effective sample size is {low[worst]:.0f} for {worst}, below {MIN_ESS}{_others(low)}: "
                f"raise draws to about {needed}."
            )


def _values(table: pd.DataFrame, column: str) -> Iterator[tuple[str, float]]:
    return zip(map(str, table.index), table[column].to_numpy(float).tolist(), strict=True)


def _others(found: dict) -> str:
    count = len(found) - 1
    return f", as it is for {count} more" if count else ""


def _beyond(value: float, limit: float) -> str:
    """A number with digits enough to be seen beyond its limit: 1.0103, not 1.01, above 1.01."""
    texts = [f"{value:.{digits}g}" for digits in range(3, 9)]
    return next((text for text in texts if float(text) > limit), texts[-1])


def _divergences(diverging: np.ndarray) -> Iterator[str]:
    count = int(diverging.sum())
    if count:
        yield (
            f"There were {count} divergences in {diverging.size} draws: parts of the posterior were not "
            "reached; raise target_accept towards 0.99."
        )


def _energy(energy: Float[np.ndarray, "n_chain n_draw"]) -> Iterator[str]:
    # E-BFMI = Σ (E_n − E_{n−1})² / Σ (E_n − Ē)²  (Betancourt 2016, Eq. 22)
    spread = np.sum((energy - energy.mean(axis=1, keepdims=True)) ** 2, axis=1)
    steps = np.sum(np.diff(energy, axis=1) ** 2, axis=1)
    worst = float(np.min(steps / np.where(spread > 0, spread, np.inf)))
    if energy.shape[1] > 3 and worst < MIN_E_BFMI:
        yield (
            f"E-BFMI is {worst:.2g}, below {MIN_E_BFMI}: the sampler crosses the tails of the posterior too "
            "slowly; raise tune, or choose a prior with lighter tails."
        )


def _tree_depth(n_steps: np.ndarray) -> Iterator[str]:
    share = float(np.mean(n_steps >= 2**MAX_TREE_DEPTH - 1))
    if share > SATURATED_SHARE:
        yield (
            f"{share:.0%} of the draws used up the tree depth of {MAX_TREE_DEPTH}: the steps are far too "
            "small for the posterior's shape; raise tune, or remove terms that are nearly collinear."
        )


def _resolution(posterior: Posterior) -> Iterator[str]:
    for name, needed in features_needed(posterior).items():
        frame = posterior.equations[name].frame
        assert frame.basis is not None
        short = [v for v, m, had in zip(frame.variables, needed, frame.basis.per_variable, strict=True) if m > had]
        text = str(needed[0]) if len(set(needed)) == 1 else f"({', '.join(map(str, needed))})"
        yield (
            f"The discrepancy of {name!r} wants shorter length scales in {', '.join(map(repr, short))} than "
            f"its {frame.basis.size} features resolve: raise OrthogonalGP(features=...) to at least {text}."
        )


def _negligible(posterior: Posterior, equation: str) -> bool:
    """Whether f is too small to matter, so that its length scales are left to their prior."""
    hyper = posterior.draws(equation).hyper
    return bool(np.median(hyper.amplitude) < NEGLIGIBLE_AMPLITUDE * np.median(hyper.sigma))


def _added(posterior: Posterior, equation: str, held: HilbertBasis, finer: HilbertBasis) -> float:
    """Expected square of what finer features add to f, over σ² and summed over the rows.

    The features' variances are the spectral density at their frequencies: f has Σ_j S(√λ_j) ⟨ψ_j²⟩ on average over the
    box.
    """
    gp, hyper = posterior.model.discrepancy, posterior.draws(equation).hyper
    assert gp is not None
    pick = np.linspace(0, len(hyper.sigma) - 1, min(THINNED, len(hyper.sigma))).astype(int)

    def variance(basis: HilbertBasis) -> np.ndarray:
        frequency, square = basis.frequency, basis.mean_square
        log_density = [
            _log_density(KERNELS[gp.kernel], frequency, hyper.amplitude[i] / hyper.sigma[i], length)
            for i, length in zip(pick, hyper.length_scale[pick], strict=True)
        ]
        return np.exp(np.asarray(log_density)) @ square

    return posterior.n_obs * float(np.mean(np.maximum(0.0, variance(finer) - variance(held))))
