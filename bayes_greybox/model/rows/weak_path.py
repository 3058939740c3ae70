"""States that weak rows are linear near, and the covariance that the samples' noise gives the rows there.

With samples Y = x + e, a test function φ and a path X near x, the weak form of ẋ_k = F_k(x), F = g + Φθ, is

    −∫ φ̇ Y_k − ∫ φ J_k (Y − X) = ∫ φ F_k(X) − (∫ φ̇ e_k + ∫ φ J_k e),    J = ∂F/∂x at X,

but for what is of second order in X − x: linear in θ, with the noise −L e, L = V̇ + V J, of covariance L S Lᵀ (Bortz,
Messenger & Dukic 2023, Bull. Math. Biol. 85:110, Eq. 13, there at X = Y). J is that of a frozen model θ̄. At X = Y the
terms are evaluated at noisy states, Φ(x + e) is not Φ(x) even on average, and its noise and that of the rows are the
same noise, so that all coefficients are biased. Here X is near x: the samples less the noise that the rows of the
frozen model say there is, smoothed,

    X = H (Y − ê),    ê = S Lᵀ R⁻¹ ρ / max(1, σ̂²),    ρ the rows' residual under θ̄, R = L S Lᵀ, σ̂² = ρᵀR⁻¹ρ / n.

That is Gauss and Newton's step to the likeliest states under the model (Britt & Luecke 1973, Technometrics 15:233).
Where the model does not explain the rows, σ̂² is large and ê takes no more than its share.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import LinAlgError, cholesky_banded
from scipy.sparse import csr_matrix, diags, hstack, vstack

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.local_fits import LocalFits, Stretch, chosen_half_widths, stretches
from bayes_greybox.data.noise.overlapping import TOLD, OverlappingNoise, independent_rows, overlapping
from bayes_greybox.data.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.data.weak_form import EVERY, FEWEST_STEPS, Bumps
from bayes_greybox.physics.simulation.protocol import Simulation

FINEST = 1e-5
"""Noise of a state over the spread of its samples, at least: rounding, and what sums for integrals leave."""

TURNS = 2
"""How often states are taken anew near the frozen model."""

MOST_ROWS = 6000
"""Rows at most; on longer records test functions are wider than the data ask for."""


@dataclass(frozen=True, eq=False)
class Reading:
    """What is read off samples before any model: noise, windows and test functions.

    Attributes:
        samples: The samples.
        sd: Noise of each state.
        half_widths: Neighbours on either side in the cubics of each state.
        fits: These cubics.
        bumps: Test functions.
    """

    samples: Trajectories
    sd: Float[np.ndarray, " n_state"]
    half_widths: tuple[int, ...]
    fits: tuple[LocalFits, ...]
    bumps: Bumps

    @classmethod
    def of(cls, samples: Trajectories, radius: float | None, n_equation: int) -> "Reading":
        """Read samples.

        Args:
            samples: All states.
            radius: Of the test functions; by default as far as the cubic reaches that follows the fastest state best.
            n_equation: Equations that have rows.
        """
        values = samples.matrix(samples.state_names)
        spread = np.maximum(np.std(values, axis=0), np.finfo(float).tiny)
        sd = np.maximum(sample_noise(samples.time, values, samples.run_lengths), FINEST * spread)
        parts = stretches(samples.time, samples.run_lengths)
        widths = chosen_half_widths(samples.time, values, sd, parts)
        made = {width: LocalFits.of(samples.time, parts, width) for width in set(widths)}
        fits = tuple(made[width] for width in widths)
        reach = radius or _radius(samples.time, parts, min(widths), n_equation)
        return cls(samples, sd, widths, fits, Bumps.along(samples.time, parts, reach))

    def smooth(self, values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """H values, state by state."""
        return np.column_stack([fits.smooth(x) for fits, x in zip(self.fits, values.T, strict=True)])


@dataclass(frozen=True, eq=False)
class Weighing:
    """V, from values at the samples to the rows of one equation among those of all.

    Attributes:
        table: V [n_row, n_sample]; empty lines where rows are of other equations.
        sample: Sample nearest to the centre of each row.
    """

    table: csr_matrix
    sample: Int[np.ndarray, " n_row"]

    @property
    def place(self) -> Int[np.ndarray, " n_row"]:
        """The same: terms are evaluated at samples."""
        return self.sample

    def __call__(self, table: Float[np.ndarray, "n_sample k"]) -> Float[np.ndarray, "n_row k"]:
        """V table."""
        return np.asarray(self.table @ table)

    def of(self, evaluate, columns: Mapping[str, Float[np.ndarray, " n_sample"]]) -> Float[np.ndarray, "n_row k"]:
        """V F, F evaluated on columns."""
        return self(np.asarray(evaluate(columns)))


@dataclass(frozen=True, eq=False)
class WeakPath:
    """States near those that were sampled, and rows of some equations there, in order of time, then of equation.

    Attributes:
        reading: What was read off the samples.
        states: X [n_sample, n_state].
        rates: Slopes of X.
        weighing: V of each equation that has rows.
        measured: −V̇ Y − V J (Y − X) [n_row].
        simulated: V g(X), g without the frozen model's own terms.
        noise: R, whose `scale` is that of the rows.
        explained: σ̂² of the frozen model.
        sizes: RMS of the measured rows of each equation.
        time: Centres of the rows.
        run: Their runs.
    """

    reading: Reading
    states: Float[np.ndarray, "n_sample n_state"]
    rates: Float[np.ndarray, "n_sample n_state"]
    weighing: Mapping[str, Weighing]
    measured: Float[np.ndarray, " n_row"]
    simulated: Float[np.ndarray, " n_row"]
    noise: OverlappingNoise
    explained: float
    sizes: Mapping[str, float]
    time: Float[np.ndarray, " n_row"]
    run: Int[np.ndarray, " n_row"]


def weak_path(reading: Reading, equations: tuple[str, ...], known: Simulation, whole: Simulation) -> WeakPath:
    """States and rows near a frozen model.

    Args:
        reading: What was read off the samples.
        equations: Those that have rows.
        known: The known rates.
        whole: The same with the terms of the frozen model.

    Raises:
        InputError: Rates of the frozen model are not finite near the samples.
    """
    samples, bumps = reading.samples, reading.bumps
    Y, U = samples.matrix(samples.state_names), samples.matrix(samples.input_names)
    own = [samples.state_names.index(name) for name in equations]
    # Row by row of time, equation by equation.
    order = np.arange(len(own) * len(bumps)).reshape(len(own), -1).T.ravel()
    run = np.tile(bumps.run, len(own))[order]
    X = reading.smooth(Y)
    for turn in range(TURNS + 1):
        F, J = whole.rates(samples.time, X, U), whole.jacobian(samples.time, X, U)
        if not (np.all(np.isfinite(F[:, own])) and np.all(np.isfinite(J[:, own]))):
            raise InputError(
                f"The rates of {', '.join(equations)} are not finite near the samples: check the domain of the terms."
            )
        back = np.einsum("nij,nj->ni", J, Y - X)
        L = _response(bumps, J, own, reading.sd, order)
        noise, kept = _noise(L, run, samples.n_run)
        L, rows = L[kept], order[kept]
        left = np.concatenate([bumps.slopes @ Y[:, k] + bumps.values @ (F[:, k] + back[:, k]) for k in own])[rows]
        if turn == TURNS or not len(rows):
            break
        white = noise.whiten(left[:, None] / noise.scale)
        explained = float(np.mean(white**2))
        e = (L.T @ noise.whiten_transpose(white)[:, 0]).reshape(len(reading.sd), -1).T * reading.sd / noise.scale
        X = reading.smooth(Y - e / max(1.0, explained))
    if len(rows):
        explained = float(np.mean(noise.whiten(left[:, None] / noise.scale) ** 2))
    measured = np.concatenate([-(bumps.slopes @ Y[:, k]) - bumps.values @ back[:, k] for k in own])[rows]
    g = known.rates(samples.time, X, U)
    simulated = np.concatenate([bumps.values @ g[:, k] for k in own])[rows]
    nearest = np.tile(bumps.sample, len(own))[rows]
    weighing = {}
    for i, name in enumerate(equations):
        parts = [bumps.values if k == i else csr_matrix(bumps.values.shape) for k in range(len(own))]
        weighing[name] = Weighing(csr_matrix(vstack(parts))[rows], nearest)
    of = rows // max(len(bumps), 1)
    rate = [reading.fits[k].rate(X[:, k]) for k in range(Y.shape[1])]
    return WeakPath(
        reading=reading,
        states=X,
        rates=np.column_stack(rate),
        weighing=weighing,
        measured=measured,
        simulated=simulated,
        noise=noise,
        explained=explained if len(rows) else 0.0,
        sizes={name: float(np.sqrt(np.mean(measured[of == i] ** 2))) for i, name in enumerate(equations)},
        time=np.tile(bumps.centre, len(own))[rows],
        run=np.tile(bumps.run, len(own))[rows],
    )


def _radius(time: np.ndarray, parts: Sequence[Stretch], half_width: int, n_equation: int) -> float:
    """Half the window of the narrowest cubic in time, but no fewer steps and no more rows than may be."""
    steps = np.concatenate([np.diff(time[slice(*part.rows)]) for part in parts])
    step, whole = float(np.median(steps)) if len(steps) else 1.0, float(np.sum(steps))
    # On uneven steps a bump needs its fewest samples on average.
    fewest = FEWEST_STEPS * max(step, float(np.mean(steps)) if len(steps) else step) * (1 + 1e-9)
    return max(half_width * step, fewest, EVERY * n_equation * whole / MOST_ROWS)


def _response(
    bumps: Bumps, J: np.ndarray, own: Sequence[int], sd: np.ndarray, order: np.ndarray
) -> csr_matrix:
    """L S^½ [n_row, n_state · n_sample]: what standard normal noise on every sample does to the rows."""
    lines = []
    for k in own:
        blocks = [bumps.values @ diags(J[:, k, j] * s) for j, s in enumerate(sd)]
        blocks[k] = blocks[k] + bumps.slopes * sd[k]
        lines.append(hstack(blocks))
    return csr_matrix(vstack(lines))[order]


def _noise(L: csr_matrix, run: np.ndarray, n_run: int) -> tuple[OverlappingNoise, np.ndarray]:
    """Noise of the rows, and which of them the rows before do not tell."""
    bands, kept, scale = [], [], float(np.sqrt(np.mean(L.multiply(L).sum(axis=1)))) if L.shape[0] else 1.0
    for r in range(n_run):
        rows = np.flatnonzero(run == r)
        band = _banded(L[rows] / scale)
        told = ~np.ones(len(rows), bool)
        try:
            factor = cholesky_banded(band, lower=True)
            full = bool(np.all(factor[0] ** 2 > TOLD * band[0]))
        except LinAlgError:
            full = False
        if not full:
            told = ~independent_rows(band)
            rows = rows[~told]
            band = _banded(L[rows] / scale)
        bands.append(band)
        kept.append(rows)
    return overlapping(bands, scale), np.concatenate(kept)


def _banded(L: csr_matrix) -> np.ndarray:
    """L Lᵀ in lower banded form."""
    lower = (L @ L.T).tocoo()
    below = lower.row >= lower.col
    row, column, value = lower.row[below], lower.col[below], lower.data[below]
    band = np.zeros((int(np.max(row - column, initial=0)) + 1, L.shape[0]))
    band[row - column, column] = value
    return band
