"""Coefficients with bounds: a normal restricted to a box, as a function of uniform numbers, and sums over patterns.

The probability that a normal vector lies in a box has no closed form beyond one dimension, but it is the mean of a
product of one-dimensional ones over uniform u (Geweke 1991, Hajivassiliou & McFadden 1998; Genz 1992, Eq. 2.3):

    P(a ≤ z ≤ b) = ∫_[0,1]^B Π_k [Φ(b_k) − Φ(a_k)] du,   a_k, b_k the bounds of z_k given z_1 … z_(k−1),
    z_k = m_k + √v_k Φ⁻¹(Φ(a_k) + u_k (Φ(b_k) − Φ(a_k))).

A sampler that has u among its coordinates, and the product in its density, therefore has the exact posterior, and z
is a function of what it draws.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import log_ndtr, ndtri
from jaxtyping import Array, Float

from .collapsed import patterns
from .linalg import PerTerm

LEAST_LOG_PROBABILITY = -600.0
"""Least logarithm of a probability that is still a number; below it a quantile is found by Newton steps."""


class Bounds(NamedTuple):
    """Least and largest values of some u = (θ − mean)/sd, and the numbers between 0 and 1 that place them."""

    lower: Float[Array, " n_bounded"]
    upper: Float[Array, " n_bounded"]
    uniform: Float[Array, " n_bounded"]


class BoundedPatterns(NamedTuple):
    """Every inclusion pattern γ, its log p(y, γ | u) − log p(y | γ = 1), and standardised bounded coefficients z."""

    log_weight: Float[Array, " n_pattern"]
    z: Float[Array, "n_pattern n_bounded"]
    included: Float[np.ndarray, "n_pattern n_term"]


def bounded_patterns(
    mean: PerTerm, covariance: Float[Array, "n_term n_term"], log_odds: PerTerm | None, bounds: Bounds,
    bounded: tuple[int, ...], certain: tuple[int, ...] = (),
) -> BoundedPatterns:  # fmt: skip
    """Return `log_pattern_weights` where some coefficients have bounds; one pattern where there are no odds.

    The bounded terms come last in the recursion. One that is in is placed given those before it, so that the others are
    conditioned on its value as on the zero of one that is out:

        included:  log w += log[Φ(b) − Φ(a)] − log P(lower ≤ u_j ≤ upper),   m ← m + V_·j (z_j − m_j)/V_jj.

    Mean and covariance are those of u = (θ − mean)/sd given that all terms are in, without bounds; u ~ N(0, I) before.
    """
    n_term = mean.shape[0]
    always = tuple(range(n_term)) if log_odds is None else certain
    order = [j for j in range(n_term) if j not in bounded] + list(bounded)
    odds = jnp.zeros(n_term) if log_odds is None else log_odds
    log_in, log_out = -jnp.logaddexp(0.0, -odds), -jnp.logaddexp(0.0, odds)
    prior = log_mass(bounds.lower, bounds.upper)
    index = np.array(order, int)
    weight, m, V, z = jnp.zeros(1), mean[index][None], covariance[index[:, None], index][None], jnp.zeros((1, 0))
    for j in order:
        v, mu, first = V[:, 0, 0], m[:, 0], V[:, 1:, 0]
        gain = first / v[:, None]
        conditioned = V[:, 1:, 1:] - gain[:, :, None] * first[:, None, :]
        branches = []
        if j in bounded:
            k, root = bounded.index(j), jnp.sqrt(v)
            low, high = (standardised(limit[k], mu, root) for limit in (bounds.lower, bounds.upper))
            step = root * truncated_quantile(jnp.broadcast_to(bounds.uniform[k], mu.shape), low, high)
            placed = jnp.column_stack([z, mu + step])
            gained = log_mass(low, high) - prior[k]
            branches.append((weight + gained, m[:, 1:] + gain * step[:, None], conditioned, placed))
        else:
            branches.append((weight, m[:, 1:], V[:, 1:, 1:], z))
        if j not in always:
            branches[0] = (branches[0][0] + log_in[j], *branches[0][1:])
            excluded = weight + log_out[j] - 0.5 * jnp.log(v) - 0.5 * mu**2 / v
            without = jnp.column_stack([z, jnp.zeros(len(mu))]) if j in bounded else z
            branches.append((excluded, m[:, 1:] - gain * mu[:, None], conditioned, without))
        # Stacked on axis 1: pattern bits run like itertools.product, first term slowest.
        weight, m, V, z = (
            jnp.stack(parts, axis=1).reshape(len(branches) * len(mu), *parts[0].shape[1:])
            for parts in zip(*branches, strict=True)
        )
    bits = patterns(n_term, tuple(order.index(j) for j in always))
    return BoundedPatterns(weight, z, bits[:, np.argsort(index)])


def standardised(limit: Array, mean: Array | float, sd: Array | float) -> Array:
    """Return (limit − mean)/sd; an infinite limit stays, whose derivative would be none."""
    finite = jnp.isfinite(limit)
    return jnp.where(finite, (jnp.where(finite, limit, 0.0) - mean) / sd, limit)


@jax.custom_jvp
def log_mass(lower: Array, upper: Array) -> Array:
    """Return log[Φ(upper) − Φ(lower)], also where both bounds are far out in one tail."""
    low, high, _ = _in_lower_tail(lower, upper)
    top = log_ndtr(high)
    return top + jnp.log(-jnp.expm1(log_ndtr(low) - top))


@log_mass.defjvp
def _log_mass_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    lower, upper = primals
    value = log_mass(lower, upper)
    # φ(b) db − φ(a) da over the mass
    slope = jnp.exp(_log_density(upper) - value) * tangents[1] - jnp.exp(_log_density(lower) - value) * tangents[0]
    return value, slope


@jax.custom_jvp
def truncated_quantile(uniform: Array, lower: Array, upper: Array) -> Array:
    """Return the quantile of a standard normal restricted to lower ≤ z ≤ upper, at its probability `uniform`."""
    low, high, flipped = _in_lower_tail(lower, upper)
    share = jnp.where(flipped, 1 - uniform, uniform)
    log_p = jnp.logaddexp(log_ndtr(low), jnp.log(share) + log_mass(lower, upper))
    z = jnp.clip(_quantile_of_log(jnp.minimum(log_p, 0.0)), low, high)
    return jnp.where(flipped, -z, z)


@truncated_quantile.defjvp
def _truncated_quantile_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    uniform, lower, upper = primals
    z = truncated_quantile(uniform, lower, upper)
    at = _log_density(z)
    # φ(z) dz = mass du + (1 − u) φ(a) da + u φ(b) db
    slope = jnp.exp(log_mass(lower, upper) - at) * tangents[0]
    slope += (1 - uniform) * jnp.exp(_log_density(lower) - at) * tangents[1]
    slope += uniform * jnp.exp(_log_density(upper) - at) * tangents[2]
    return z, slope


def _in_lower_tail(lower: Array, upper: Array) -> tuple[Array, Array, Array]:
    """Mirror the bounds where both are positive, since only small probabilities have all their digits."""
    flipped = lower > 0
    return jnp.where(flipped, -upper, lower), jnp.where(flipped, -lower, upper), flipped


def _log_density(z: Array) -> Array:
    return -0.5 * z**2 - 0.5 * math.log(2 * math.pi)


def _quantile_of_log(log_p: Array) -> Array:
    """Return Φ⁻¹(exp log_p); far out by Newton steps on log Φ, which is concave."""
    near = ndtri(jnp.exp(jnp.maximum(log_p, LEAST_LOG_PROBABILITY)))
    far = jnp.minimum(log_p, LEAST_LOG_PROBABILITY)
    # Φ(−x) ≈ φ(x)/x: a relative error near 1e-3, which each step squares
    z = -jnp.sqrt(-2 * far - jnp.log(2 * math.pi) - jnp.log(-2 * far))
    for _ in range(4):
        log_cdf = log_ndtr(z)
        z = z - (log_cdf - far) * jnp.exp(log_cdf - _log_density(z))
    return jnp.where(log_p > LEAST_LOG_PROBABILITY, near, z)
