"""Noise that is not white: what residuals say of its correlation, of its size along the path, and of its tails.

Each suspect is weighed against noise as it is, on residuals e of an explanation, all parameters summed over a grid with
σ integrated out, and then held at its mode, R = R(mode). What holding costs and gains is kept as a constant, so that
evidences of explanations under different noise can be compared:

    log p(y | explanation, suspect) ≈ log N-evidence(y | R) + constant,   constant = log p(e) − log p(e | R).

Two kinds of processes hang together in time: a rough one is what sensors have (correlated noise); a smooth one moves as
systems move, and is something that the model lacks.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.special import gammaln

from bayes_greybox.data.noise.protocol import RowNoise
from bayes_greybox.data.noise.state_space import StateSpaceNoise
from bayes_greybox.data.noise.weighted import WeightedNoise
from bayes_greybox.model.evidence import Spectrum, marginal
from bayes_greybox.model.gp.hyper import NoisePrior

CORRELATED, PROCESS = "correlated noise", "process in time"
"""The suspect, and what is left over where the correlation is smooth: no suspect but a gap."""

VARYING, HEAVY = "state-dependent noise", "heavy tails"

LEAST_ROWS = 20
"""Fewer residuals say nothing about their noise."""

STRETCH = 2048
"""Longer records are cut into stretches of so many rows, filtered side by side, each as a run of its own."""

TIME_STEPS, TIME_SPREAD = 10.0, 1.5
"""τ ~ LogNormal: its median in sampling steps, and the standard deviation of its logarithm."""

WHITE_SHARES = {
    CORRELATED: (0.0, 0.05, 0.15, 0.3, 0.5, 0.7, 0.85, 0.95),
    PROCESS: (0.003, 0.01, 0.03, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.95, 0.98),
}
"""Grid of the white share of the variance, even prior weights. A process of a system needs some white noise beside it:
samples are never exact."""

SHORTEST = {CORRELATED: 1.0, PROCESS: 3.0}
"""Least τ in steps: the motion of a system is resolved by its samples, or nobody could model it."""

LEVELS = (0.05, 0.3, 1.0)
"""δ in σ(x) ∝ (δ² + (x/RMS)²)^(a/2): from where the noise grows, over the RMS of what it grows with."""

EXPONENTS = (-1.0, -0.5, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
"""a; 1 is noise proportional to |x|."""

DEGREES = (1.5, 2.0, 3.0, 4.0, 6.0, 10.0)
"""Degrees of freedom of Student's t."""


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Noise of rows, with what it is called.

    Attributes:
        names: The suspects in it; none for noise as it was given.
        noise: R.
        constant: See the module's equation; sums over suspects.
        about: What is known of each suspect, by name.
        tail_weights: What heavy tails multiply each row's 1/σ² with, found on the residuals; None without heavy tails.
    """

    noise: RowNoise
    names: tuple[str, ...] = ()
    constant: float = 0.0
    about: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    tail_weights: Float[np.ndarray, " n_obs"] | None = None

    @property
    def body(self) -> RowNoise:
        """R without the weights of heavy tails: what is whitened by it has Student's t, where R makes it light."""
        if self.tail_weights is None:
            return self.noise
        inner, sd = _parts(self.noise)
        return _joined(inner, sd * np.sqrt(self.tail_weights))

    @property
    def process_share(self) -> float:
        """Share of the residuals' variance that is a smooth process in time."""
        return float(self.about[PROCESS]["share"]) if PROCESS in self.about else 0.0


@dataclass(frozen=True, eq=False)
class Suspicion:
    """One suspect, weighed on residuals.

    Attributes:
        name: Of the suspect.
        log_bayes_factor: Over noise as it is.
        model: The noise with the suspect in it.
    """

    name: str
    log_bayes_factor: float
    model: NoiseModel


def suspicions(
    residual: Float[np.ndarray, " n_obs"],
    known: NoiseModel,
    time: Float[np.ndarray, " n_obs"],
    run: Int[np.ndarray, " n_obs"],
    quantities: Mapping[str, Float[np.ndarray, " n_obs"]],
    prior: NoisePrior,
) -> list[Suspicion]:
    """Weigh every suspect that is not yet in the noise.

    Args:
        residual: Measured less explained rate, scaled units.
        known: Noise as it is; a process in time is weighed on independent rows only.
        time: Times, increasing within a run.
        run: Run of each row.
        quantities: What the noise may grow with, by name.
        prior: Prior of σ.
    """
    if len(residual) < LEAST_ROWS or below_floor(residual, known, prior):
        return []
    found = []
    if not {CORRELATED, PROCESS} & set(known.names):
        found += [in_time(residual, known, time, run, prior, name) for name in (CORRELATED, PROCESS)]
    if VARYING not in known.names:
        found.append(varying(residual, known, quantities, prior))
    if HEAVY not in known.names:
        found.append(heavy(residual, known, prior))
    return [s for s in found if s is not None and np.isfinite(s.log_bayes_factor)]


def below_floor(residual: Float[np.ndarray, " n_obs"], known: NoiseModel, prior: NoisePrior) -> bool:
    """Whether residuals are less than what rows are known to at best: nothing can be said of their noise.

    Args:
        residual: Measured less explained rate, scaled units.
        known: Noise as it is.
        prior: Prior of σ, with its floor.
    """
    return bool(np.mean(known.noise.whiten(residual[:, None]) ** 2) < prior.floor**2)


def _parts(noise: RowNoise) -> tuple[RowNoise, np.ndarray]:
    """Correlation and standard deviations."""
    return (noise.inner, noise.sd) if isinstance(noise, WeightedNoise) else (noise, np.ones(noise.n_obs))


def _joined(inner: RowNoise, sd: np.ndarray) -> RowNoise:
    return inner if np.all(sd == 1.0) else WeightedNoise(inner, sd)


def _log_white(square: Float[np.ndarray, " n_grid"] | float, n: int, prior: NoisePrior) -> np.ndarray:
    """Log p of n white numbers with sums of squares, σ integrated out."""
    squares = np.atleast_1d(np.asarray(square, float))
    zeros = np.zeros((len(squares), 1))
    spectrum = Spectrum(zeros, zeros, np.zeros((len(squares), 1, 1)), squares[:, None], n)
    return marginal(spectrum, prior).log_evidence


def log_white(square: float, n: int, prior: NoisePrior) -> float:
    """Log p of n white numbers with this sum of squares, σ integrated out."""
    return float(_log_white(square, n, prior)[0])


def _suspicion(
    name: str, logs: np.ndarray, log_prior: np.ndarray, before: float, noise: RowNoise, known: NoiseModel, about: dict
) -> Suspicion:
    total = float(np.logaddexp.reduce((logs + log_prior).ravel()))
    constant = known.constant + total - float(np.max(logs))
    model = replace(
        known, noise=noise, names=(*known.names, name), constant=constant, about={**known.about, name: about}
    )
    return Suspicion(name, total - before, model)


def in_time(
    residual: Float[np.ndarray, " n_obs"],
    known: NoiseModel,
    time: Float[np.ndarray, " n_obs"],
    run: Int[np.ndarray, " n_obs"],
    prior: NoisePrior,
    name: str,
    time_scale: float | None = None,
) -> Suspicion | None:
    """Weigh a process in time, σ² [(1 − w) k(·/τ) + w δ], τ and w on a grid.

    Args:
        residual: Measured less explained rate, scaled units.
        known: Noise as it is, without a process in time.
        time: Times, increasing within a run.
        run: Run of each row.
        prior: Prior of σ.
        name: `CORRELATED` or `PROCESS`.
        time_scale: τ in units of time, if it is known.

    Returns:
        The suspicion; None where each run has one row.
    """
    process = "exponential" if name == CORRELATED else "matern32"
    sd = _parts(known.noise)[1]
    e = residual / sd
    values, step, used = _stretches(e, time, run)
    within = step[np.isfinite(step) & used]
    if not len(within):
        return None
    typical, n = float(np.median(within)), len(e)
    longest = max(math.log(max(np.bincount(run - run.min()))), 1.0)
    taus = np.exp(np.arange(math.log(SHORTEST[name]), max(longest, 1.8) + 0.3, 0.55))
    if time_scale is not None:
        taus = np.array([time_scale / typical])
    shares = np.array(WHITE_SHARES[name])
    logs = _filtered(values, step / typical, used, process, taus, shares, n, prior)
    # Once finer around the best, so that what is held is the mode.
    i, j = np.unravel_index(int(np.argmax(logs)), logs.shape)
    fine_tau = taus[i] * np.exp(np.linspace(-0.45, 0.45, 7)) if time_scale is None else taus
    low, high = shares[max(j - 1, 0)], shares[min(j + 1, len(shares) - 1)]
    fine_share = np.linspace(low, high, 7)
    fine = _filtered(values, step / typical, used, process, fine_tau, fine_share, n, prior)
    k, m = np.unravel_index(int(np.argmax(fine)), fine.shape)
    # The prior of τ on the coarse grid; the fine one only moves the mode.
    z = (np.log(taus) - math.log(TIME_STEPS)) / TIME_SPREAD
    log_prior = (-0.5 * z**2 - np.logaddexp.reduce(-0.5 * z**2))[:, None] - math.log(len(shares)) + 0 * shares
    tau, white = float(fine_tau[k] * typical), float(fine_share[m])
    runs = tuple(time[run == r] for r in dict.fromkeys(run.tolist()))
    noise = _joined(StateSpaceNoise(runs, process, tau, white), sd)
    before = float(_log_white(float(np.sum(e**2)), n, prior)[0])
    neighbours = 1.0 if process == "exponential" else 1 + math.sqrt(3) * typical / tau
    neighbours *= math.exp(-typical / tau * (1.0 if process == "exponential" else math.sqrt(3)))
    about = {"time_scale": tau, "white": white, "share": 1 - white, "correlation": (1 - white) * neighbours}
    found = _suspicion(name, logs, log_prior, before, noise, known, about)
    lift = float(np.max(logs)) - float(np.max(fine))
    return replace(found, model=replace(found.model, constant=found.model.constant + lift))


def varying(
    residual: Float[np.ndarray, " n_obs"],
    known: NoiseModel,
    quantities: Mapping[str, Float[np.ndarray, " n_obs"]],
    prior: NoisePrior,
) -> Suspicion | None:
    """Weigh noise that depends on the state, sd ∝ (δ² + (x/RMS)²)^(a/2); x, δ and a on a grid.

    Args:
        residual: Measured less explained rate, scaled units.
        known: Noise as it is.
        quantities: What x may be, by name.
        prior: Prior of σ.

    Returns:
        The suspicion; None where nothing varies.
    """
    inner, sd = _parts(known.noise)
    e = inner.whiten((residual / sd)[:, None])[:, 0]
    if not inner.square:
        return None
    n, choices, logs = len(e), [], []
    for name, x in quantities.items():
        size = float(np.sqrt(np.mean(x**2)))
        if not size > 0 or not np.isfinite(size):
            continue
        for level in LEVELS:
            z = 0.5 * np.log(level**2 + (x / size) ** 2)
            z = z - np.mean(z)
            squares = np.array([np.sum(e**2 * np.exp(-2 * a * z)) for a in EXPONENTS])
            # Σ log sd = a Σ z = 0, as z has no mean
            logs.append(_log_white(squares, n, prior))
            choices += [(name, level, z, a) for a in EXPONENTS]
    if not choices:
        return None
    every = np.concatenate(logs)
    name, level, z, a = choices[int(np.argmax(every))]
    noise = _joined(inner, sd * np.exp(a * z))
    before = float(_log_white(float(np.sum(e**2)), n, prior)[0])
    about = {"variable": name, "exponent": float(a), "level": level}
    return _suspicion(VARYING, every, np.full(len(every), -math.log(len(every))), before, noise, known, about)


def heavy(
    residual: Float[np.ndarray, " n_obs"],
    known: NoiseModel,
    prior: NoisePrior,
    degrees: Sequence[float] = DEGREES,
) -> Suspicion | None:
    """Weigh Student's t of the whitened rows, degrees of freedom ν on a grid, the scale s integrated out.

    Held are the weights of the mode's scale mixture, (ν + 1)/(ν + (e/s)²), which make the rows normal.

    Args:
        residual: Measured less explained rate, scaled units.
        known: Noise as it is.
        prior: Prior of σ, here of s.
        degrees: Grid of ν.

    Returns:
        The suspicion; None for whitened coefficients that are no rows.
    """
    inner, sd = _parts(known.noise)
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

    grids = [log_s + 0.0 for _ in degrees]
    density = np.array([log_density(nu, grid) for nu, grid in zip(degrees, grids, strict=True)])
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
    at_mode = float(_log_white(square, n, prior)[0]) - 0.5 * (held.log_det - known.noise.log_det)
    before = float(_log_white(float(np.sum(e**2)), n, prior)[0])
    about = {"degrees": nu, "scale": scale}
    model = replace(
        known, noise=held, names=(*known.names, HEAVY), constant=known.constant + total - at_mode,
        about={**known.about, HEAVY: about}, tail_weights=weight,
    )  # fmt: skip
    return Suspicion(HEAVY, total - before, model)


def _stretches(e: np.ndarray, time: np.ndarray, run: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The whole record cut side by side [n_stretch, width]: values, times since the rows before, rows in use."""
    n = len(e)
    step = np.where(np.diff(run, prepend=-1) != 0, np.inf, np.diff(time, prepend=time[0]))
    width = min(STRETCH, n)
    rows = np.arange(0, n, width)[:, None] + np.arange(width)
    used = rows < n
    rows = np.minimum(rows, n - 1)
    step = np.where(used, step[rows], np.inf)
    step[:, 0] = np.inf
    return np.where(used, e[rows], 0.0), step, used


def _filtered(
    e: np.ndarray, step: np.ndarray, used: np.ndarray, process: str, taus: np.ndarray, shares: np.ndarray, n: int,
    prior: NoisePrior,
) -> Float[np.ndarray, "n_tau n_share"]:  # fmt: skip
    """Log p(e | τ, w), σ integrated out, on a grid; all stretches and grid points go through the rows together."""
    tau, w = (grid.ravel()[:, None] for grid in np.meshgrid(taus, shares, indexing="ij"))
    amplitude = 1 - w
    square, log_det = np.zeros((len(tau), 1)), np.zeros((len(tau), 1))
    shape = (len(tau), len(e))
    smooth = process == "matern32"
    m0, m1 = np.zeros(shape), np.zeros(shape)
    p00, p01, p11 = np.broadcast_to(amplitude, shape).copy(), np.zeros(shape), np.broadcast_to(amplitude, shape).copy()
    for t in range(e.shape[1]):
        fresh = ~np.isfinite(step[:, t])
        if t and not fresh.all():
            x = np.where(fresh, 0.0, step[:, t]) / tau
            if smooth:
                x = math.sqrt(3) * x
                fade = np.exp(-x)
                a, b, c, d = (1 + x) * fade, x * fade, -x * fade, (1 - x) * fade
                m0, m1 = a * m0 + b * m1, c * m0 + d * m1
                q = amplitude
                n00 = a * a * p00 + 2 * a * b * p01 + b * b * p11 + q * (1 - a * a - b * b)
                n01 = a * c * p00 + (a * d + b * c) * p01 + b * d * p11 - q * (a * c + b * d)
                n11 = c * c * p00 + 2 * c * d * p01 + d * d * p11 + q * (1 - c * c - d * d)
                p00, p01, p11 = n00, n01, n11
            else:
                a = np.exp(-x)
                m0, p00 = a * m0, a * a * p00 + amplitude * (1 - a * a)
        if fresh.any():
            m0, m1 = np.where(fresh, 0.0, m0), np.where(fresh, 0.0, m1)
            p00, p01 = np.where(fresh, amplitude, p00), np.where(fresh, 0.0, p01)
            p11 = np.where(fresh, amplitude, p11)
        S = p00 + w
        v = e[:, t] - m0
        on = used[:, t]
        square += np.sum(np.where(on, v * v / S, 0.0), axis=1, keepdims=True)
        log_det += np.sum(np.where(on, np.log(S), 0.0), axis=1, keepdims=True)
        k0 = p00 / S
        m0 = m0 + k0 * v
        if smooth:
            k1 = p01 / S
            m1 = m1 + k1 * v
            p11, p01, p00 = p11 - k1 * p01, p01 * (1 - k0), p00 * (1 - k0)
        else:
            p00 = p00 * (1 - k0)
    logs = _log_white(square[:, 0], n, prior) - 0.5 * log_det[:, 0]
    return logs.reshape(len(taus), len(shares))
