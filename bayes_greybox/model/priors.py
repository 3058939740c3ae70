"""Sparse priors on the coefficients, all Gaussian given their scales so that θ can be integrated out.

Coefficients are in scaled units here: every dictionary column has unit RMS and so has the target.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpyro
import numpyro.distributions as dist
from jaxtyping import Array, Float

from bayes_greybox.physics.coefficient import Coefficient as Coefficient
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import Positive, Whole, require_limits

from .algebra.linalg import Scalar
from .sites import site


class Scales(NamedTuple):
    """A draw of the prior scales: θ_j ~ N(mean_j, sd_j²), sd = 0 for a term that is out; scaled units.

    Attributes:
        log_odds: Log prior odds that each term is in, if the sum over patterns is still to be taken.
        mean: Expected values, where single terms have priors of their own; None: zero.
        uniform: Numbers that place coefficients with bounds, still to be integrated out (see `algebra.truncated`).
    """

    sd: Float[Array, " n_term"]
    log_odds: Float[Array, " n_term"] | None = None
    mean: Float[Array, " n_term"] | None = None
    uniform: Float[Array, " n_bounded"] | None = None


@runtime_checkable
class Prior(Protocol):
    """A prior on θ is a NumPyro program that samples the scales of its `n_term` coefficients."""

    def scales(self, n_term: int, n_obs: Scalar, sigma: Scalar) -> Scales:
        """Sample the scales (inside a NumPyro model)."""
        ...


class _Limited:
    """A prior whose fields state their limits."""

    def __post_init__(self) -> None:
        require_limits(self)


@dataclass(frozen=True)
class Normal(_Limited):
    """θ_j ~ N(0, τ²), τ ~ HalfNormal(`scale`)."""

    scale: Positive = 1.0

    def scales(self, n_term: int, n_obs: Scalar, sigma: Scalar) -> Scales:
        """Sample τ."""
        tau = site("tau", dist.HalfNormal(self.scale))
        return Scales(jnp.full(n_term, tau))


@dataclass(frozen=True)
class Laplace(_Limited):
    """θ_j | v_j ~ N(0, τ² v_j), v_j ~ Exponential(1/2), τ ~ HalfNormal(`scale`): marginally Laplace(0, τ).

    Park & Casella 2008, The Bayesian Lasso, Eq. (4).
    """

    scale: Positive = 1.0

    def scales(self, n_term: int, n_obs: Scalar, sigma: Scalar) -> Scales:
        """Sample τ and the mixing variances v."""
        tau = site("tau", dist.HalfNormal(self.scale))
        v = site("v", dist.Exponential(0.5).expand([n_term]).to_event(1))
        return Scales(tau * jnp.sqrt(v))


@dataclass(frozen=True)
class RegularisedHorseshoe(_Limited):
    """θ_j ~ N(0, τ² λ̃_j²), λ̃_j² = c² λ_j²/(c² + τ² λ_j²), λ_j ~ HalfCauchy(1).

    τ ~ HalfCauchy(τ₀) with τ₀ = p₀/(K − p₀) · σ/√n for p₀ expected active terms, and
    c² ~ InverseGamma(ν/2, ν s²/2): coefficients far from zero see a Student-t slab of scale s
    (Piironen & Vehtari 2017, Eq. 2.8 to 2.10 and 3.12).

    Attributes:
        expected_active: p₀, expected number of active terms; None: a third of the dictionary, at least one half.
        slab_scale: s, scaled units.
        slab_df: ν.
    """

    expected_active: Positive | None = None
    slab_scale: Positive = 2.0
    slab_df: Positive = 4.0

    def scales(self, n_term: int, n_obs: Scalar, sigma: Scalar) -> Scales:
        """Sample the global scale, local scales and slab."""
        expected = max(n_term / 3, 0.5) if self.expected_active is None else self.expected_active
        if expected >= n_term:
            raise InputError(
                f"RegularisedHorseshoe(expected_active={expected:g}) needs fewer active terms than the "
                f"dictionary has ({n_term}): lower it, or use bg.Normal()."
            )
        tau_0 = expected / (n_term - expected) * sigma / jnp.sqrt(n_obs)
        # Scaled outside the distribution, so that τ₀(σ) does not couple the sampled coordinates.
        tau = tau_0 * site("tau_unit", dist.HalfCauchy(1.0))
        lam = site("lambda", dist.HalfCauchy(1.0).expand([n_term]).to_event(1))
        c2 = site("slab", dist.InverseGamma(0.5 * self.slab_df, 0.5 * self.slab_df * self.slab_scale**2))
        numpyro.deterministic("tau", tau)
        # c λτ / √(c² + τ²λ²), through logarithms because λ is heavy-tailed
        log_local = jnp.log(tau) + jnp.log(lam)
        return Scales(jnp.exp(log_local - 0.5 * jnp.logaddexp(0.0, 2 * log_local - jnp.log(c2))))


@dataclass(frozen=True)
class SpikeAndSlab(_Limited):
    """γ_j ~ Bernoulli(π), π ~ Beta(a, b), θ_j | γ_j = 1 ~ N(0, τ²), θ_j = 0 exactly otherwise.

    τ ~ LogNormal(log `slab_scale`, 1/2): bounded away from zero, so that "in" cannot mean "in with no effect". Up to
    `enumerate_up_to` terms the 2^K patterns are summed; beyond, γ is a site that Gibbs moves update.

    Attributes:
        a: First parameter of the Beta prior of the inclusion probability.
        b: Second parameter.
        slab_scale: Median of τ, scaled units.
        enumerate_up_to: Largest dictionary whose patterns are summed.
        samples_patterns: True, as γ is a site of the model where its patterns are not summed.
    """

    samples_patterns = True

    a: Positive = 1.0
    b: Positive = 1.0
    slab_scale: Positive = 1.0
    enumerate_up_to: Whole = 12

    def scales(self, n_term: int, n_obs: Scalar, sigma: Scalar) -> Scales:
        """Sample π and τ, and γ when there are too many patterns to sum."""
        pi = jnp.asarray(site("pi", dist.Beta(self.a, self.b)))
        tau = site("tau", dist.LogNormal(jnp.log(self.slab_scale), 0.5))
        if n_term <= self.enumerate_up_to:
            return Scales(jnp.full(n_term, tau), jnp.full(n_term, jnp.log(pi) - jnp.log1p(-pi)))
        gamma = site("gamma", dist.Bernoulli(pi).expand([n_term]).to_event(1))
        return Scales(jnp.asarray(gamma * tau))


@dataclass(frozen=True)
class CustomPrior:
    """A prior of the user's own, from a NumPyro program that samples the standard deviations of θ.

    Example: `CustomPrior(lambda n_term: numpyro.sample("sd", dist.HalfCauchy().expand([n_term]).to_event(1)))`.

    Attributes:
        program: Called inside the model with the number of terms, without those that have a normal prior of their
            own; returns the standard deviations [n_term], in scaled units.
    """

    program: Callable[[int], Array]

    def scales(self, n_term: int, n_obs: Scalar, sigma: Scalar) -> Scales:
        """Run the user's program."""
        return Scales(jnp.broadcast_to(jnp.asarray(self.program(n_term), float), (n_term,)))


PRIORS: Mapping[str, type] = {
    "spike_and_slab": SpikeAndSlab,
    "laplace": Laplace,
    "regularised_horseshoe": RegularisedHorseshoe,
    "normal": Normal,
}
"""Priors by their kind in configurations; files of fits have the names of the classes. Fields state their limits."""
