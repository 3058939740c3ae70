"""The common part of designs, and the records that they are asked for and answer with."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple, TypeVar

import numpy as np
from jaxtyping import Array, Float, Int

from bayes_greybox.model.coefficient import CoefficientPriors
from bayes_greybox.model.gp.hyper import Hyperparameters

Compress = Callable[[Float[np.ndarray, "n_replicate n_white"]], Float[np.ndarray, "n_replicate n_row"]]
"""Function from whitened targets to those of a design."""

Weights = Float[Array, " n_basis"]
"""Weights of the features of f, or standardised ones."""

Theta = Float[Array, " n_term"]
"""Coefficients, scaled units."""

Numbers = Int[np.ndarray, " n"]
"""Observations by number."""


class EquationDraws(NamedTuple):
    """Posterior draws of one equation in scaled units, chains flattened: what the mathematics works with.

    Attributes:
        hyper: Noise SD [n_draw], amplitude [n_draw] and length scales [n_draw, n_var].
        prior_sd: Prior standard deviation of each coefficient, zero where it is out.
        weight: Feature weights; no columns where f is not made of features.
        f: Values of f at the rows of the data; no columns where weights determine it.
        mean: Mean of θ given the draw's η, pattern and coefficients with bounds, under which the target is normal. The
            latter stay at their draws, the others have their prior mean.
        spread: Standard deviation of θ given the same: `prior_sd`, and zero where a coefficient has bounds.
    """

    hyper: Hyperparameters
    theta: Float[np.ndarray, "n_draw n_term"]
    prior_sd: Float[np.ndarray, "n_draw n_term"]
    weight: Float[np.ndarray, "n_draw n_basis"]
    f: Float[np.ndarray, "n_draw n_value"]
    mean: Float[np.ndarray, "n_draw n_term"]
    spread: Float[np.ndarray, "n_draw n_term"]


class WeightedRows(NamedTuple):
    """Observations weighted by the inverse noise correlation, R⁻¹[Φ Ψ̃ y], and diag R⁻¹, in scaled units.

    Where W is not square they are W[Φ Ψ̃ y] and ones: whitened coefficients, which are independent. A design that keeps
    C whole needs their numbers only; the other fields are empty then.
    """

    number: Int[Array, " n_row"]
    Phi: Float[Array, "n_some n_term"]
    Psi: Float[Array, "n_some n_basis"]
    y: Float[Array, " n_some"]
    precision: Float[Array, " n_some"]

    def beside(self, theta: Theta) -> "WeightedRows":
        """Return the same with Φθ taken off the target."""
        return self._replace(y=self.y - self.Phi @ theta)


PickRows = Callable[[Numbers], WeightedRows]
"""Function from numbers of observations to their weighted rows."""


class Root(NamedTuple):
    """H (see `FeatureDesign.inverse`), g = C⁻¹y and J = cov(u, y) C⁻¹ at some observations; θ = sd · u, u ~ N(0, I)."""

    H: Float[Array, "n_left n_row"]
    g: Float[Array, " n_row"]
    J: Float[Array, "n_term n_row"]


@dataclass(frozen=True)
class DesignRows:
    """Rows of one equation as the likelihood sees them, whitened and in scaled units; a pytree of arrays.

    Attributes:
        n_obs: Number of measurements behind the rows.
        n_prior: Number of rows for a prior that asks for it: leaving rows out must not change the prior.
        noise_floor: Least σ.
        expands: If true, f is a finite sum of features, so that it has a value at every state an integrator visits.
    """

    Phi: Float[Array, "n_row n_term"]
    y: Float[Array, " n_row"]
    n_obs: Float[Array, ""]
    n_prior: Float[Array, ""]
    log_det_R: Float[Array, ""]
    noise_floor: Float[Array, ""]
    coefficients: CoefficientPriors

    expands: ClassVar[bool]

    def with_target(self: "AnyRows", y: Float[Array, " n_row"]) -> "AnyRows":
        """Return the same rows with another target."""
        return replace(self, y=y)

    def beside(self: "AnyRows", theta: Theta) -> "AnyRows":
        """Return the same rows with Φθ taken off the target."""
        return self.with_target(self.y - self.Phi @ theta)


AnyRows = TypeVar("AnyRows", bound=DesignRows)
"""Rows of whatever design."""
