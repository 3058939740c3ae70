"""Observations that are left out together: blocks, whole trajectories, or the future."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.model.rows.equation_rows import EquationRows
from bayes_greybox.running.errors import InputError

SCHEMES = ("loo", "block", "trajectory", "future")
"""Cross-validation schemes: single rows, contiguous blocks, whole trajectories, leave-future-out."""

LEAST_BLOCKS, MOST_FUTURES = 10, 20
"""Fewest blocks, and most steps into the future, of a length that the package chooses."""

WHITE_BOUND = 1.96
"""Standard deviations within which an autocorrelation passes for that of white noise."""

FUTURE_START = 0.5
"""Share of the time stamps before the first prediction of leave-future-out."""


@dataclass(frozen=True)
class Folds:
    """Observations left out together, for each equation.

    `members` are the observations of each fold (rows of the data; whitened coefficients if the rows' noise is
    singular). `past` are those before the first fold, for "future"; the past of a later fold has those in between too.
    `words` describe the folds, such as "7 blocks of 20 rows"; notes are sentences on their choice.
    """

    scheme: str
    members: Mapping[str, tuple[Int[np.ndarray, " _"], ...]]
    past: Mapping[str, Int[np.ndarray, " _"]]
    block: int | None
    words: str
    notes: tuple[str, ...] = ()


def make_folds(posterior: Posterior, scheme: str, block: int | None = None, start: float = FUTURE_START) -> Folds:
    """Divide the data.

    A block is contiguous rows of one run; every run is cut evenly. The future goes by time stamps: the past of a
    fold is every row, of whichever run, with an earlier stamp. Runs that share a clock thus advance together, and
    runs that followed each other are predicted one after the other. A fold covers all sensors.

    Arguments are those of `cross_validate`. InputError is raised if the data cannot be divided so.
    """
    data = posterior.data
    require_divisible(data, tuple(posterior.equations), scheme)
    if scheme == "trajectory":
        return _trajectories(posterior)
    notes: tuple[str, ...] = ()
    # All equations have their rows at the same samples.
    first_rows = next(iter(posterior.equations.values())).rows
    if scheme == "future":
        stamps, stamp = np.unique(first_rows.time, return_inverse=True)
        first = min(max(1, math.ceil(start * len(stamps))), len(stamps) - 1)
        n_future = len(stamps) - first
        if block is None:
            block, reason = chosen_block(posterior)
            coarse = math.ceil(n_future / MOST_FUTURES)
            if coarse > block:
                block, reason = coarse, f"so that there are no more than {MOST_FUTURES} steps"
            if block > n_future // 2 > 0:
                block, reason = n_future // 2, "half of what is predicted, though residuals are correlated for longer"
            notes = (f"Steps of {_count(block, 'time stamp')} were chosen, {reason}.",)
        pieces = np.array_split(first + np.arange(n_future), math.ceil(n_future / block))
        rows = tuple(np.flatnonzero((stamp >= piece[0]) & (stamp <= piece[-1])) for piece in pieces)
        past = np.flatnonzero(stamp < first)
        words = f"{_count(len(rows), 'step')} of up to {_count(block, 'time stamp')} into the future"
    else:
        if block is None:
            block, reason = chosen_block(posterior)
            notes = (f"Blocks of {_count(block, 'row')} were chosen, {reason}.",)
        stretches, runs = _stretches(first_rows, data)
        cut = [np.array_split(stretch, math.ceil(len(stretch) / block)) for stretch in stretches]
        # All sensors, as one that stays would give the others away.
        rows = tuple(
            np.concatenate(parts)
            for run in np.unique(runs)
            for parts in zip(*(cut[k] for k in np.flatnonzero(runs == run)), strict=True)
        )
        past = np.zeros(0, int)
        each = " of each sensor" if len(stretches) > len(np.unique(runs)) else ""
        words = f"{_count(len(rows), 'block')} of up to {_count(block, 'row')}{each}"
    if len(rows) < 2:
        raise InputError(f"block={block} leaves a single fold: give a smaller block.")
    names = tuple(posterior.equations)
    return Folds(scheme, dict.fromkeys(names, rows), dict.fromkeys(names, past), block, words, notes)


def chosen_block(posterior: Posterior) -> tuple[int, str]:
    """Return a length of blocks from the longest `correlation_length` of an equation, and the reason in words."""
    lengths = {name: correlation_length(posterior, name) for name in posterior.equations}
    name = max(lengths, key=lambda name: lengths[name])
    most = max(1, posterior.equations[name].rows.n_row // LEAST_BLOCKS)
    if lengths[name] >= most:
        return most, f"a tenth of the rows, because what the dictionary leaves of {name!r} is correlated that far"
    lag = _count(lengths[name], "row")
    return lengths[name], f"because what the dictionary leaves of {name!r} is uncorrelated {lag} apart"


def correlation_length(posterior: Posterior, equation: str) -> int:
    """Return the least lag k from which on the autocorrelation of y − g − Φᵀθ̄ is within that of white noise.

    At k itself |ρ_k| < 1.96/√n, and over the lags k … 2k − 1 the mean of n_j ρ_j², of n_j pairs, is below
    1.96² (1 + 2 Σ_{j<k} ρ_j²), whose bracket is n_j times the variance of ρ_j (Bartlett 1946): an oscillating residual
    is uncorrelated a quarter period apart, but not half a period apart.

    f is part of this residual: if it varies slowly, neighbours predict a row, and blocks must be longer for the
    prediction to come from the model. The search ends at a tenth of the rows.
    """
    entry = posterior.equations[equation]
    Phi, _, y = entry.parts()
    residual = y - Phi @ posterior.draws(equation).theta.mean(axis=0)
    n = len(residual)
    most = max(1, n // LEAST_BLOCKS)
    products, pairs = lagged_products(residual - residual.mean(), entry.rows.noise.run_lengths, 2 * most)
    rho = products / max(products[0], np.finfo(float).tiny)
    # n_j ρ_j² with ρ_j per pair; lags longer than every run have no pairs.
    scaled = np.cumsum(np.where(pairs > 0, (n * rho) ** 2 / np.maximum(pairs, 1), 0.0))
    scatter = np.cumsum(rho**2)
    for lag in range(1, most):
        bound = WHITE_BOUND**2 * (1 + 2 * (scatter[lag - 1] - scatter[0]))
        if abs(rho[lag]) < WHITE_BOUND / math.sqrt(n) and scaled[2 * lag - 1] - scaled[lag - 1] < lag * bound:
            return lag
    return most


def check_scheme(scheme: str, block: int | None, start: float) -> None:
    """Raise InputError for an unknown scheme, or for a block that is no positive number or does not apply."""
    if scheme not in SCHEMES:
        raise InputError(f"scheme={scheme!r} is not known: choose one of {', '.join(map(repr, SCHEMES))}.")
    if block is not None and scheme in ("loo", "trajectory"):
        raise InputError(f"block={block!r} does not apply to scheme={scheme!r}: leave it out, or use scheme='block'.")
    if block is not None and (isinstance(block, bool) or not isinstance(block, int | np.integer) or block < 1):
        raise InputError(f"block={block!r} must be a positive whole number of rows.")
    if not 0 < start < 1:
        raise InputError(f"start={start:g} must lie between 0 and 1.")


def require_divisible(data: Trajectories, equations: Sequence[str], scheme: str) -> None:
    """Require several trajectories, or rows with a density of their own, as the scheme needs, or raise InputError."""
    if scheme == "trajectory" and data.n_run < 2:
        raise InputError("scheme='trajectory' leaves out whole runs, and the data have one: use scheme='block'.")
    for name in equations if scheme in ("block", "future") else ():
        if not data.row_noise(name).square:
            raise InputError(
                f"scheme={scheme!r} needs rows with a density of their own, and the spectral derivative of {name!r} "
                "gives Fourier coefficients, which belong to no time: use scheme='loo' or 'trajectory', or "
                "differentiate(method='savgol')."
            )


def _trajectories(posterior: Posterior) -> Folds:
    data = posterior.data
    members = {}
    for name, entry in posterior.equations.items():
        _, runs = _stretches(entry.rows, data)
        white = np.array(entry.rows.noise.white_lengths)[np.array(entry.rows.noise.run_lengths) > 0]
        run_of = np.repeat(runs, white)
        members[name] = tuple(np.flatnonzero(run_of == run) for run in np.unique(run_of))
    number = min(map(len, members.values()))
    if number < 2:
        raise InputError("Rows of one trajectory are all that there are: leave none of them out whole.")
    empty = dict.fromkeys(members, np.zeros(0, int))
    notes = ()
    if number < LEAST_BLOCKS:
        notes = (f"There are {number} trajectories: standard errors from so few are rough.",)
    return Folds("trajectory", members, empty, None, f"{number} trajectories", notes)


def _stretches(
    rows: EquationRows, data: Trajectories
) -> tuple[list[Int[np.ndarray, " _"]], Int[np.ndarray, " n_stretch"]]:
    """Return the rows of each stretch of the noise, a run of one sensor, and the run of the data it belongs to."""
    ends = np.cumsum(rows.noise.run_lengths)
    stretches = [np.arange(end - n, end) for end, n in zip(ends, rows.noise.run_lengths, strict=True) if n]
    return stretches, data.run[rows.sample[[stretch[0] for stretch in stretches]]]


def lagged_products(
    residual: Float[np.ndarray, "*batch n_obs"], lengths: Sequence[int], n_lag: int
) -> tuple[Float[np.ndarray, "*batch n_lag"], Int[np.ndarray, " n_lag"]]:
    """Return Σ r_i r_{i+k} at the lags k = 0, 1, … over pairs within a run, and the numbers of these pairs."""
    products, pairs = np.zeros((*residual.shape[:-1], n_lag)), np.zeros(n_lag, int)
    for part in np.split(residual, np.cumsum(lengths)[:-1], axis=-1):
        n = part.shape[-1]
        used = min(n_lag, n)
        # Zero padding, so that the end does not meet the start.
        power = np.abs(np.fft.rfft(part, 2 * n)) ** 2
        products[..., :used] += np.fft.irfft(power, 2 * n)[..., :used]
        pairs[:used] += n - np.arange(used)
    return products, pairs


def _count(number: int, what: str) -> str:
    return f"{number} {what}" + ("" if number == 1 else "s")
