"""Rows that come in pieces: triangular factors that are stacked on what comes next and factored again.

    RᵀR = Σ_i F_iᵀF_i   from   Q_i R_i = [R_{i−1}; F_i],   R₀ = 0

(Demmel, Grigori, Hoemmen & Langou 2012, SIAM J. Sci. Comput. 34:A206, Sec. 3). Sums of products would square the
condition number of F; Householder reflections keep it, each column to a few ε of its own length, and ask for no second
look at rows that were seen.
"""

from collections.abc import Iterable

import numpy as np
import scipy.linalg
from jaxtyping import Float

CACHED_ROWS = 1024
"""Rows worked on at a time, few enough to stay in the processor's cache."""

PANEL = 16
"""Columns that LAPACK reflects at a time; the fastest of 16, 32 and 64 for a hundred columns."""


def empty_factor(n_column: int) -> Float[np.ndarray, "n_column n_column"]:
    """Return R of no rows."""
    return np.zeros((n_column, n_column), order="F")


def stacked(
    R: Float[np.ndarray, "n_column n_column"], rows: Float[np.ndarray, "n_row n_column"]
) -> Float[np.ndarray, "n_column n_column"]:
    """Return R of the rows behind R and of more, by a QR factorisation that knows of R's zeros (LAPACK's tpqrt).

    Signs of the rows of R are free.
    """
    (tpqrt,) = scipy.linalg.get_lapack_funcs(("tpqrt",), (R,))
    R = np.array(R, order="F")
    for start in range(0, len(rows), CACHED_ROWS):
        block = np.array(rows[start : start + CACHED_ROWS], order="F")
        R, _, _, failed = tpqrt(0, min(PANEL, len(R)), R, block, overwrite_a=True, overwrite_b=True)
        assert not failed
    return R


def joined(factors: Iterable[Float[np.ndarray, "n_column n_column"]]) -> Float[np.ndarray, "n_column n_column"]:
    """Return R of several factors' rows, stacked in their order: another order rounds otherwise."""
    parts = iter(factors)
    R = next(parts)
    for part in parts:
        R = stacked(R, part)
    return R
