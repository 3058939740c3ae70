"""The collapsed likelihood: a NumPyro distribution of the target with θ and f integrated out."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpyro.distributions as dist
from jaxtyping import Array, Float
from numpyro.distributions import constraints

from .collapsed import (
    FeatureSolve,
    Remainder,
    constraint_directions,
    log_evidence,
    remove_dense,
    remove_features,
)
from .kernels import KERNELS, log_spectral_density
from .linalg import singular_root
from .orthogonal import Variant, orthogonal_gram
from .priors import Scales


class Hyperparameters(NamedTuple):
    """η: noise standard deviation, amplitude and length scales of f, in scaled units."""

    sigma: Float[Array, ""]
    amplitude: Float[Array, ""]
    length_scale: Float[Array, " n_var"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FeatureDesign:
    """Rows of one equation on the feature path: [Φ Ψ̃ y], whitened, scaled, compressed to a triangular factor.

    The rotation that compresses the rows leaves the likelihood as it is; `n_obs` rows stand behind `y`. Without a
    discrepancy the features have no columns. A prior that asks for the number of rows is told `n_prior`: leaving rows
    out must not change the prior.
    """

    Phi: Float[Array, "n_row n_term"]
    Psi: Float[Array, "n_row n_basis"]
    gram: Float[Array, "n_basis n_basis"]
    y: Float[Array, " n_row"]
    n_obs: Float[Array, ""]
    n_prior: Float[Array, ""]
    log_det_R: Float[Array, ""]
    noise_floor: Float[Array, ""]
    frequency: Float[Array, "n_basis n_var"]
    constraints: Float[Array, "n_rank n_basis"] | None
    kernel: str = field(metadata={"static": True})

    def weight_prior(self, hyper: Hyperparameters) -> tuple[Array, Array | None]:
        """½ log S and U: the weights are w = √S ⊙ (I − U Uᵀ) z, z ~ N(0, I); U is None unless conditioned."""
        log_S = log_spectral_density(KERNELS[self.kernel], self.frequency, hyper.amplitude, hyper.length_scale)
        # √S as exp(½ log S): S underflows, and the gradient of √0 is NaN
        if self.constraints is None:
            return 0.5 * log_S, None
        return 0.5 * log_S, constraint_directions(jnp.exp(0.5 * log_S), self.constraints)

    def weights(self, z: Float[Array, " n_basis"], hyper: Hyperparameters) -> Float[Array, " n_basis"]:
        """Feature weights w of standardised ones z."""
        if z.size == 0:
            return z
        log_root, U = self.weight_prior(hyper)
        return jnp.exp(log_root) * (z if U is None else z - U @ (U.T @ z))

    def remove_discrepancy(self, y: Float[Array, " n_row"], hyper: Hyperparameters) -> tuple[Remainder, FeatureSolve]:
        """Integrate out f."""
        log_root, U = self.weight_prior(hyper) if self.Psi.shape[1] else (jnp.zeros(0), None)
        remainder, solve = remove_features(self.Phi, self.Psi, self.gram, y, log_root, hyper.sigma, U)
        log_det = remainder.log_det + 2 * self.n_obs * jnp.log(hyper.sigma) + self.log_det_R
        return remainder._replace(log_det=log_det), solve

    def sample_discrepancy(self, key: Array, hyper: Hyperparameters) -> Float[Array, " n_row"]:
        """Prior draw of f on the compressed rows."""
        return self.Psi @ self.weights(jax.random.normal(key, self.Psi.shape[1:]), hyper)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DenseDesign:
    """Rows of one equation on the exact path: f stands in the model by its covariance matrix at the rows."""

    Phi: Float[Array, "n_row n_term"]
    y: Float[Array, " n_row"]
    n_obs: Float[Array, ""]
    n_prior: Float[Array, ""]
    log_det_R: Float[Array, ""]
    noise_floor: Float[Array, ""]
    points: tuple[Float[Array, "n_obs n_var"], Float[Array, "n_obs n_rank"]]
    nodes: tuple[Float[Array, "n_node n_var"], Float[Array, "n_node n_rank"]]
    whitening: Float[Array, "n_row n_obs"] | None
    kernel: str = field(metadata={"static": True})
    variant: Variant = field(metadata={"static": True})

    def covariance(self, hyper: Hyperparameters) -> Float[Array, "n_row n_row"]:
        """k⊥ at the (whitened) rows."""
        K = self.cross_covariance(self.points, hyper)
        return K if self.whitening is None else self.whitening @ K @ self.whitening.T

    def cross_covariance(
        self, left: tuple[Float[Array, "n_left n_var"], Float[Array, "n_left n_rank"]], hyper: Hyperparameters
    ) -> Float[Array, "n_left n_obs"]:
        """k⊥ between other points and the data, before whitening."""
        return self._gram(left, self.points, hyper)

    def covariance_at(
        self, left: tuple[Float[Array, "n_left n_var"], Float[Array, "n_left n_rank"]], hyper: Hyperparameters
    ) -> Float[Array, "n_left n_left"]:
        """k⊥ among other points."""
        return self._gram(left, left, hyper)

    def _gram(self, left: tuple[Array, Array], right: tuple[Array, Array], hyper: Hyperparameters) -> Array:
        kernel = KERNELS[self.kernel]
        return orthogonal_gram(self.variant, kernel, hyper.amplitude, hyper.length_scale, left, right, self.nodes)

    def remove_discrepancy(
        self, y: Float[Array, " n_row"], hyper: Hyperparameters
    ) -> tuple[Remainder, Float[Array, "n_row n_row"]]:
        """Integrate out f."""
        remainder, L = remove_dense(self.Phi, self.covariance(hyper), y, hyper.sigma)
        return remainder._replace(log_det=remainder.log_det + self.log_det_R), L

    def sample_discrepancy(self, key: Array, hyper: Hyperparameters) -> Float[Array, " n_row"]:
        """Prior draw of f on the rows."""
        return singular_root(self.covariance(hyper)) @ jax.random.normal(key, self.y.shape)


Design = FeatureDesign | DenseDesign


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
    support = constraints.real_vector  # pyright: ignore[reportAssignmentType]
    pytree_data_fields = ("design", "hyper", "scales")

    def __init__(self, design: Design, hyper: Hyperparameters, scales: Scales, *, validate_args: bool | None = None):
        self.design, self.hyper, self.scales = design, hyper, scales
        super().__init__(event_shape=design.y.shape, validate_args=validate_args)

    def log_prob(self, value: Float[Array, " n_row"]) -> Float[Array, ""]:
        """Log p(y | η, scales)."""
        remainder, _ = self.design.remove_discrepancy(value, self.hyper)
        return log_evidence(remainder, self.scales.sd, self.scales.log_odds, self.design.n_obs)

    def sample(self, key: Array, sample_shape: tuple[int, ...] = ()) -> Array:
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

        if not sample_shape:
            return one(key)
        draws = jax.lax.map(one, jax.random.split(key, math.prod(sample_shape)))
        return draws.reshape(*sample_shape, *self.event_shape)
