"""Information of an experiment about which hypothesis holds, in closed form.

Near its mean, hypothesis i predicts y ~ N(m_i, S_i), S_i = I + A_iᵀA_i, over the noise; A_i has one row for each latent
of its coefficients' posterior, so that only differences beyond a refit count. The information about the hypothesis is
at least (Kolchinsky & Tracey 2017, eq. 10, with the Bhattacharyya distance)

    I(M; y) ≥ −Σ_i p_i log Σ_j p_j exp(−C_ij),   C_ij = ⅛ dᵀS⁻¹d + ½ log|S| − ¼ log|S_i| − ¼ log|S_j|,

d = m_i − m_j, S = (S_i + S_j)/2.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

TOO_UNCERTAIN = 1e6
"""Noise standard deviations at which residuals are cut off, and from which on uncertain rows do not count."""


class Information(NamedTuple):
    """An expected information in bits, with its standard error: zero, where it is a closed form."""

    bits: float
    error: float = 0.0


class Response(NamedTuple):
    """Prediction of one hypothesis: m, rows of A of coefficients, and rows of A of an experiment's own start."""

    mean: Float[np.ndarray, " n_row"]
    load: Float[np.ndarray, "n_latent n_row"]
    start: Float[np.ndarray, "n_start n_row"]


def together(each: Sequence[Response]) -> Response:
    """Return the prediction of several experiments."""
    means, loads, starts = zip(*each, strict=True)
    return Response(np.concatenate(means), np.hstack(loads), np.asarray(block_diag(*starts)))


def distance(one: Response, other: Response) -> float:
    """Return the Bhattacharyya distance C of two predictions, in nats."""
    A, B = (np.vstack([each.load, each.start]) for each in (one, other))
    d = one.mean - other.mean
    sure = np.isfinite(d) & np.all(np.abs(np.vstack([A, B])) < TOO_UNCERTAIN, axis=0)
    A, B, d = A[:, sure], B[:, sure], np.clip(d[sure], -TOO_UNCERTAIN, TOO_UNCERTAIN)
    # Along right singular vectors of both loads S is 1 + s², and 1 elsewhere.
    _, s, V = np.linalg.svd(np.vstack([A, B]) / np.sqrt(2), full_matrices=False)
    left, logs = d - (V @ d) @ V, [np.linalg.slogdet(np.eye(len(L)) + L @ L.T)[1] for L in (A, B)]
    squares = left @ left + np.sum((V @ d) ** 2 / (1 + s**2))
    return float(squares / 8 + np.sum(np.log1p(s**2)) / 2 - sum(logs) / 4)


def information(responses: Sequence[Sequence[Response]], p: Float[np.ndarray, " n"]) -> float:
    """Return the information in bits, of predictions of all hypotheses along the path of each, by probabilities p."""
    overlaps = [[np.exp(-distance(each[i], other)) for other in each] for i, each in enumerate(responses)]
    return float(-p @ np.log2(np.array(overlaps) @ p))
