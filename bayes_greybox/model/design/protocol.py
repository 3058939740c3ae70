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

Theta = Float[Array, " n_term"]

Numbers = Int[np.ndarray, " n"]
"""Observations by number."""


class EquationDraws(NamedTuple):
    """Posterior draws of one equation in scaled units, chains flattened: what the mathematics works with.

    Attributes:
        prior_sd: Prior standard deviation of each coefficient, zero where it is out.
        weight: Feature weights; no columns where f is not made of features.
        f: Values of f at the rows of the data; no columns where weights determine it.
        mean: Mean of θ given the draw's η, pattern and coefficients with bounds, which stay at their draws: given these
            the target is normal.
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

    Where W is not square they are W[Φ Ψ̃ y] and ones. A design that keeps C whole needs their numbers only.
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

    `n_obs` measurements stand behind the rows, and `n_prior` for a prior that asks for their number, which leaving rows
    out must not change. If it `expands`, f is a finite sum of features, with a value wherever an integrator goes.
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
