"""Noise that is not white: its correlation, its size along the path, and its tails, found on residuals.

Each suspect is weighed against noise as it is, on residuals of a hypothesis, all parameters summed over a grid with σ
integrated out, and then held at its mode; see `noise_model`. Sensor noise and an unknown force along a path are told
apart by the spectrum of the residual: what enters as a force rings as the system does.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from scipy.special import gammaln

from bayes_greybox.data.noise.weighted import WeightedNoise, correlation_and_sd, with_sd
from bayes_greybox.model.estimate.evidence import log_white, log_white_each
from bayes_greybox.model.gp.hyper import NoisePrior

from .in_time import Stamps, in_time
from .noise_model import CORRELATED, HEAVY, PROCESS, VARYING, NoiseModel, Suspicion, weighed_on_grid

PerRow = Float[np.ndarray, " n_obs"]
"""One number for each row."""

LEAST_ROWS = 20
"""Fewer residuals say nothing about their noise."""

NOISE_LEVELS = (0.05, 0.3, 1.0)
"""δ in σ(x) ∝ (δ² + (x/RMS)²)^(a/2): from where the noise grows, over the RMS of what it grows with."""

EXPONENTS = (-1.0, -0.5, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
"""a; 1 is noise proportional to |x|."""

DEGREES = (1.5, 2.0, 3.0, 4.0, 6.0, 10.0)
"""Degrees of freedom of Student's t."""


def suspicions(
    residual: PerRow, current: NoiseModel, time: PerRow, run: Int[np.ndarray, " n_obs"],
    quantities: Mapping[str, PerRow], prior: NoisePrior,
) -> list[Suspicion]:  # fmt: skip
    """Weigh every kind of noise that is not yet in the noise model."""
    if len(residual) < LEAST_ROWS or below_floor(residual, current, prior):
        return []
    weighed, whole = [], residual
    residual = current.noise.without_starts(residual[:, None])[:, 0]
    if not {CORRELATED, PROCESS} & set(current.names):
        stamps = Stamps(time, run)
        weighed.append(in_time(residual, current, stamps, prior, CORRELATED))
        # Where rows are samples of a path, a process of the system moves that.
        moved = len(current.noise.intensities) > 0
        weighed.append(force(whole, current, prior) if moved else in_time(residual, current, stamps, prior, PROCESS))
    if VARYING not in current.names:
        weighed.append(varying(residual, current, quantities, prior))
    if HEAVY not in current.names:
        weighed.append(heavy(residual, current, prior))
    return [s for s in weighed if s is not None and np.isfinite(s.log_bayes_factor)]


def below_floor(residual: PerRow, current: NoiseModel, prior: NoisePrior) -> bool:
    """Return whether residuals are below the noise floor of the prior, where nothing can be said of their noise."""
    return bool(np.mean(current.noise.whiten(residual[:, None]) ** 2) < prior.floor**2)


def varying(
    residual: PerRow, current: NoiseModel, quantities: Mapping[str, PerRow], prior: NoisePrior
) -> Suspicion | None:
    """Weigh noise that depends on the state, sd ∝ (δ² + (x/RMS)²)^(a/2); x, δ and a on a grid."""
    inner, sd = correlation_and_sd(current.noise)
    e = inner.whiten((residual / sd)[:, None])[:, 0]
    if not inner.square:
        return None
    n, choices, logs = len(e), [], []
    for name, x in quantities.items():
        size = float(np.sqrt(np.mean(x**2)))
        if not size > 0 or not np.isfinite(size):
            continue
        for level in NOISE_LEVELS:
            z = 0.5 * np.log(level**2 + (x / size) ** 2)
            z = z - np.mean(z)
            squares = np.array([np.sum(e**2 * np.exp(-2 * a * z)) for a in EXPONENTS])
            # Σ log sd = a Σ z = 0, as z has no mean
            logs.append(log_white_each(squares, n, prior))
            choices += [(name, level, z, a) for a in EXPONENTS]
    if not choices:
        return None
    every = np.concatenate(logs)
    name, level, z, a = choices[int(np.argmax(every))]
    noise = current.noise.with_error(with_sd(inner, sd * np.exp(a * z)))
    before = log_white(float(np.sum(e**2)), n, prior)
    about = {"variable": name, "exponent": float(a), "level": level}
    return weighed_on_grid(VARYING, every, np.full(len(every), -math.log(len(every))), before, noise, current, about)


def heavy(
    residual: PerRow, current: NoiseModel, prior: NoisePrior, degrees: Sequence[float] = DEGREES
) -> Suspicion | None:
    """Weigh Student's t of the whitened rows, degrees of freedom ν on a grid, the scale s integrated out.

    The noise model holds the weights of the mode's scale mixture, (ν + 1)/(ν + (e/s)²), which make the rows normal.
    """
    inner, sd = correlation_and_sd(current.noise)
    if not inner.square:
        return None
    e, n = inner.whiten((residual / sd)[:, None])[:, 0], len(residual)
    size = 1.4826 * float(np.median(np.abs(e))) or float(np.std(e))
    log_s = math.log(max(size, 1e-12)) + np.linspace(-0.9, 0.6, 46)

    def log_density(nu: float, log_s: np.ndarray) -> np.ndarray:
        constant = gammaln((nu + 1) / 2) - gammaln(nu / 2) - 0.5 * math.log(nu * math.pi)
        tails = np.sum(np.log1p((e / np.exp(log_s)[:, None]) ** 2 / nu), axis=1)
        cell = math.log(log_s[1] - log_s[0])
        return n * (constant - log_s) - 0.5 * (nu + 1) * tails + prior.log_density(log_s) + cell

    grids = [log_s] * len(degrees)
    density = np.array([log_density(nu, log_s) for nu in degrees])
    coarse = log_s[1] - log_s[0]
    if 1 / math.sqrt(2 * n) < coarse:
        # The scale is known to better than the grid's step: once more, finer, around each best node.
        fine = 2 * coarse * np.linspace(-1, 1, len(log_s))
        grids = [log_s[int(np.argmax(row))] + fine for row in density]
        density = np.array([log_density(nu, grid) for nu, grid in zip(degrees, grids, strict=True)])
    by_degree = np.logaddexp.reduce(density, axis=1)
    total = float(np.logaddexp.reduce(by_degree) - math.log(len(degrees)))
    k, j = np.unravel_index(int(np.argmax(density)), density.shape)
    nu = degrees[int(k)]
    scale = float(np.exp(grids[int(k)][j]))
    weight = (nu + 1) / (nu + (e / scale) ** 2)
    held = WeightedNoise(inner, sd / np.sqrt(weight))
    # Where rows hang together, weighted rows are not weighted innovations: both are measured on the rows themselves.
    square = float(np.sum(held.whiten(residual[:, None]) ** 2))
    at_mode = log_white(square, n, prior) - 0.5 * (held.log_det - current.noise.error.log_det)
    before = log_white(float(np.sum(e**2)), n, prior)
    about = {"degrees": nu, "scale": scale}
    model = replace(
        current, noise=current.noise.with_error(held), names=(*current.names, HEAVY),
        constant=current.constant + total - at_mode, about={**current.about, HEAVY: about},
    )  # fmt: skip
    return Suspicion(HEAVY, total - before, model)


def force(residual: PerRow, current: NoiseModel, prior: NoisePrior) -> Suspicion:
    """Weigh an unknown force, white in time, its intensity λ on a grid: p(e | λ) = ∫ N(e | 0, σ² R(λ)) p(σ) dσ."""

    def logs(intensities: np.ndarray) -> np.ndarray:
        noises = [current.noise.forced(float(each)) for each in intensities]
        squares = np.array([np.sum(noise.whiten(residual[:, None]) ** 2) for noise in noises])
        return log_white_each(squares, len(residual), prior) - 0.5 * np.array([noise.log_det for noise in noises])

    grid = np.asarray(current.noise.intensities, float)
    log_p = logs(grid)
    # In long records an intensity between two nodes is many nats likelier than either: the grid is refined until that
    # is one nat.
    for _ in range(4):
        best = int(np.argmax(log_p))
        if np.all(log_p[best] - log_p[max(best - 1, 0) : best + 2] < 1.0):
            break
        low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
        nearby = np.setdiff1d(np.geomspace(low, high, 9)[1:-1], grid)
        order = np.argsort(np.concatenate([grid, nearby]))
        grid, log_p = (np.concatenate(pair)[order] for pair in ((grid, nearby), (log_p, logs(nearby))))
    intensity = float(grid[int(np.argmax(log_p))])
    noise = current.noise.forced(intensity)
    square = float(np.sum(current.noise.whiten(residual[:, None]) ** 2))
    before = log_white(square, len(residual), prior) - 0.5 * current.noise.log_det
    # The share of the residuals' variance that the force makes.
    left = noise.without_starts(residual[:, None])[:, 0]
    sigma2 = float(np.mean(noise.whiten(residual[:, None]) ** 2))
    sensor = sigma2 * float(np.mean(1 / current.noise.error.precision_diagonal()))
    share = float(np.clip(1 - sensor / max(float(np.mean(left**2)), 1e-300), 0.0, 1.0))
    about = {"intensity": intensity, "share": share}
    # Uniform in log λ over the grid's range, by the trapezoidal rule.
    place = np.log(grid)
    width = (np.diff(place, prepend=place[0]) + np.diff(place, append=place[-1])) / 2
    return weighed_on_grid(PROCESS, log_p, np.log(width / (place[-1] - place[0])), before, noise, current, about)
