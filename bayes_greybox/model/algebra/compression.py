"""Triangular factors that carry everything the likelihood needs of the rows: by one pass, or piece by piece.

Of rows that come in pieces factors are stacked on what comes next and factored again,

    RᵀR = Σ_i F_iᵀF_i   from   Q_i R_i = [R_{i−1}; F_i],   R₀ = 0

(Demmel, Grigori, Hoemmen & Langou 2012, SIAM J. Sci. Comput. 34:A206, Sec. 3). Sums of products would square the
condition number of F; Householder reflections keep it, each column to a few ε of its own length, and ask for no second
look at rows that were seen.
"""

from collections.abc import Callable, Iterable

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

CACHED_ROWS = 1024
"""Rows worked on at a time, few enough to stay in the processor's cache."""

FACTOR_CHUNK = 16_384
"""Rows held in memory at once; also the size of the sample that the preconditioner is made from."""


def empty_factor(n_column: int) -> Float[np.ndarray, "n_column n_column"]:
    """Return R of no rows."""
    return np.zeros((n_column, n_column), order="F")


def stacked(
    R: Float[np.ndarray, "n_column n_column"], rows: Float[np.ndarray, "n_row n_column"]
) -> Float[np.ndarray, "n_column n_column"]:
    """Return R of the rows behind R and of more, by a QR factorisation that knows of R's zeros (LAPACK's tpqrt)."""
    (tpqrt,) = scipy.linalg.get_lapack_funcs(("tpqrt",), (R,))
    R = np.array(R, order="F")
    for start in range(0, len(rows), CACHED_ROWS):
        block = np.array(rows[start : start + CACHED_ROWS], order="F")
        # 16 columns are reflected at a time: the fastest of 16, 32 and 64 for a hundred columns.
        R, _, _, failed = tpqrt(0, min(16, len(R)), R, block, overwrite_a=True, overwrite_b=True)
        assert not failed
    return R


def joined(factors: Iterable[Float[np.ndarray, "n_column n_column"]]) -> Float[np.ndarray, "n_column n_column"]:
    """Return R of several factors' rows, stacked in their order: another order rounds otherwise."""
    parts = iter(factors)
    R = next(parts)
    for part in parts:
        R = stacked(R, part)
    return R


def triangular_factor(
    rows: Callable[[Int[np.ndarray, " n_chunk"]], Float[np.ndarray, "n_chunk n_column"]],
    n_row: int,
    chunk: int = FACTOR_CHUNK,
) -> Float[np.ndarray, "n_kept n_column"]:
    """Return the upper triangular R with RᵀR = FᵀF for a tall matrix F that never exists as a whole.

    Up to one chunk this is a QR factorisation. Beyond, a Gram matrix alone would square the condition number,
    and a QR of every chunk costs three matrix products. Instead the rows are preconditioned by R₀, the factor
    of an evenly spaced sample:

        G = Σ (F_chunk R₀⁻¹)ᵀ (F_chunk R₀⁻¹),   R = chol(G)ᵀ R₀.

    The columns of F R₀⁻¹ are nearly orthonormal, so G is well conditioned and R keeps the precision of a QR
    (Cholesky QR, Yamamoto et al. 2015, with a sampled first pass). Where the sample does not represent the
    rest (a term that acts in a short burst), G is not, and R preconditions another pass. Each row costs a
    triangular solve and a symmetric rank-one update. `rows` returns rows of F by their indices.
    """
    if n_row <= chunk:
        return np.asarray(np.linalg.qr(rows(np.arange(n_row)), mode="r"))
    sample = rows(np.unique(np.linspace(0, n_row - 1, chunk).astype(int)))
    # A ridge keeps R₀ invertible when columns are collinear, twelve digits below what they carry.
    norms = np.linalg.norm(sample, axis=0)
    ridge = np.diag(1e-12 * np.where(norms > 0, norms, 1.0))
    R = np.linalg.qr(np.vstack([sample, ridge]), mode="r") * np.sqrt(n_row / len(sample))
    # More than one pass only where the sample does not represent the rest.
    for _ in range(3):
        G = _preconditioned_gram(rows, n_row, chunk, R)
        # With unit diagonal, a column that the sample missed, huge after preconditioning, cannot drown the others.
        size = np.sqrt(np.where(np.diag(G) > 0, np.diag(G), 1.0))
        G = G / np.outer(size, size)
        G[np.diag_indices_from(G)] += 10 * np.finfo(float).eps * len(G)
        R = (scipy.linalg.cholesky(G) * size) @ R
        # So well conditioned, one pass over the rows is enough.
        if np.linalg.eigvalsh(G)[0] > 1e-4:
            break
    return R


def _preconditioned_gram(rows: Callable, n_row: int, chunk: int, R0: np.ndarray) -> np.ndarray:
    R0 = np.asfortranarray(R0)
    # Both from SciPy: NumPy brings a BLAS of its own, whose waiting threads would take the cores from this one's.
    trsm, syrk = scipy.linalg.get_blas_funcs(("trsm", "syrk"), (R0,))
    G = np.zeros(R0.shape, order="F")
    whitened = np.empty((CACHED_ROWS, len(R0)))
    for start in range(0, n_row, chunk):
        part = rows(np.arange(start, min(start + chunk, n_row)))
        for first in range(0, len(part), CACHED_ROWS):
            block = whitened[: len(part) - first]
            np.copyto(block, part[first : first + CACHED_ROWS])
            # F R₀⁻¹ in place, then G += (F R₀⁻¹)ᵀ (F R₀⁻¹): the transpose of row-major memory is contiguous to BLAS
            trsm(1.0, R0, block.T, trans_a=1, overwrite_b=True)
            G = syrk(1.0, block.T, beta=1.0, c=G, overwrite_c=True)
    return np.triu(G) + np.triu(G, 1).T
