"""Evidence that residuals hang together in time: a gap that no function of the states in the model can show.

An effect with memory, a hidden state, or a function of the states too fine for the features of f leaves residuals
that are small beside the noise everywhere and yet correlated from one sample to the next. Against white residuals
stands

    e(t) = g(t) + ε,   g an Ornstein-Uhlenbeck process with standard deviation a and correlation time τ, one a run,

whose likelihood a Kalman filter gives in O(n) (Särkkä & Solin 2019, Applied Stochastic Differential Equations, 12.3).
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array, Float

from bayes_greybox.model.evidence import Spectrum, marginal
from bayes_greybox.model.hyper import NoisePrior, log_half_normal

STRETCH, STRETCHES = 512, 8
"""Records are cut into stretches of so many rows, filtered side by side, each as a run of its own; of longer records
so many evenly spaced ones are used."""

TIME_STEPS, TIME_SPREAD = 10.0, 1.0
"""τ ~ LogNormal: its median in sampling steps, and the standard deviation of its logarithm. Far below one step an
Ornstein-Uhlenbeck process is white noise again, and would be counted twice."""


def correlation_evidence(
    residual: Float[np.ndarray, " n_obs"],
    time: Float[np.ndarray, " n_obs"],
    run: np.ndarray,
    noise: NoisePrior,
    amplitude: float,
) -> float:
    """Log Bayes factor of residuals that hang together in time over white ones, by Laplace's approximation.

    Args:
        residual: Measured less modelled rate, scaled units.
        time: Times, increasing within a run.
        run: Run of each row.
        noise: Prior of σ.
        amplitude: Scale of the half-normal prior of a.

    Returns:
        log p(e | OU + white) − log p(e | white); positive speaks for a gap.
    """
    residual, step, used = _stretches(residual, time, run)
    n, within = int(np.sum(used)), step[np.isfinite(step)]
    if n < 20 or not len(within):
        # Too few rows, or none that follows another.
        return -math.inf
    typical = float(np.median(within))
    arrays = {
        "e": jnp.asarray(residual),
        # Finite, so that the gradient of exp(-step/τ) is 0 and not ∞ x 0.
        "step": jnp.asarray(np.minimum(step / typical, 1e9)),
        "used": jnp.asarray(used),
        "prior": jnp.asarray([noise.floor, noise.scale, amplitude, TIME_STEPS, TIME_SPREAD]),
    }

    def descend(eta: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = _value_and_slope(jnp.asarray(eta), arrays)
        return -float(value), -np.asarray(slope)

    size = math.log(max(float(np.std(residual[used])), 1e-8))
    bounds = [(-18.0, 3.0), (-18.0, 5.0), (math.log(1.0), math.log(1e4))]
    found = min(
        (
            scipy.optimize.minimize(descend, start, jac=True, method="L-BFGS-B", bounds=bounds)
            for start in ([size, size - 1.5, math.log(TIME_STEPS)], [size - 1.5, size, math.log(3.0)])
        ),
        key=lambda result: result.fun,
    )
    shifts = 1e-3 * np.eye(3)
    hessian = np.stack([(descend(found.x + h)[1] - descend(found.x - h)[1]) / 2e-3 for h in shifts])
    curvature = np.maximum(np.linalg.eigvalsh(0.5 * (hessian + hessian.T)), 0.1)
    log_z = -found.fun + 0.5 * (3 * math.log(2 * math.pi) - np.sum(np.log(curvature)))
    square = float(np.sum(residual[used] ** 2))
    white = Spectrum(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1, 1)), square, float(n))
    return float(log_z - marginal(white, noise).log_evidence[0])


def _stretches(residual: np.ndarray, time: np.ndarray, run: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stretches of rows, times since the rows before (infinite at a start), and which entries are rows of the data."""
    n = len(residual)
    step = np.where(np.diff(run, prepend=-1) != 0, np.inf, np.diff(time, prepend=time[0]))
    width = min(STRETCH, _power_of_two(n))
    starts = np.arange(0, n, width) if n <= STRETCH * STRETCHES else np.linspace(0, n - width, STRETCHES).astype(int)
    # Powers of two, so that few shapes are compiled.
    starts = np.pad(starts, (0, _power_of_two(len(starts)) - len(starts)), constant_values=n)
    rows = starts[:, None] + np.arange(width)
    used = rows < n
    rows = np.minimum(rows, n - 1)
    step = np.where(used, step[rows], np.inf)
    step[:, 0] = np.inf
    return np.where(used, residual[rows], 0.0), step, used


def _power_of_two(n: int) -> int:
    return 1 << (n - 1).bit_length()


def _log_joint(eta: Array, a: dict[str, Array]) -> Array:
    floor, noise_scale, amplitude_scale, centre, spread = a["prior"]
    noise = NoisePrior(floor, noise_scale)
    log_s, log_a, log_tau = eta
    s2, variance = noise.sigma(log_s) ** 2, jnp.exp(2 * log_a)

    def advance(state: tuple[Array, Array], row: tuple[Array, Array, Array]) -> tuple[tuple[Array, Array], Array]:
        (m, P), (e, step, used) = state, row
        phi = jnp.exp(-step / jnp.exp(log_tau))
        m, P = phi * m, phi**2 * P + variance * (1 - phi**2)
        S = P + s2
        log_p = -0.5 * (jnp.log(2 * math.pi * S) + (e - m) ** 2 / S)
        return (m + P / S * (e - m), P * s2 / S), jnp.where(used, log_p, 0.0)

    def follow(stretch: tuple[Array, Array, Array]) -> Array:
        return jax.lax.scan(advance, (jnp.zeros(()), variance), stretch)[1]

    terms = jax.vmap(follow)((a["e"], a["step"], a["used"]))
    z = (log_tau - jnp.log(centre)) / spread
    prior = noise.log_density(log_s) + log_half_normal(log_a, amplitude_scale)
    return jnp.sum(terms) + prior - 0.5 * z**2 - jnp.log(spread * math.sqrt(2 * math.pi))


_value_and_slope = jax.jit(jax.value_and_grad(_log_joint))
