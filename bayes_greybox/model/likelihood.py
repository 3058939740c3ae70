"""The collapsed likelihood: a NumPyro distribution of the target with θ and f integrated out."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpyro.distributions as dist
from jaxtyping import Array, Float
from numpyro.distributions import constraints

from .algebra.collapsed import log_evidence
from .design import Design
from .gp.hyper import Hyperparameters
from .priors import Scales


class CollapsedNormal(dist.Distribution):
    """Distribution of the rows of one equation given η and the prior scales, θ and f integrated out.

        y ~ N(0, Φ D Φᵀ + K⊥ + σ² R),   or its mixture over inclusion patterns, D = diag(γ τ²).

    The event is the compressed target; `log_prob` is the log density of the `n_obs` measurements behind it, so
    values are comparable between dictionaries and kernels.

    Args:
        design: Rows of the equation.
        hyper: η.
        scales: Prior scales of θ, with log odds for a sum over inclusion patterns.
    """

    arg_constraints: dict = {}
    support = constraints.real_vector  # pyright: ignore[reportAssignmentType, reportIncompatibleMethodOverride]
    pytree_data_fields = ("design", "hyper", "scales")

    def __init__(self, design: Design, hyper: Hyperparameters, scales: Scales, *, validate_args: bool | None = None):
        self.design, self.hyper, self.scales = design, hyper, scales
        super().__init__(event_shape=design.y.shape, validate_args=validate_args)

    def log_prob(self, value: Any, intermediates: Any = None) -> Float[Array, ""]:
        """Log p(y | η, scales) of a target [n_row]."""
        regression, _ = self.design.remove_discrepancy(value, self.hyper)
        return log_evidence(regression, self.scales.sd, self.scales.log_odds, self.design.n_obs)

    def sample(self, key: Array | None, sample_shape: tuple[int, ...] = ()) -> Array:
        """Draw targets; the last compressed row stands for all directions outside the columns."""

        def one(key: Array) -> Array:
            key_gamma, key_theta, key_f, key_noise, key_rest = jax.random.split(key, 5)
            sd = self.scales.sd
            if self.scales.log_odds is not None:
                sd = sd * jax.random.bernoulli(key_gamma, jax.nn.sigmoid(self.scales.log_odds))
            theta = sd * jax.random.normal(key_theta, sd.shape)
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
