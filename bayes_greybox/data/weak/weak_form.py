"""Test functions φ of the weak form, with sums over samples for integrals with them, and cubics through neighbours.

    φ(t) ∝ (1 − u²)^p,   u = (t − t₀)/r in −1 … 1,   ∫ φ dt = 1,

so that ∫ φ ẋ dt = −∫ φ̇ x dt without a boundary term (Messenger & Bortz 2021, Multiscale Model. Simul. 19:1474). On even
steps the trapezoidal rule is exact but for what a bump holds at the sampling frequency; on others a cubic through the
four nearest samples is integrated with φ.

Cubics through a few neighbours of each sample estimate a path under noise. More neighbours average more noise away and
lose more of the path. With noise of a known standard deviation s the mean square error of the fits H x can be estimated
from the data alone (Stein 1981, Ann. Statist. 9:1135), as mean (x − H x)² + 2 s² tr H / n − s².
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix, vstack
from scipy.special import beta

from bayes_greybox.data.rates.filters import STEP_TOLERANCE
from bayes_greybox.data.runs.gaps import after_gaps

# Numbers of neighbours on either side that are tried.
HALF_WIDTHS = (2, 3, 4, 5, 6, 8, 10, 13, 16, 20, 25, 32, 40, 50, 64, 80, 100, 125, 160, 200)
FEWEST_FITS = 8  # windows that a stretch holds at least for a width to be tried
MOST_FITS = 2000  # samples, evenly thinned, at which widths are compared
WEIGHTS_AT_ONCE = 200_000  # weights that are computed at once


@dataclass(frozen=True)
class Stretch:
    """Samples of one run without a gap: its number, the first row, and the row behind the last."""

    run: int
    rows: tuple[int, int]


def stretches(time: Float[np.ndarray, " n"], run_lengths: Sequence[int]) -> list[Stretch]:
    """Return the runs, parted at gaps."""
    parts, start = [], 0
    for run, n in enumerate(run_lengths):
        edges = [0, *after_gaps(time[start : start + n], usual=0.5), n]
        parts += [Stretch(run, (start + a, start + b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]
        start += n
    return parts


@dataclass(frozen=True, eq=False)
class LocalFits:
    """Cubics of one width, at every sample."""

    neighbours: Int[np.ndarray, "n m"]  # samples of each fit
    value: Float[np.ndarray, "n m"]  # weights of the neighbours in the fit's value at the sample
    slope: Float[np.ndarray, "n m"]  # weights of the neighbours in the fit's slope at the sample
    leverage: Float[np.ndarray, " n"]  # weight of the sample itself

    @classmethod
    def of(
        cls, time: Float[np.ndarray, " n"], parts: Sequence[Stretch], half_width: int, at: np.ndarray | None = None
    ) -> "LocalFits":
        """Fit at some samples, or all, over so many neighbours on either side; on one side at the end of a stretch."""
        width = 2 * half_width + 1
        at = np.arange(len(time)) if at is None else at
        neighbours, used = np.zeros((len(at), width), int), np.ones((len(at), width), bool)
        for part in parts:
            start, stop = part.rows
            inside = slice(*np.searchsorted(at, (start, stop)))
            k = min(width, stop - start)
            first = np.clip(at[inside] - k // 2, start, stop - k)
            neighbours[inside] = np.minimum(first[:, None] + np.arange(width), stop - 1)
            used[inside, k:] = False
        value, slope = np.zeros(neighbours.shape), np.zeros(neighbours.shape)
        for rows in np.array_split(np.arange(len(at)), max(1, neighbours.size // WEIGHTS_AT_ONCE)):
            value[rows], slope[rows] = _weights(time[neighbours[rows]] - time[at[rows], None], used[rows])
        itself = (neighbours == at[:, None]) & used
        return cls(neighbours, value, slope, np.sum(np.where(itself, value, 0.0), axis=1))

    def smooth(self, column: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n_fit"]:
        """Return H x."""
        return np.sum(self.value * column[self.neighbours], axis=1)

    def rate(self, column: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n_fit"]:
        """Return the slopes of the fits."""
        return np.sum(self.slope * column[self.neighbours], axis=1)


def chosen_half_widths(
    time: Float[np.ndarray, " n"], columns: Float[np.ndarray, "n k"], noise: Float[np.ndarray, " k"],
    parts: Sequence[Stretch],
) -> tuple[int, ...]:  # fmt: skip
    """Choose the neighbours on either side with the least estimated mean square error, for columns with noise s."""
    longest = max(part.rows[1] - part.rows[0] for part in parts)
    at = np.unique(np.linspace(0, len(time) - 1, MOST_FITS).astype(int))
    tried = [m for m in HALF_WIDTHS if m == HALF_WIDTHS[0] or longest >= FEWEST_FITS * (2 * m + 1)]
    errors = []
    for half_width in tried:
        fits = LocalFits.of(time, parts, half_width, at)
        square = np.array([np.mean((x[at] - fits.smooth(x)) ** 2) for x in columns.T])
        errors.append(square + 2 * noise**2 * np.mean(fits.leverage))
    return tuple(tried[k] for k in np.argmin(errors, axis=0))


def _weights(offset: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return weights of value and slope of least-squares cubics at offset zero; of fewer samples lower degrees."""
    size = np.max(np.abs(np.where(used, offset, 0.0)), axis=1)
    size = np.where(size > 0, size, 1.0)
    u = np.where(used, offset / size[:, None], 0.0)
    count = used.sum(axis=1)
    A = np.stack([np.where(used & (count > degree)[:, None], u**degree, 0.0) for degree in range(4)], axis=-1)
    # Normal equations are harmless for a polynomial of degree three in −1 … 1.
    gram = np.einsum("nmi,nmj->nij", A, A)
    gram = gram + np.einsum("ni,ij->nij", (count[:, None] <= np.arange(4)).astype(float), np.eye(4))
    solved = np.einsum("nij,nmj->nmi", np.linalg.inv(gram), A)
    return solved[..., 0], solved[..., 1] / size[:, None]


POWER = 8  # p: at the ends of a bump its first seven derivatives vanish
CENTRES_PER_RADIUS = 4  # neighbours overlap by seven eighths; whitening accounts for the samples they share
FEWEST_RADIUS_STEPS = 8  # fewest steps of a radius: fewer do not integrate a bump
NODES_PER_STEP = 6  # nodes of Gauss and Legendre in each step, where steps are uneven


@dataclass(frozen=True, eq=False)
class Bumps:
    """Test functions along runs, in order of time."""

    radius: float  # r, units of time
    values: csr_matrix  # matrix of ∫ φ f dt from values of f at the samples [n_bump, n_sample]
    slopes: csr_matrix  # matrix of ∫ φ̇ f dt
    centre: Float[np.ndarray, " n_bump"]  # t₀
    run: Int[np.ndarray, " n_bump"]  # number of the run of each bump
    sample: Int[np.ndarray, " n_bump"]  # nearest sample to each centre

    @classmethod
    def along(
        cls, time: Float[np.ndarray, " n"], parts: Sequence[Stretch], radius: float, every: int = CENTRES_PER_RADIUS
    ) -> "Bumps":
        """Place all bumps of radius r that lie within their stretch, with centres r / every apart."""
        placed = [_bumps_of_stretch(time, part, radius, every) for part in parts]
        none, empty = np.zeros(0, int), csr_matrix((0, len(time)))
        pieces = [(empty, empty, np.zeros(0), none, none), *(piece for piece in placed if piece is not None)]
        values, slopes, *others = zip(*pieces, strict=True)
        return cls(radius, csr_matrix(vstack(values)), csr_matrix(vstack(slopes)), *map(np.concatenate, others))

    def __len__(self) -> int:
        return len(self.centre)


def bump(u: Float[np.ndarray, "*n"], radius: float) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """Return φ and φ̇ at places u = (t − t₀)/r of a bump; both are zero outside −1 … 1."""
    inside = np.clip(1.0 - u * u, 0.0, None)
    # ∫ (1 − u²)^p du = B(½, p + 1)
    size = 1.0 / (radius * beta(0.5, POWER + 1))
    return size * inside**POWER, -2.0 * POWER * size / radius * u * inside ** (POWER - 1)


def _bumps_of_stretch(time: np.ndarray, part: Stretch, radius: float, every: int) -> tuple[Any, ...] | None:
    """Return the bumps of one stretch: both matrices, centres, runs and nearest samples; None if it is too short."""
    start, stop = part.rows
    t = time[start:stop]
    if len(t) < 2 * FEWEST_RADIUS_STEPS + 1:
        return None
    steps = np.diff(t)
    step, even = float(np.mean(steps)), bool(np.ptp(steps) <= 2 * STEP_TOLERANCE * np.mean(steps))
    if even:
        # Centres and ends on samples: sums of φ̇ vanish as its integral does.
        half = round(radius / step)
        if half < FEWEST_RADIUS_STEPS or len(t) < 2 * half + 1:
            return None
        at = np.arange(half, len(t) - half, max(1, half // every))
        centre, radius = t[at], half * step
        nodes, weights, places = t, np.full(len(t), step), None
    else:
        span = t[-1] - t[0]
        if radius < FEWEST_RADIUS_STEPS * step or span < 2 * radius:
            return None
        count = math.floor((span - 2 * radius) * every / radius) + 1
        centre = np.linspace(t[0] + radius, t[-1] - radius, count)
        at = np.argmin(np.abs(t[None] - centre[:, None]), axis=1)
        nodes, weights, places = _quadrature(t)
    first, last = np.searchsorted(nodes, centre - radius), np.searchsorted(nodes, centre + radius)
    # One node more on either side: those outside the bump weigh nothing.
    reach = int(np.max(last - first)) + 2
    columns = np.clip(first - 1, 0, None)[:, None] + np.arange(reach)
    inside = columns < len(nodes)
    columns = np.minimum(columns, len(nodes) - 1)
    phi, slope = bump((nodes[columns] - centre[:, None]) / radius, radius)
    rows = np.repeat(np.arange(len(centre)), reach)
    matrices = []
    for each in (phi, slope):
        entries = np.where(inside, each * weights[columns], 0.0)
        table = csr_matrix((entries.ravel(), (rows, columns.ravel())), shape=(len(centre), len(nodes)))
        table = table if places is None else csr_matrix(table @ places)
        table.eliminate_zeros()
        matrices.append(csr_matrix((table.data, table.indices + start, table.indptr), shape=(len(centre), len(time))))
    return matrices[0], matrices[1], centre, np.full(len(centre), part.run), start + at


def _quadrature(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, csr_matrix]:
    """Return nodes and weights over the steps, and the matrix from samples to the cubics between them at the nodes."""
    n = len(t)
    place, weight = np.polynomial.legendre.leggauss(NODES_PER_STEP)
    h = np.diff(t)
    nodes = t[:-1, None] + 0.5 * h[:, None] * (1 + place)
    four = np.clip(np.arange(n - 1) - 1, 0, n - 4)[:, None] + np.arange(4)
    samples = t[four]
    # Lagrange's polynomials: ∏ (τ − t_l)/(t_j − t_l)
    basis = np.ones((n - 1, NODES_PER_STEP, 4))
    for j, k in permutations(range(4), 2):
        basis[:, :, j] *= (nodes - samples[:, k, None]) / (samples[:, j] - samples[:, k])[:, None]
    rows = np.repeat(np.arange(nodes.size), 4)
    columns = np.repeat(four[:, None], NODES_PER_STEP, axis=1).ravel()
    cubics = csr_matrix((basis.ravel(), (rows, columns)), shape=(nodes.size, n))
    return nodes.ravel(), (0.5 * h[:, None] * weight).ravel(), cubics
