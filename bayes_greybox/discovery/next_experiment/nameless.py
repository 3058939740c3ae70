"""What an effect without a name would show: the columns beside it, and the discrepancy f that they leave.

Given η, f = ψ̃ᵀ w, ψ̃ = ψ − B φ orthogonal to the columns φ at the rows, and w is Gaussian (Rasmussen &
Williams 2006, Eq. 2.8). Coefficients β of the columns are independent of w, so that

    φᵀ β + ψ̃ᵀ w = φᵀ (β − B w) + ψᵀ w

is linear in jointly Gaussian coefficients of φ and of the features ψ; over η it is a mixture.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.discovery.evidence.with_discrepancy import DEGREES
from bayes_greybox.discovery.weighing.sets import Explanation
from bayes_greybox.discovery.weighing.worlds import World
from bayes_greybox.model.frame import scaled_position
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.physics.terms import Term

from .resampled import systematic

LATENTS = 16
"""Directions of the coefficients' covariance that are kept, at most: those with the largest variance."""

SCALES, DRAWN = 4, 200
"""Hyperparameters that stand for their posterior, and draws of the importance sampler that they are taken from."""

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
        weight: Of a mixture over hyperparameters.
        terms: Columns.
        features: What comes behind them.
        mean: Of the coefficients of both.
        root: W with WᵀW their covariance.
        sigma: Noise standard deviation of the rows.
    """

    weight: float
    terms: tuple[Term, ...]
    features: Features
    mean: Float[np.ndarray, " n_coefficient"]
    root: Float[np.ndarray, "n_latent n_coefficient"]
    sigma: float


def nameless(world: World, e: Explanation) -> list[Nameless]:
    """The posterior of what an explanation with f adds to the simulation, as a mixture over its hyperparameters.

    Errors of the sensors are those of the record, and no part of it.

    Args:
        world: Its noise and evidence.
        e: The explanation.
    """
    known, statistics = world.evaluations, world.evaluations.statistics
    columns = [statistics.columns[i] for i in known.indices(e.columns)]
    beta, covariance = world.coefficients(e)
    values, vectors = np.linalg.eigh(covariance)
    of_beta = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    n, n_basis = len(beta), statistics.basis.size
    weight, etas = _hyperparameters(world, e)
    means, roots = np.zeros((len(etas), n + n_basis)), np.zeros((len(etas), n + n_basis, n + n_basis))
    for k, eta in enumerate(etas):
        f = world.rest_weights(e, eta)
        means[k] = np.concatenate([beta - f.taken @ f.mean, f.mean])
        roots[k] = np.block([[of_beta, np.zeros((n, n_basis))], [-f.root @ f.taken.T, f.root]])
    # Columns have an RMS of one in the record, and features in their domain: sizes can be compared.
    size = np.sqrt(np.max(means**2 + np.sum(roots**2, axis=1), axis=0))
    told = np.array([column.term is not None for column in columns] + [True] * n_basis)
    kept = np.flatnonzero(told & (size > SEEN * np.max(size)))
    scale = statistics.target_scale / np.array([*(column.scale for column in columns), *np.ones(n_basis)])[kept]
    # As text: what a file gives back is then the same.
    plain = [columns[place].formula.plain for place in kept[kept < n]]
    terms = tuple(replace(formula, expression=formula.text) for formula in plain)
    box = statistics.variables, statistics.centre, statistics.half_width
    features = Features(*box, statistics.basis, kept[kept >= n] - n)
    found = []
    for share, eta, mean, root in zip(weight, etas, means[:, kept], roots[:, :, kept], strict=True):
        _, spread, directions = np.linalg.svd(root, full_matrices=False)
        shown = min(LATENTS, int(np.sum(spread > SEEN * spread[0])))
        sigma = float(statistics.noise.sigma(eta[0])) * statistics.target_scale
        root = spread[:shown, None] * directions[:shown] * scale
        found.append(Nameless(float(share), terms, features, mean * scale, root, sigma))
    return found


def _hyperparameters(world: World, e: Explanation) -> tuple[np.ndarray, Float[np.ndarray, "n n_eta"]]:
    """A few hyperparameters that stand for their posterior, with their weights: of wider draws about the mode.

    At the mode alone f would be sure of its scales, and a record is too short to tell them.
    """
    known = world.evaluations
    mode, covariance = known.integrated(e.columns).mode, known.integrated(e.columns).covariance
    root = np.linalg.cholesky(covariance)
    rng = np.random.default_rng(0)
    z = rng.standard_normal((DRAWN, len(mode))) / np.sqrt(rng.chisquare(DEGREES, (DRAWN, 1)) / DEGREES)
    etas = mode + z @ root.T
    log_ratio = known.evaluator.values(known.with_features(e.columns), etas) + 0.5 * (DEGREES + len(mode)) * np.log1p(
        np.sum(z**2, axis=1) / DEGREES
    )
    ratio = np.exp(log_ratio - np.max(log_ratio[np.isfinite(log_ratio)]))
    ratio = np.where(np.isfinite(ratio), ratio, 0.0)
    # Neighbours have like scales.
    order = np.argsort(etas[:, 2:].sum(axis=1) if len(mode) > 2 else etas[:, 1])
    weight, places = systematic(ratio[order], SCALES)
    return weight, etas[order][places]
