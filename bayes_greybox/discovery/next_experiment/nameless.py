"""What an effect without a name would show: the columns beside it, and the discrepancy f that they leave.

Given η at its mode, f = ψ̃ᵀ w, ψ̃ = ψ − B φ orthogonal to the columns φ at the rows, and w is Gaussian (Rasmussen &
Williams 2006, Eq. 2.8). Coefficients β of the columns are independent of w, so that

    φᵀ β + ψ̃ᵀ w = φᵀ (β − B w) + ψᵀ w

is linear in jointly Gaussian coefficients of φ and of the features ψ.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.discovery.weighing.sets import Explanation
from bayes_greybox.discovery.weighing.worlds import World
from bayes_greybox.model.frame import scaled_position
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.physics.terms import Term

LATENTS = 16
"""Directions of the coefficients' covariance that are kept, at most: those with the largest variance."""

SEEN = 1e-2
"""What contributes less than this share of the largest is left out."""


@dataclass(frozen=True)
class Features:
    """Features of a discrepancy, as functions of states and inputs.

    Attributes:
        variables: What f depends on.
        centre, half_width: Their box in the data, user's units.
        basis: All features, on the box as [−1, 1]^d.
        kept: Which of them.
    """

    variables: tuple[str, ...]
    centre: Float[np.ndarray, " n_var"]
    half_width: Float[np.ndarray, " n_var"]
    basis: HilbertBasis
    kept: Int[np.ndarray, " n_feature"]

    def evaluate(self, columns: Mapping[str, Float[np.ndarray, "*n"]]) -> Float[np.ndarray, "*n n_feature"]:
        """ψ at any states and inputs; outside the domain it is held (see `held_features`).

        Args:
            columns: States and inputs.
        """
        x = scaled_position(columns, self.variables, self.centre, self.half_width)
        L = self.basis.half_widths
        along, places = self.basis.directions(np.clip(x, -L, L)), self.basis.indices[self.kept].T
        return np.asarray(reduce(np.multiply, (each[..., j] for each, j in zip(along, places, strict=True))))

    def spread_out(self, weights: Float[np.ndarray, "n_draw n_feature"]) -> Float[np.ndarray, "n_draw *m"]:
        """Weights of several draws by the index of the feature in each direction.

        Args:
            weights: Of the features.
        """
        found = np.zeros((len(weights), *self.basis.per_variable))
        found[:, *self.basis.indices[self.kept].T] = weights
        return found

    def summed(
        self, columns: Mapping[str, Float[np.ndarray, "n n_draw"]], weights: Float[np.ndarray, "n_draw *m"]
    ) -> Float[np.ndarray, "n n_draw"]:
        """ψᵀ w of each draw at states and inputs of its own, one direction after the other.

        Args:
            columns: States and inputs.
            weights: As `spread_out` has them.
        """
        x = scaled_position(columns, self.variables, self.centre, self.half_width)
        L = self.basis.half_widths
        first, *others = self.basis.directions(np.clip(x, -L, L).swapaxes(0, 1))
        found = first @ weights.reshape(*weights.shape[:2], -1)
        for along in others:
            found = np.einsum("dcm,dcmr->dcr", along, found.reshape(*found.shape[:2], along.shape[-1], -1))
        return np.asarray(found[..., 0].T)


class Nameless(NamedTuple):
    """Terms and features whose coefficients are Gaussian, user's units.

    Attributes:
        terms: Columns.
        features: What comes behind them.
        mean: Of the coefficients of both.
        root: W with WᵀW their covariance.
        sigma: Noise standard deviation of the rows.
    """

    terms: tuple[Term, ...]
    features: Features
    mean: Float[np.ndarray, " n_coefficient"]
    root: Float[np.ndarray, "n_latent n_coefficient"]
    sigma: float


def nameless(world: World, e: Explanation) -> Nameless:
    """The posterior of what an explanation with f adds to the simulation, at the mode of its hyperparameters.

    Errors of the sensors are those of the record, and no part of it.

    Args:
        world: Its noise and evidence.
        e: The explanation.
    """
    known, statistics = world.evaluations, world.evaluations.statistics
    columns = [statistics.columns[i] for i in known.indices(e.columns)]
    (beta, covariance), weights = world.coefficients(e), world.rest_weights(e)
    n, n_basis = len(beta), len(weights.mean)
    mean = np.concatenate([beta - weights.taken @ weights.mean, weights.mean])
    values, vectors = np.linalg.eigh(covariance)
    of_beta = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    root = np.block([[of_beta, np.zeros((n, n_basis))], [-weights.root @ weights.taken.T, weights.root]])
    # Columns have an RMS of one in the record, and features in their domain: sizes can be compared.
    size = np.sqrt(mean**2 + np.sum(root**2, axis=0))
    told = np.array([column.term is not None for column in columns] + [True] * n_basis)
    kept = np.flatnonzero(told & (size > SEEN * np.max(size)))
    _, spread, directions = np.linalg.svd(root[:, kept], full_matrices=False)
    shown = min(LATENTS, int(np.sum(spread > SEEN * spread[0])))
    scale = statistics.target_scale / np.array([*(column.scale for column in columns), *np.ones(n_basis)])[kept]
    # As text: what a file gives back is then the same.
    plain = [columns[place].formula.plain for place in kept[kept < n]]
    box = statistics.variables, statistics.centre, statistics.half_width
    return Nameless(
        tuple(replace(formula, expression=formula.text) for formula in plain),
        Features(*box, statistics.basis, kept[kept >= n] - n),
        mean[kept] * scale,
        spread[:shown, None] * directions[:shown] * scale,
        float(statistics.noise.sigma(known.integrated(e.columns).mode[0])) * statistics.target_scale,
    )
