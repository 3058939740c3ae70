"""Priors of the single terms of one equation in scaled units, for the likelihood and the exact draws."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.running.arrays import on_device

from .algebra.collapsed import Ridge
from .algebra.truncated import BoundedPatterns, Bounds, bounded_patterns, log_mass, standardised, truncated_quantile
from .priors import Scales

CERTAIN = 1e3
"""Log odds of a term that is in whatever the data say."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CoefficientPriors:
    """Priors of single terms of one equation in scaled units; every term of the dictionary has an entry.

    Attributes:
        mean: Expected value; zero under the model's prior.
        sd: Standard deviation; one, which nothing asks for, under the model's prior.
        lower: Least value, or −∞.
        upper: Largest value, or ∞.
        shared: Terms under the model's prior.
        certain: Terms that are in whatever the data say.
        bounded: Terms with a bound.
    """

    mean: Float[Array, " n_term"]
    sd: Float[Array, " n_term"]
    lower: Float[Array, " n_term"]
    upper: Float[Array, " n_term"]
    shared: tuple[int, ...] = field(metadata={"static": True})
    certain: tuple[int, ...] = field(default=(), metadata={"static": True})
    bounded: tuple[int, ...] = field(default=(), metadata={"static": True})

    @classmethod
    def of(cls, stated: Sequence[Coefficient | None], scale: Float[np.ndarray, " n_term"]) -> "CoefficientPriors":
        """Return scaled priors of the terms of an equation; `scale` is user's coefficient per scaled coefficient."""
        everything = (-math.inf, math.inf)
        limits = np.array([everything if c is None else c.interval for c in stated]).reshape(-1, 2) / scale[:, None]
        has_mean = [c is not None and c.mean is not None for c in stated]
        numbers = [(c.mean, c.sd) if c is not None and c.mean is not None else (0.0, 0.0) for c in stated]
        mean, sd = np.array(numbers, float).reshape(-1, 2).T / scale
        return cls(
            *on_device((mean, np.where(has_mean, sd, 1.0), limits[:, 0], limits[:, 1])),
            shared=tuple(j for j, stands in enumerate(has_mean) if not stands),
            certain=tuple(j for j, c in enumerate(stated) if c is not None and c.certain),
            bounded=tuple(j for j, c in enumerate(stated) if c is not None and c.bounded),
        )

    @property
    def stated(self) -> bool:
        """True if any term has more than the model's prior."""
        return bool(self.certain or self.bounded)

    def complete(self, shared: Scales | None) -> Scales:
        """Return the scales of all terms, given a draw of the model's prior for its terms; None where it has none."""
        if not self.stated and shared is not None:
            return shared
        if shared is None:
            return Scales(self.sd, None, self.mean)
        index = np.array(self.shared, int)
        odds = None
        if shared.log_odds is not None:
            odds = jnp.full(self.mean.shape, CERTAIN).at[index].set(shared.log_odds)
            odds = odds.at[np.array(self.certain, int)].set(CERTAIN)
        return Scales(self.sd.at[index].set(shared.sd), odds, self.mean)

    def limits(self, scales: Scales) -> tuple[Float[Array, " n_bounded"], Float[Array, " n_bounded"]]:
        """Return the bounds of u = (θ − mean)/sd of the bounded terms."""
        index = np.array(self.bounded, int)
        sd, mean = scales.sd[index], self.mean[index]
        return standardised(self.lower[index], mean, sd), standardised(self.upper[index], mean, sd)

    def placed(self, full: Ridge, scales: Scales) -> BoundedPatterns:
        """Return the inclusion patterns, or the only one without odds, with the bounded coefficients placed."""
        assert scales.uniform is not None
        bounds = Bounds(*self.limits(scales), scales.uniform)
        return bounded_patterns(full.mean, full.covariance, scales.log_odds, bounds, self.bounded, self.certain)

    def draw(
        self, scales: Scales, key_gamma: Array, key_theta: Array
    ) -> tuple[Float[Array, " n_term"], Float[Array, " n_term"]]:
        """Draw θ from its prior, and return it with its standard deviations, zero where a term is out."""
        sd = scales.sd
        if scales.log_odds is not None:
            included = jax.random.bernoulli(key_gamma, jax.nn.sigmoid(scales.log_odds))
            sd = sd * included.at[np.array(self.certain, int)].set(True)
        z = jax.random.normal(key_theta, sd.shape)
        if self.bounded:
            index = np.array(self.bounded, int)
            uniform = jax.random.uniform(jax.random.fold_in(key_theta, 1), index.shape)
            z = z.at[index].set(truncated_quantile(uniform, *self.limits(scales)))
        mean = 0.0 if scales.mean is None else scales.mean
        # An excluded term is exactly zero, not minus zero.
        return jnp.where(sd > 0, mean + sd * z, 0.0), sd

    def log_restriction(self, sd: Float[Array, "*draws n_term"], power: float = 1.0) -> Float[Array, "*draws"]:
        """Return −Σ_j log P(lower_j ≤ θ_j ≤ upper_j), θ_j ~ N(mean_j, sd_j²/power), over the bounded terms that are in.

        This is what restricting a normal prior adds to its log density inside the bounds; `sd` is zero where a term is
        out.
        """
        total = jnp.zeros(sd.shape[:-1])
        for j in self.bounded:
            inside = sd[..., j] > 0
            scale = jnp.where(inside, sd[..., j], 1.0) / math.sqrt(power)
            mass = log_mass(*(standardised(limit[j], self.mean[j], scale) for limit in (self.lower, self.upper)))
            total = total - jnp.where(inside, mass, 0.0)
        return total

    def given(
        self, theta: Float[np.ndarray, "n_draw n_term"], sd: Float[np.ndarray, "n_draw n_term"]
    ) -> tuple[Float[np.ndarray, "n_draw n_term"], Float[np.ndarray, "n_draw n_term"]]:
        """Return mean and standard deviation of θ a priori, the bounded coefficients held at their draws.

        Given these the target is normal, which a bounded coefficient does not leave it.
        """
        mean, spread = np.broadcast_to(np.asarray(self.mean), theta.shape).copy(), np.array(sd)
        index = list(self.bounded)
        mean[:, index], spread[:, index] = theta[:, index], 0.0
        return mean, spread
