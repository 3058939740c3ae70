"""LOO-PIT: the place of each measurement in its leave-one-out prediction, and a test that allows for dependence."""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.special import log_ndtr, ndtr

from bayes_greybox.criticism.cross_validation.psis import smoothed_weights
from bayes_greybox.criticism.cross_validation.row_densities import parameters_of, precision_terms
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.model.design import Design, WeightedRows
from bayes_greybox.model.equation import Equation
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.running.arrays import on_device
from bayes_greybox.running.compiling import compiled

TEST_LEVEL = 0.01
"""Level of each test: it rejects at most one in a hundred well-specified models."""

OBSERVATIONS, TEST_DRAWS, TEST_REPLICATES = 400, 12, 999
"""Most observations, evenly spaced, that are tested, as the test needs the correlation of every pair; posterior draws
that it uses, and replicated data sets for each of them."""


@dataclass(frozen=True)
class LooPit:
    """LOO-PIT values of one equation and their test.

    Attributes:
        equation: Learned state.
        row: Observations that are tested.
        value: P(ỹ_i ≤ y_i | y₋ᵢ) of each.
        p: p-value of uniformity; see `loo_pit`.
        outside: Share of values outside [0.05, 0.95], expected to be a tenth.
        outside_lower: 0.5 % quantile of this share under the model.
        outside_upper: 99.5 % quantile.
        band: Half-width of a band around the uniform distribution function that contains the whole distribution
            function of the values in 99 % of replicated data sets.
        khat: Largest Pareto k̂ of the weights.
    """

    equation: str
    row: Int[np.ndarray, " n_obs"]
    value: Float[np.ndarray, " n_obs"]
    p: float
    outside: float
    outside_lower: float
    outside_upper: float
    band: float
    khat: float

    @property
    def wrong(self) -> str:
        """Description of the way in which the values are not uniform."""
        if self.outside > self.outside_upper:
            return "too narrow"
        if self.outside < self.outside_lower:
            return "too wide"
        return "of the wrong shape"


def loo_pit(posterior: Posterior, equation: str) -> LooPit:
    """Return the probability integral transforms under the closed-form leave-one-out predictive distributions.

    Given η, γ (θ and f integrated out) y_i | y₋ᵢ is normal with mean y_i − g_i/c_i and variance 1/c_i (notation of
    `pointwise_loo`), so

        PIT_i = Σ_s w_is Φ(z_is),   z_i = g_i/√c_i,

    over the posterior draws s, those of γ among them, with the smoothed weights of PSIS-LOO.

    The values are not independent: g = C⁻¹y has covariance C⁻¹, so corr(z_i, z_j) = (C⁻¹)_ij/√(c_i c_j) whatever the
    data. For one posterior draw, z ~ N(0, corr(C⁻¹)) exactly if the data come from the model with its prior, because
    that draw and the data then have the joint distribution of a truth and its data (Johnson 2007, Bayesian Analysis
    2:719). So the Anderson-Darling statistic of Φ(z) is compared with that of replicates from this normal distribution,
    and the p-values of several draws are combined by `combined_p`. The level thus holds, as an upper bound, on average
    over the prior; nothing is assumed about the dependence of the values.
    """
    posterior.require_rows("LOO-PIT is found")
    entry = posterior.equations[equation]
    n = entry.rows.n_white
    index = np.unique(np.linspace(0, n - 1, min(n, OBSERVATIONS)).round().astype(int))
    rows = entry.weighted()(index)
    draws = posterior.draws(equation)
    precision, g = (np.asarray(part) for part in precision_terms(entry.design, rows, parameters_of(draws)))
    z = g / np.sqrt(precision)
    log_p = 0.5 * (np.log(precision) - z**2)
    log_weight, khat = smoothed_weights(-log_p.T)
    value = np.clip(np.sum(np.exp(log_weight) * ndtr(z.T), axis=1), 0.0, 1.0)
    p, gaps, outside = _test(posterior, entry, rows, index)
    lower, upper = np.quantile(outside, [0.005, 0.995])
    return LooPit(
        equation=equation,
        row=index,
        value=value,
        p=p,
        outside=float(np.mean((value < 0.05) | (value > 0.95))),
        outside_lower=float(lower),
        outside_upper=float(upper),
        band=float(np.quantile(gaps, 0.99)),
        khat=float(khat.max()),
    )


def combined_p(p: Float[np.ndarray, " n_draw"]) -> float:
    """Return twice the median, at most 1: a p-value whatever the dependence between the given ones.

    If each p_s is uniform, P(median ≤ α/2) ≤ P(half of all p_s ≤ α/2) ≤ 2 · α/2 by Markov's inequality (Meinshausen,
    Meier & Bühlmann 2009, JASA 104:1671, Theorem 3.1 with γ = ½).
    """
    return float(min(1.0, 2.0 * np.quantile(p, 0.5, method="higher")))


def anderson_darling(z: Float[np.ndarray, "n_replicate n_obs"]) -> Float[np.ndarray, " n_replicate"]:
    """Return A² = −n − Σ_i (2i − 1)/n (log Φ(z_(i)) + log Φ(−z_(n+1−i))), large if z is not standard normal."""
    z = np.sort(z, axis=-1)
    n = z.shape[-1]
    weight = (2 * np.arange(1, n + 1) - 1) / n
    return -n - np.sum(weight * (log_ndtr(z) + log_ndtr(-z[..., ::-1])), axis=-1)


def _test(
    posterior: Posterior, entry: Equation, rows: WeightedRows, index: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the p-value, and largest gap of the distribution function and share outside of the replicates."""
    draws = posterior.draws(entry.rows.equation, TEST_DRAWS)
    parameters = jax.tree.map(np.asarray, parameters_of(draws))
    inverse_R = on_device(entry.rows.noise.precision_at(index))
    rng = np.random.default_rng(posterior.sampling.seed)
    steps = np.arange(len(index) + 1) / len(index)
    p, gaps, outside = [], [], []
    for s in range(len(draws.theta)):
        draw = jax.tree.map(lambda leaf: leaf[s], parameters)  # noqa: B023
        g, inverse = (np.asarray(part) for part in _inverse(entry.design, rows, inverse_R, *draw))
        scale = np.sqrt(np.diag(inverse))
        values, vectors = np.linalg.eigh(inverse / np.outer(scale, scale))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        # Sorted once for all statistics.
        replicated = np.sort(rng.standard_normal((TEST_REPLICATES, len(index))) @ root.T, axis=1)
        statistic = anderson_darling(replicated)
        p.append((1 + np.sum(statistic >= anderson_darling((g / scale)[None]))) / (1 + TEST_REPLICATES))
        u = ndtr(replicated)
        gaps.append(np.maximum(steps[1:] - u, u - steps[:-1]).max(axis=1))
        outside.append(np.mean((u < 0.05) | (u > 0.95), axis=1))
    return combined_p(np.array(p)), np.concatenate(gaps), np.concatenate(outside)


@compiled
def _inverse(
    design: Design, rows: WeightedRows, inverse_R: Float[Array, "n n"], hyper: Hyperparameters,
    sd: Float[Array, " n_term"], mean: Float[Array, " n_term"],
) -> tuple[Array, Array]:  # fmt: skip
    """Return C⁻¹y and C⁻¹ at some rows."""
    root = design.beside(mean).root(rows.beside(mean), hyper, sd)
    return root.g, design.inverse(root.H.T, root.H.T, inverse_R, hyper)
