"""States that weak rows are linear near, and the covariance that the samples' noise gives the rows there.

With samples Y = x + e, a test function φ and a path X near x, the weak form of ẋ_k = F_k(x), F = g + Φθ, is

    −∫ φ̇ Y_k − ∫ φ J_k (Y − X) = ∫ φ F_k(X) − (∫ φ̇ e_k + ∫ φ J_k e),    J = ∂F/∂x at X,

but for what is of second order in X − x: linear in θ, with the noise −L e, L = V̇ + V J, of covariance L S Lᵀ (Bortz,
Messenger & Dukic 2023, Bull. Math. Biol. 85:110, Eq. 13, there at X = Y, where Φ(x + e) has the rows' own noise and all
coefficients are biased). J is that of a frozen model θ̄. Here X is near x: the samples less the noise that the rows of
the frozen model say there is, smoothed,

    X = H (Y − ê),    ê = S Lᵀ R⁻¹ ρ / max(1, σ̂²),    ρ the rows' residual under θ̄, R = L S Lᵀ, σ̂² = ρᵀR⁻¹ρ / n.

That is Gauss and Newton's step to the likeliest states under the model (Britt & Luecke 1973, Technometrics 15:233).
Where the model does not explain the rows, σ̂² is large and ê takes no more than its share.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import LinAlgError, cholesky_banded
from scipy.sparse import csr_matrix, diags, hstack, vstack

from bayes_greybox.data.noise.banded import (
    LEAST_PIVOT_SHARE,
    OverlappingNoise,
    independent_rows,
    mean_diagonal,
    overlapping,
)
from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.data.weak.weak_form import (
    CENTRES_PER_RADIUS,
    FEWEST_RADIUS_STEPS,
    Bumps,
    LocalFits,
    Stretch,
    chosen_half_widths,
    stretches,
)
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.running.errors import InputError

from .equation_rows import Acting, Columns, EquationRows, Evaluate, block_name


class Level(NamedTuple):
    """Scales that all rows of a pass share.

    Attributes:
        size: RMS of L S^½ over all rows that the test functions could give.
        variance: Mean variance of the rows that are kept, over its square.
        share: Share of the noise found by the rows which is taken out of the samples.
    """

    size: float
    variance: float
    share: float


@dataclass(frozen=True)
class Common:
    """Findings that all runs share, with the level of each pass and the RMS of the measured rows of each equation."""

    sd: tuple[float, ...]
    half_widths: tuple[int, ...]
    radius: float
    levels: tuple[Level, ...]
    sizes: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Reading:
    """Noise, windows and test functions of samples; cubics have so many neighbours on either side for each state."""

    samples: Trajectories
    sd: Float[np.ndarray, " n_state"]
    half_widths: tuple[int, ...]
    fits: tuple[LocalFits, ...]
    bumps: Bumps

    @classmethod
    def of(cls, samples: Trajectories, radius: float | None) -> "Reading":
        """Read samples; by default test functions reach as far as the cubic that follows the fastest state best."""
        values = samples.matrix(samples.state_names)
        spread = np.maximum(np.std(values, axis=0), np.finfo(float).tiny)
        # Rounding, and what sums for integrals leave.
        sd = np.maximum(sample_noise(samples.time, values, samples.run_lengths), 1e-5 * spread)
        parts = stretches(samples.time, samples.run_lengths)
        widths = chosen_half_widths(samples.time, values, sd, parts)
        reach = radius or _radius(samples.time, parts, min(widths), len(sd))
        return cls.of_windows(samples, sd, widths, reach)

    @classmethod
    def of_windows(
        cls, samples: Trajectories, sd: Float[np.ndarray, " n_state"], widths: tuple[int, ...], radius: float
    ) -> "Reading":
        """Read samples with noise, half-widths of the cubics and a radius from elsewhere."""
        parts = stretches(samples.time, samples.run_lengths)
        made = {width: LocalFits.of(samples.time, parts, width) for width in set(widths)}
        return cls(samples, sd, widths, tuple(made[m] for m in widths), Bumps.along(samples.time, parts, radius))

    def smooth(self, values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """Return H values, state by state."""
        return np.column_stack([fits.smooth(x) for fits, x in zip(self.fits, values.T, strict=True)])


@dataclass(frozen=True, eq=False)
class Weighing:
    """V, from values at the samples to the rows of one equation among those of all, each near a sample."""

    table: csr_matrix
    sample: Int[np.ndarray, " n_row"]

    @property
    def place(self) -> Int[np.ndarray, " n_row"]:
        """The same samples: terms are evaluated there."""
        return self.sample

    def __call__(self, table: Float[np.ndarray, "n_sample k"]) -> Float[np.ndarray, "n_row k"]:
        """Return V table."""
        return np.asarray(self.table @ table)

    def of(self, evaluate: Evaluate, columns: Columns) -> Float[np.ndarray, "n_row k"]:
        """Return V F, F evaluated on columns."""
        return self(np.asarray(evaluate(columns)))


@dataclass(frozen=True, eq=False)
class WeakPath:
    """States near those that were sampled, and rows of some equations there, in order of time, then of equation.

    Of states X with these slopes, rows are −V̇ Y − V J (Y − X) measured and V g(X) simulated, without the frozen model's
    own terms; forces on each state have the RMS of its equation's rows.
    """

    reading: Reading
    states: Float[np.ndarray, "n_sample n_state"]
    rates: Float[np.ndarray, "n_sample n_state"]
    rows: EquationRows
    common: Common


def weak_path(
    reading: Reading, equations: tuple[str, ...], simulation: Simulation, whole: Simulation, white_share: float,
    levels: Sequence[Level] = (),
) -> WeakPath:  # fmt: skip
    """Return states and rows near a frozen model, `whole` with its terms, with the levels of other rows if there are.

    States are taken anew twice near the model.
    """
    samples, bumps = reading.samples, reading.bumps
    Y, U = samples.matrix(samples.state_names), samples.matrix(samples.input_names)
    states = [samples.state_names.index(name) for name in equations]
    X = reading.smooth(Y)
    near, levels_found = None, []
    for level in [*levels] or [None] * 3:
        X = X if near is None else reading.smooth(Y - near.error(reading))
        near = _linear(reading, states, X, whole, white_share, level)
        levels_found.append(near.level)
    assert near is not None
    g, rows = simulation.rates(samples.time, X, U), near.rows
    measured = np.concatenate([-(bumps.slopes @ Y[:, k]) - bumps.values @ near.back[:, k] for k in states])[rows]
    learned, equation_of = {}, rows // max(len(bumps), 1)
    for i, name in enumerate(equations):
        parts = [bumps.values if k == i else csr_matrix(bumps.values.shape) for k in range(len(states))]
        inside = equation_of == i
        size = float(np.sqrt(np.mean(measured[inside] ** 2))) if np.any(inside) else 0.0
        learned[name] = Acting(Weighing(_lines(parts, rows), np.tile(bumps.sample, len(states))[rows]), size)
    path_rows = EquationRows(
        equation=block_name(equations),
        columns={**dict(zip(samples.state_names, X.T, strict=True)), **samples.inputs},
        measured=measured,
        simulated=np.concatenate([bumps.values @ g[:, k] for k in states])[rows],
        noise=near.noise,
        time=np.tile(bumps.centre, len(states))[rows],
        run=np.tile(bumps.run, len(states))[rows],
        learned=learned,
    )
    rates = np.column_stack([fits.rate(x) for fits, x in zip(reading.fits, X.T, strict=True)])
    sizes = {name: acting.size for name, acting in learned.items()}
    common = Common(tuple(reading.sd.tolist()), reading.half_widths, bumps.radius, tuple(levels_found), sizes)
    return WeakPath(reading, X, rates, path_rows, common)


class _Linear(NamedTuple):
    """Rows near some states under a frozen model.

    L is L S^½, `rows` are numbers among all, equation by equation, `left` is their residual ρ, and `back` J (Y − X).
    """

    L: csr_matrix
    noise: OverlappingNoise
    rows: Int[np.ndarray, " n_row"]
    left: Float[np.ndarray, " n_row"]
    back: Float[np.ndarray, "n_sample n_state"]
    level: Level

    def error(self, reading: Reading) -> Float[np.ndarray, "n_sample n_state"]:
        """Return ê."""
        if not len(self.rows):
            return np.zeros(self.back.shape)
        white = self.noise.whiten(self.left[:, None] / self.noise.scale)
        error = self.L.T @ self.noise.whiten_transpose(white)[:, 0] / self.noise.scale
        return self.level.share * error.reshape(len(reading.sd), -1).T * reading.sd


def _linear(
    reading: Reading, states: Sequence[int], X: np.ndarray, whole: Simulation, share: float, level: Level | None
) -> _Linear:
    samples, bumps = reading.samples, reading.bumps
    Y, U = samples.matrix(samples.state_names), samples.matrix(samples.input_names)
    F, J = whole.rates(samples.time, X, U), whole.jacobian(samples.time, X, U)
    if not (np.all(np.isfinite(F[:, states])) and np.all(np.isfinite(J[:, states]))):
        names = ", ".join(samples.state_names[k] for k in states)
        raise InputError(f"The rates of {names} are not finite near the samples: check the domain of the terms.")
    back = np.einsum("nij,nj->ni", J, Y - X)
    # Row by row of time, equation by equation.
    order = np.arange(len(states) * len(bumps)).reshape(len(states), -1).T.ravel()
    lines = []
    for k in states:
        blocks = [bumps.values @ diags(J[:, k, j] * s) for j, s in enumerate(reading.sd)]
        blocks[k] = blocks[k] + bumps.slopes * reading.sd[k]
        lines.append(csr_matrix(hstack(blocks)))
    L = _lines(lines, order)
    size = level.size if level else float(np.sqrt(np.mean(np.sum(L.multiply(L), axis=1)))) if L.nnz else 1.0
    bands, kept = _bands(L, np.tile(bumps.run, len(states))[order], size, share)
    variance = level.variance if level else mean_diagonal(bands)
    noise = overlapping(bands, size, variance)
    rows = order[kept]
    left = np.concatenate([bumps.slopes @ Y[:, k] + bumps.values @ (F[:, k] + back[:, k]) for k in states])[rows]
    if level is None:
        # σ̂², of which more than one is no noise of the samples.
        square = float(np.mean(noise.whiten(left[:, None] / noise.scale) ** 2)) if len(rows) else 1.0
        level = Level(size, variance, 1.0 / max(1.0, square))
    return _Linear(_lines([L], kept), noise, rows, left, back, level)


def _lines(parts: Sequence[csr_matrix], rows: np.ndarray) -> csr_matrix:
    """Return some lines of matrices stacked on top of each other."""
    whole: Any = csr_matrix(vstack(parts))
    return whole[rows]


def _radius(time: np.ndarray, parts: Sequence[Stretch], half_width: int, n_state: int) -> float:
    """Return half the window of the narrowest cubic in time, within the limits on steps and rows."""
    steps = np.concatenate([np.diff(time[slice(*part.rows)]) for part in parts])
    step, whole = float(np.median(steps)) if len(steps) else 1.0, float(np.sum(steps))
    # On uneven steps a bump needs its fewest samples on average.
    fewest = FEWEST_RADIUS_STEPS * max(step, float(np.mean(steps)) if len(steps) else step) * (1 + 1e-9)
    # On longer records than give 6000 rows, test functions are wider than the data ask for.
    return max(half_width * step, fewest, CENTRES_PER_RADIUS * n_state * whole / 6000)


def _bands(
    L: csr_matrix, run: np.ndarray, size: float, share: float
) -> tuple[list[Float[np.ndarray, "_ _"]], Int[np.ndarray, " n_row"]]:
    """Return the covariance of the rows of each run over a square, and the rows that are no sums of those before."""
    bands, kept = [], [np.zeros(0, int)]
    for r in np.unique(run):
        rows = np.flatnonzero(run == r)
        band = _banded(_lines([L], rows) / size, share)
        if not _independent(band):
            rows = rows[independent_rows(band)]
            band = _banded(_lines([L], rows) / size, share)
        bands.append(band)
        kept.append(rows)
    return bands, np.concatenate(kept)


def _independent(band: np.ndarray) -> bool:
    try:
        factor = cholesky_banded(band, lower=True)
    except LinAlgError:
        return False
    return bool(np.all(factor[0] ** 2 > LEAST_PIVOT_SHARE * band[0]))


def _banded(L: Any, share: float) -> np.ndarray:
    """Return (1 − δ) L Lᵀ + δ diag L Lᵀ in lower banded form."""
    lower = (L @ L.T).tocoo()
    below = lower.row >= lower.col
    row, column, value = lower.row[below], lower.col[below], lower.data[below]
    band = np.zeros((int(np.max(row - column, initial=0)) + 1, L.shape[0]))
    band[row - column, column] = value
    band[1:] *= 1.0 - share
    return band
