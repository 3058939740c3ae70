"""What an effect without a name would show: the columns beside it, and the discrepancy f that they leave.

Given η, f = ψ̃ᵀ w, ψ̃ = ψ − B φ orthogonal to the columns φ at the rows, and w is Gaussian (Rasmussen &
Williams 2006, Eq. 2.8). Coefficients β of the columns are independent of w, so that

    φᵀ β + ψ̃ᵀ w = φᵀ (β − B w) + ψᵀ w

is linear in jointly Gaussian coefficients of φ and of the features ψ; over η it is a mixture.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.discovery.evidence.sufficient_statistics import SufficientStatistics
from bayes_greybox.discovery.evidence.with_discrepancy import IMPORTANCE_DRAWS
from bayes_greybox.discovery.weighing.sets import Explanation
from bayes_greybox.discovery.weighing.worlds import World
from bayes_greybox.model.frame import scaled_position
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.physics.terms import Term

from .resampled import systematic

LATENTS, VARIANCE = 32, 0.99
"""Latents that are kept at most, and the share of the variance at `_seen` places that they are to carry."""

PLACES = 200
"""Of the record, that are looked at."""

SCALES, DRAWN = 4, IMPORTANCE_DRAWS
"""Hyperparameters that stand for their posterior, and draws of the importance sampler that they are taken from."""

SEEN = 1e-2
"""Features that contribute less than this share of the largest one's there are left out."""


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
    n, n_basis = len(columns), statistics.basis.size
    weight, etas = _hyperparameters(world, e)
    means, roots = np.zeros((len(etas), n + n_basis)), np.zeros((len(etas), n + n_basis, n + n_basis))
    for k, eta in enumerate(etas):
        f, (beta, of_beta) = world.rest_weights(e, eta), _coefficients(world, e, eta)
        means[k] = np.concatenate([beta - f.taken @ f.mean, f.mean])
        roots[k] = np.block([[of_beta, np.zeros((n, n_basis))], [-f.root @ f.taken.T, f.root]])
    told = np.array([column.term is not None for column in columns], bool)
    Z = _seen(statistics, [i for i, shown in zip(known.indices(e.columns), told, strict=True) if shown])
    shown = np.concatenate([np.flatnonzero(told), n + np.arange(n_basis)])
    size = np.sqrt(np.mean(Z**2, axis=0) * np.max(means**2 + np.sum(roots**2, axis=1), axis=0)[shown])
    large = (shown < n) | (size > SEEN * np.max(size[shown >= n]))
    kept, Z = shown[large], Z[:, large] / np.sqrt(len(Z))
    scale = statistics.target_scale / np.array([*(column.scale for column in columns), *np.ones(n_basis)])[kept]
    # As text: what a file gives back is then the same.
    plain = [columns[place].formula.plain for place in kept[kept < n]]
    terms = tuple(replace(formula, expression=formula.text) for formula in plain)
    box = statistics.variables, statistics.centre, statistics.half_width
    features = Features(*box, statistics.basis, kept[kept >= n] - n)
    found = []
    for share, eta, mean, root in zip(weight, etas, means[:, kept], roots[:, :, kept], strict=True):
        # Latents whose effect at these places is largest come first.
        turned, spread, _ = np.linalg.svd(root @ Z.T, full_matrices=False)
        carried = np.cumsum(spread**2) < VARIANCE * np.sum(spread**2)
        latents = turned[:, : min(LATENTS, 1 + int(np.sum(carried)))].T @ root
        sigma = float(statistics.noise.sigma(eta[0])) * statistics.target_scale
        found.append(Nameless(float(share), terms, features, mean * scale, latents * scale, sigma))
    return found


def _coefficients(
    world: World, e: Explanation, eta: Float[np.ndarray, " n_eta"]
) -> tuple[Float[np.ndarray, " n_column"], Float[np.ndarray, "n_column n_column"]]:
    """Coefficients of the columns at σ beside f, in the pattern that is likeliest there: mean, and W of covariance WᵀW.

    f leaves less noise than there is without it, and what f is orthogonal to, no other carries.
    """
    known = world.evaluations
    spectrum, s2 = known.parametric([e.columns])[0].spectrum, float(known.statistics.noise.sigma(eta[0])) ** 2
    lam, b = spectrum.eigenvalues, spectrum.loading
    logs = known.patterns()[1] - 0.5 * np.sum(np.log1p(lam / s2) - b**2 / (s2 * (s2 + lam)), axis=-1)
    k = int(np.argmax(logs))
    back = spectrum.back[k]
    return back @ (b[k] / (s2 + lam[k])), (back * np.sqrt(s2 / (s2 + lam[k]))).T


def _seen(statistics: SufficientStatistics, indices: Sequence[int]) -> Float[np.ndarray, "n_place n"]:
    """Columns and features where experiments may go: in the record, and half as far again from its middle."""
    columns = statistics.rows.columns
    some = np.unique(np.linspace(0, len(next(iter(columns.values()))) - 1, PLACES).astype(int))
    there = {name: value[some] for name, value in columns.items()}
    middle = {name: 0.5 * (np.min(value) + np.max(value)) for name, value in columns.items()}
    there = {name: np.concatenate([x, middle[name] + 1.5 * (x - middle[name])]) for name, x in there.items()}
    # What remembers is known at the rows only; its size there serves.
    held = {k: values for k, i in enumerate(indices) if (values := statistics.columns[i].values) is not None}
    plain = [k for k in range(len(indices)) if k not in held]
    table = np.zeros((2 * len(some), len(indices)))
    for k, values in held.items():
        table[:, k] = np.resize(values, len(table))
    with np.errstate(all="ignore"):
        table[:, plain] = statistics.evaluate([indices[k] for k in plain], there)
        found = np.hstack([table, statistics.evaluate_features(there)])
    # A term may leave its domain beyond the data.
    return found[np.all(np.isfinite(found), axis=1)]


def _hyperparameters(world: World, e: Explanation) -> tuple[np.ndarray, Float[np.ndarray, "n n_eta"]]:
    """A few hyperparameters that stand for their posterior, with their weights: of wider draws about the mode.

    At the mode alone f would be sure of its scales, and a record is too short to tell them.
    """
    known = world.evaluations
    found = known.integrated(e.columns)
    etas, log_ratio = known.evaluator.proposed(known.with_features(e.columns), found.mode, found.covariance, DRAWN)
    # Neighbours have like scales.
    order = np.argsort(etas[:, 2:].sum(axis=1))
    weight, places = systematic(np.exp(log_ratio - np.max(log_ratio))[order], SCALES)
    return weight, etas[order][places]
