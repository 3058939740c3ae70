"""The efficient estimate of an oscillator's coefficients: generalised least squares at the truth, by SciPy alone.

Noise, and how large it is, are known, and so is the path near which rows are linear: y = y(θ) + S δ + e, e ~ N(0, C).
No unbiased estimate has smaller variances than (JᵀC⁻¹J)⁻¹, J = (∂y/∂θ, S), and to first order its intervals are exact:
where they miss, the draw of the noise was unlucky. Pushes are taken to move the path by little.
"""

from collections.abc import Callable, Mapping
from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp
from scipy.linalg import cho_factor, cho_solve, toeplitz

from .samples import CORRELATION, KICKS, SHAKEN, System
from .systems import systems

SLOPE_STEP = 1e-5
"""Step of central differences over coefficients and starts."""

TIGHT_DOP853 = {"rtol": 1e-9, "atol": 1e-11, "method": "DOP853"}

SHAPES = {"y": lambda y, v: y, "v": lambda y, v: v, "y**3": lambda y, v: y**3}
"""φ by name."""


def efficient_estimate(
    name: str, terms: Mapping[str, float], shown: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n_term"], Float[np.ndarray, " n_term"]]:
    """Return errors of the estimate, and its standard deviations.

    The oscillator of `systems` is y″ = F(t) + Σ θ_k φ_k(y, v), with true θ_k by φ_k, those of `SHAPES`.
    """
    path, weights, covariance = _known(name, tuple(terms.items()))
    return (weights @ (shown - path))[: len(terms)], np.sqrt(np.diag(covariance))[: len(terms)]


@cache
def _known(name: str, terms: tuple[tuple[str, float], ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the path, the matrix from residuals to estimates, and their covariance."""
    system = systems()[name]
    t, truth = system.step * np.arange(system.samples), np.array([*(b for _, b in terms), *system.start[0]])

    def path(at: np.ndarray) -> np.ndarray:
        rates = _oscillator(system, terms, at)
        return solve_ivp(rates, (t[0], t[-1]), at[len(terms) :], t_eval=t, **TIGHT_DOP853).y[0]

    y = path(truth)
    J = np.array([(path(truth + d) - path(truth - d)) / (2 * SLOPE_STEP) for d in SLOPE_STEP * np.eye(len(truth))]).T
    lag = CORRELATION ** np.arange(len(t)) if system.sensor == "correlated" else np.eye(1, len(t))[0]
    C = (system.noise * np.std(y)) ** 2 * toeplitz(lag)
    if system.shaken:
        answers = _answers(system, terms, truth, t)
        C += SHAKEN**2 * system.step / KICKS * answers @ answers.T
    factor = cho_factor(C)
    covariance = np.linalg.inv(J.T @ cho_solve(factor, J))
    return y, covariance @ cho_solve(factor, J).T, covariance


def _oscillator(system: System, terms: tuple[tuple[str, float], ...], at: np.ndarray) -> Callable:
    assert system.force is not None
    drive, shapes = system.force[0], [(b, SHAPES[name]) for b, (name, _) in zip(at, terms, strict=False)]
    return lambda t, x: [x[1], drive(t) + sum(b * shape(x[0], x[1]) for b, shape in shapes)]


def _answers(
    system: System, terms: tuple[tuple[str, float], ...], truth: np.ndarray, t: np.ndarray
) -> Float[np.ndarray, "n n_push"]:
    """Return the change of the position at each sample by a unit push of the speed at each moment, to first order."""
    rates, n = _oscillator(system, terms, truth), len(terms)
    moments = np.linspace(t[0], t[-1], KICKS * (len(t) - 1) + 1)

    def motion(time: float, x: np.ndarray) -> np.ndarray:
        state, change = x[:2], x[2:].reshape(2, 2)
        tangent = [
            (np.array(rates(time, state + d)) - rates(time, state - d)) / (2 * SLOPE_STEP)
            for d in SLOPE_STEP * np.eye(2)
        ]
        return np.concatenate([rates(time, state), (np.array(tangent).T @ change).ravel()])

    start = [*truth[n:], 1.0, 0.0, 0.0, 1.0]
    change = solve_ivp(motion, (t[0], t[-1]), start, t_eval=moments, **TIGHT_DOP853).y[2:].T.reshape(-1, 2, 2)
    # Φ(t) Φ(τ)⁻¹ takes a push at τ to t; the path knows nothing of later ones.
    answers = change[::KICKS, 0] @ np.linalg.inv(change)[:, :, 1].T
    answers[np.arange(len(moments)) > KICKS * np.arange(len(t))[:, None]] = 0.0
    return answers
