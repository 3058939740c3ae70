"""Expected information of an experiment about the explanation, from Gaussian predictions of what it would show.

Given an explanation, its coefficients are μ + Wᵀz with z ~ N(0, I), and a response that is linear in them,
y = m + A z + σ ε, has the density (Woodbury; Rasmussen & Williams 2006, A.9)

    log p(y) = −½ (q − hᵀ (I + G)⁻¹ h + log|I + G|) + const,   q = |r|²,  h = Aᵀr,  G = AᵀA,  r = y − m, over σ.

q, h and G are sums over rows, and so over experiments that share the coefficients: several experiments at once cost no
more than their sum.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

BITS = float(np.log(2.0))
"""Nats of a bit."""

FAR = 1e6
"""Noise standard deviations: a residual is not told from a larger one, and rows less certain than this do not count."""

FAINT = 1e-14
"""Share of its trace that a matrix has on its diagonal at least, so that it can be inverted."""


class Products(NamedTuple):
    """What responses say of one component; a sum over experiments is that of all.

    Attributes:
        q: [n_outcome], with what uncertain starts cost.
        h: [n_outcome, n_latent].
        G: [n_outcome, n_latent, n_latent].
    """

    q: Float[np.ndarray, " n_outcome"]
    h: Float[np.ndarray, "n_outcome n_latent"]
    G: Float[np.ndarray, "n_outcome n_latent n_latent"]

    def beside(self, other: "Products") -> "Products":
        """Both experiments, whose outcomes share their draws."""
        return Products(*(a + b for a, b in zip(self, other, strict=True)))

    def log_density(self) -> Float[np.ndarray, " n_outcome"]:
        """Log density of each outcome, up to a constant of the outcome."""
        one = _beside_one(self.G)
        solved = np.linalg.solve(one, self.h[..., None])[..., 0]
        return -0.5 * (self.q - np.sum(self.h * solved, axis=-1) + np.linalg.slogdet(one)[1])


def bounded(r: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Residuals over σ whose squares stay exact: what is `FAR` is as impossible as what is further."""
    return np.clip(r, -FAR, FAR)


class Information(NamedTuple):
    """An expected information, in bits.

    Attributes:
        bits: Its estimate.
        error: Standard error of the simulation.
    """

    bits: float
    error: float


def marginal_starts(
    q: Float[np.ndarray, "*batch"], h: Float[np.ndarray, "*batch n"], G: Float[np.ndarray, "*batch n n"], n_own: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Products without the last latents, an experiment's own: they are integrated out.

    Args:
        q: Of rows and all latents.
        h: Likewise.
        G: Likewise.
        n_own: How many are its own.
    """
    if not n_own:
        return q, h, G
    k = h.shape[-1] - n_own
    C, B = _beside_one(G[..., k:, k:]), G[..., :k, k:]
    solved = np.linalg.solve(C, h[..., k:, None])[..., 0]
    q = q - np.sum(h[..., k:] * solved, axis=-1) + np.linalg.slogdet(C)[1]
    h = h[..., :k] - np.einsum("...ij,...j->...i", B, solved)
    return q, h, G[..., :k, :k] - B @ np.linalg.solve(C, np.swapaxes(B, -1, -2))


def of_explanations(
    log_density: Float[np.ndarray, "n_outcome n_component"],
    explanation: Int[np.ndarray, " n_component"],
    weight: Float[np.ndarray, " n_component"],
) -> Float[np.ndarray, "n_outcome n_explanation"]:
    """Log densities under explanations, mixtures of their components.

    Args:
        log_density: Under components.
        explanation: Which explanation each component belongs to.
        weight: Of each component in it.
    """
    n = int(np.max(explanation)) + 1
    each = log_density + np.log(weight)
    return np.stack([np.logaddexp.reduce(each[:, explanation == m], axis=1) for m in range(n)], axis=1)


def expected_information(
    log_density: Float[np.ndarray, "n_outcome n_explanation"],
    truth: Int[np.ndarray, " n_outcome"],
    probability: Sequence[float] | Float[np.ndarray, " n_explanation"],
) -> Information:
    """Mutual information of explanation M and outcome y (Lindley 1956), estimated by simulated outcomes.

        I(M; y) = Σ_m P(m) E[log p(y | m) − log Σ_m' P(m') p(y | m')],   y ~ p(· | m)

    With densities that only approximate those that the outcomes come from, its expectation is a lower bound (Barber &
    Agakov 2003): nothing is promised that the data could not hold.

    Args:
        log_density: Of each outcome under each explanation, up to a constant of the outcome.
        truth: Explanation that each outcome was simulated under; every one has some.
        probability: P(m); they sum to one.

    Returns:
        The information with its Monte Carlo error, stratified by m.
    """
    p = np.asarray(probability, float)
    own = np.take_along_axis(log_density, truth[:, None], axis=1)[:, 0]
    gain = own - np.logaddexp.reduce(log_density + np.log(p), axis=1)
    total, variance = 0.0, 0.0
    for m, share in enumerate(p):
        each = gain[truth == m]
        total += share * float(np.mean(each))
        variance += share**2 * float(np.var(each, ddof=1)) / len(each)
    return Information(total / BITS, float(np.sqrt(variance)) / BITS)


def entropy(probability: Sequence[float] | Float[np.ndarray, " n"]) -> float:
    """Entropy of explanations in bits: what an experiment that tells them all apart is worth."""
    p = np.asarray(probability, float)
    p = p[p > 0]
    return float(-np.sum(p * np.log(p))) / BITS


def _beside_one(G: np.ndarray) -> np.ndarray:
    """I + G, which rounding cannot make singular."""
    size = np.trace(G, axis1=-2, axis2=-1)[..., None, None]
    return (1.0 + FAINT * size) * np.eye(G.shape[-1]) + G
