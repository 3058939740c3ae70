"""Evidence of sets of terms without a discrepancy: one eigendecomposition a hypothesis, σ integrated on a grid."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.model.gp.hyper import NoisePrior

SIGMA_NODES, SIGMA_SPAN = 33, 7.0
"""Nodes of the grid over log σ, of which 20 give the integral to 1e-6, and its half-width in standard deviations."""

LEAST_FLOOR = 1e-6
"""Least σ over the RMS of y for which sets of terms can be weighed: rounding of yᵀy − Σ b²/(σ² + λ) counts 1/2σ² times,
less than a nat at this σ, and tens to thousands of them at a tenth of it."""


@dataclass(frozen=True)
class Spectrum:
    """One hypothesis, or a batch of them, in the eigenbasis of D^½ᵀ XᵀR⁻¹X D^½.

    Attributes:
        eigenvalues: λ [..., n_column].
        loading: b = Uᵀ D^½ᵀ XᵀR⁻¹y [..., n_column].
        back: D^½ U, which maps eigen-coefficients to β [..., n_column, n_column].
        square: yᵀR⁻¹y; of a batch, one for all or one each.
    """

    eigenvalues: Float[np.ndarray, "*batch n_column"]
    loading: Float[np.ndarray, "*batch n_column"]
    back: Float[np.ndarray, "*batch n_column n_column"]
    square: Float[np.ndarray, "*batch 1"] | float
    n_obs: float | int

    @classmethod
    def of(
        cls, gram: Float[np.ndarray, "... n_column n_column"], product: Float[np.ndarray, "... n_column"],
        square: float, n_obs: float | int, sd: Float[np.ndarray, "... n_column"],
    ) -> "Spectrum":  # fmt: skip
        """Decompose hypotheses; a column with sd = 0 is out of its hypothesis.

        `gram` is XᵀR⁻¹X, `product` XᵀR⁻¹y, `square` yᵀR⁻¹y, and sd² the diagonal of D.
        """
        values, vectors = np.linalg.eigh(sd[..., :, None] * gram * sd[..., None, :])
        back = sd[..., :, None] * vectors
        loading = np.einsum("...ij,...i->...j", back, product)
        return cls(np.maximum(values, 0.0), loading, back, square, n_obs)

    def log_density(self, sigma: np.ndarray) -> np.ndarray:
        """Return log p(y | σ), f = 0, for σ of shape [n_node], or [..., n_node] with the shape of the batch.

        −½ (Σ log(1 + λ/σ²) + (yᵀR⁻¹y − Σ b²/(σ² + λ))/σ² + n log 2πσ²), less ½ log|R|.
        """
        s2 = np.asarray(sigma) ** 2
        # Column by column: reductions over a short last axis take ten times as long. Σ log(σ² + λ) is a few logarithms
        # of products, which stay within range for eight factors.
        # Without a column a batch is a batch still.
        rest, product = np.zeros((*self.eigenvalues.shape[:-1], 1)), np.ones(())
        log_det = (self.n_obs - self.eigenvalues.shape[-1]) * np.log(s2)
        for j in range(self.eigenvalues.shape[-1]):
            both = s2 + self.eigenvalues[..., j, None]
            rest, product = rest + self.loading[..., j, None] ** 2 / both, product * both
            if j % 8 == 7:
                log_det, product = log_det + np.log(product), np.ones(())
        log_det = log_det + np.log(product) + self.n_obs * math.log(2 * math.pi)
        return -0.5 * (log_det + np.maximum(self.square - rest, 0.0) / s2)


class Marginal(NamedTuple):
    """A hypothesis without f: log p(y) up to −½ log|R|, and nodes of σ with weights of sum one [*batch, n_node]."""

    log_evidence: np.ndarray
    sigma: np.ndarray
    weight: np.ndarray


def marginal(spectrum: Spectrum, noise: NoisePrior) -> Marginal:
    """Integrate σ out of log p(y | σ) on a grid around the mode of each hypothesis of the batch."""

    def objective(t: np.ndarray) -> np.ndarray:
        return spectrum.log_density(noise.sigma(t)) + noise.log_density(t)

    # The mode of log s: a coarse grid, then shrinking grids around the best node.
    # Where nothing is left but what is below the floor, the mode lies near floor/√n.
    low = math.log(max(noise.floor, 1e-6)) - 0.5 * math.log(spectrum.n_obs) - 2.0
    high = math.log(4.0 * noise.scale)
    width, centre = 0.5 * (high - low), np.full(spectrum.eigenvalues.shape[:-1], 0.5 * (high + low))
    while width > 0.3 / math.sqrt(2 * spectrum.n_obs):
        nodes = centre[..., None] + np.linspace(-width, width, 17)
        centre = np.take_along_axis(nodes, np.argmax(objective(nodes), axis=-1)[..., None], axis=-1)[..., 0]
        width *= 0.2
    step = 1.0 / math.sqrt(2 * spectrum.n_obs)
    below, at, above = np.moveaxis(objective(centre[..., None] + step * np.array([-1.0, 0.0, 1.0])), -1, 0)
    # Below the floor the density in log s falls only as the prior does: no narrower than that, no wider than 1.
    spread = np.clip(step / np.sqrt(np.maximum(2 * at - below - above, 1e-12)), step, 1.0)
    nodes = centre[..., None] + SIGMA_SPAN * spread[..., None] * np.linspace(-1, 1, SIGMA_NODES)
    values = objective(nodes)
    total = np.logaddexp.reduce(values, axis=-1)
    log_step = np.log(2 * SIGMA_SPAN * spread / (SIGMA_NODES - 1))
    return Marginal(total + log_step, noise.sigma(nodes), np.exp(values - total[..., None]))


def log_white(square: float, n: int, noise: NoisePrior) -> float:
    """Return log p of n white numbers with a sum of squares, σ integrated out: the evidence without any column."""
    return float(log_white_each(np.array([square]), n, noise)[0])


def log_white_each(
    squares: Float[np.ndarray, " n_square"], n: int, noise: NoisePrior
) -> Float[np.ndarray, " n_square"]:
    """Return `log_white` of several sums of squares at once."""
    zeros = np.zeros((len(squares), 1))
    spectrum = Spectrum(zeros, zeros, np.zeros((len(squares), 1, 1)), squares[:, None], n)
    return marginal(spectrum, noise).log_evidence


def coefficients(spectrum: Spectrum, posterior: Marginal) -> tuple[np.ndarray, np.ndarray]:
    """Return posterior mean [..., n_column] and covariance [..., n_column, n_column] of β without f, σ integrated out.

    Given σ, β ~ N(D^½U b/(σ² + λ), σ² D^½U diag 1/(σ² + λ) UᵀD^½); the mean hardly moves with σ, so the covariance is
    the average of the conditional ones plus that of the conditional means.
    """
    # σ² + λ and b/(σ² + λ) at each node of σ [..., n_node, n_column], and the mean of the latter over the nodes.
    both = posterior.sigma[..., None] ** 2 + spectrum.eigenvalues[..., None, :]
    means_at = spectrum.loading[..., None, :] / both
    centre = np.sum(posterior.weight[..., None] * means_at, axis=-2)
    within = np.sum(posterior.weight[..., None] * posterior.sigma[..., None] ** 2 / both, axis=-2)
    away = means_at - centre[..., None, :]
    between = np.einsum("...n,...ni,...nj->...ij", posterior.weight, away, away)
    inner = between + np.eye(within.shape[-1]) * within[..., None, :]
    mean = np.einsum("...ij,...j->...i", spectrum.back, centre)
    return mean, np.einsum("...ij,...jk,...lk->...il", spectrum.back, inner, spectrum.back)
