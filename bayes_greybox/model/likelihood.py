"""The collapsed likelihood: a NumPyro distribution of the target with θ and f integrated out."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpyro.distributions as dist
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float
from numpyro.distributions import constraints

from .algebra.collapsed import log_evidence, ridge
from .design import Design
from .gp.hyper import Hyperparameters
from .priors import Scales


class CollapsedNormal(dist.Distribution):
    """Distribution of the rows of one equation given η and the prior scales, θ and f integrated out.

        y ~ N(Φ m, Φ D Φᵀ + K⊥ + σ² R),   or its mixture over inclusion patterns, D = diag(γ τ²),

    m the prior means of single terms. Where coefficients have bounds the density is that of y given the uniform numbers
    which place them, times a constant: its mean over these is the density of y (see `algebra.truncated`). The event is
    the compressed target; `log_prob` is the log density of the `n_obs` measurements behind it.
    """

    arg_constraints: dict = {}
    support = constraints.real_vector  # pyright: ignore[reportAssignmentType, reportIncompatibleMethodOverride]
    pytree_data_fields = ("design", "hyper", "scales")

    def __init__(self, design: Design, hyper: Hyperparameters, scales: Scales, *, validate_args: bool | None = None):
        self.design, self.hyper, self.scales = design, hyper, scales
        super().__init__(event_shape=design.y.shape, validate_args=validate_args)

    def log_prob(self, value: Any, intermediates: Any = None) -> Float[Array, ""]:
        """Return log p(y | η, scales) of a target."""
        return log_density(self.design, self.hyper, self.scales, value)

    def sample(self, key: Array | None, sample_shape: tuple[int, ...] = ()) -> Array:
        """Draw targets, bounded coefficients anew; the last compressed row stands for what is outside the columns."""

        def one(key: Array) -> Array:
            key_gamma, key_theta, key_f, key_noise, key_rest = jax.random.split(key, 5)
            theta, _ = self.design.coefficients.draw(self.scales, key_gamma, key_theta)
            noise = jax.random.normal(key_noise, self.event_shape)
            hidden = self.design.n_obs - self.design.y.size
            # χ² with the degrees of freedom of the rows that compression folded into the last one
            folded = 2 * jax.random.gamma(key_rest, jnp.maximum(0.5 * hidden, 1e-30)) * (hidden > 0)
            noise = noise.at[-1].set(jnp.sqrt(noise[-1] ** 2 + folded))
            f = self.design.sample_discrepancy(key_f, self.hyper)
            return self.design.Phi @ theta + f + self.hyper.sigma * noise

        assert key is not None
        if not sample_shape:
            return one(key)
        draws = jax.lax.map(one, jax.random.split(key, math.prod(sample_shape)))
        return draws.reshape(*sample_shape, *self.event_shape)


@jax.jit
def log_density(
    design: Design, hyper: Hyperparameters, scales: Scales, value: Float[Array, " n_row"]
) -> Float[Array, ""]:
    """Return log p(y | η, scales) of a target, of the numbers that place coefficients with bounds too."""
    # A program of its own, which is traced once for all that sampling makes of it: most of what a warm fit waits for.
    regression = design.remove_discrepancy(value, hyper)[0].beside(scales.mean)
    if scales.uniform is None:
        return log_evidence(regression, scales.sd, scales.log_odds, design.n_obs, design.coefficients.certain)
    full = ridge(regression, scales.sd, design.n_obs)
    return full.log_evidence + logsumexp(design.coefficients.placed(full, scales).log_weight)
