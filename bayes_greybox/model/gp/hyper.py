"""η, the hyperparameters of one equation, and their prior.

    σ² = floor² + s²,  s ~ HalfNormal(scale),   amplitude ~ HalfNormal(a),   ℓ_d ~ LogNormal(log ℓ₀, spread),

all in scaled units. The NumPyro program samples them as sites; the evidence of sets of terms integrates over log s.
"""

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jaxtyping import Array, Float

from bayes_greybox.model.sites import site
from bayes_greybox.physics.formula.expressions import namespace


class Hyperparameters(NamedTuple):
    """η: noise standard deviation, amplitude and length scales of f, in scaled units."""

    sigma: Float[Array, ""]
    amplitude: Float[Array, ""]
    length_scale: Float[Array, " n_var"]


class NoisePrior(NamedTuple):
    """σ² = floor² + s², s ~ HalfNormal(scale), in scaled units."""

    floor: Float[Array, ""] | float
    scale: Float[Array, ""] | float

    def sigma(self, log_s: Array | np.ndarray | float) -> Any:
        """Return σ of log s."""
        xp = namespace([log_s, self.floor])
        return xp.sqrt(self.floor**2 + xp.exp(2 * log_s))

    def log_density(self, log_s: Array | np.ndarray) -> Any:
        """Return the log prior density of log s."""
        xp = namespace([log_s, self.scale])
        return 0.5 * math.log(2 / math.pi) - xp.log(self.scale) - 0.5 * (xp.exp(log_s) / self.scale) ** 2 + log_s


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HyperPrior:
    """Prior of η; `spread` is the standard deviation of log ℓ, and `n_var` is None where there is no f."""

    noise: NoisePrior
    amplitude: Float[Array, ""] | float = 1.0
    length_scale: Float[Array, ""] | float = 1.0
    spread: Float[Array, ""] | float = 1.0
    n_var: int | None = field(default=None, metadata={"static": True})

    def sample(self, sigma: Float[Array, ""] | None = None) -> Hyperparameters:
        """Sample η inside a NumPyro model: sites `noise` (s), `amplitude` and `length_scale`, and `sigma` from s.

        Without f the last two are placeholders, which multiply no features. σ is given where it has another prior.
        """
        if sigma is None:
            noise = site("noise", dist.HalfNormal(self.noise.scale))
            # σ² = floor² + s²
            sigma = jnp.sqrt(jnp.square(self.noise.floor) + jnp.square(noise))
        sigma = jnp.asarray(numpyro.deterministic("sigma", sigma))
        if self.n_var is None:
            return Hyperparameters(sigma, jnp.ones(()), jnp.ones(0))
        amplitude = site("amplitude", dist.HalfNormal(self.amplitude))
        length = dist.LogNormal(jnp.log(self.length_scale), self.spread).expand([self.n_var]).to_event(1)
        return Hyperparameters(sigma, amplitude, site("length_scale", length))
