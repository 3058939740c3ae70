"""Whole numbers of more digits than a float holds, such as stamps in nanoseconds."""

import numpy as np
from jaxtyping import Float

LARGEST_EXACT_INTEGER = 2**53
"""Largest number up to which every whole number is a float."""


def first_lost(values: np.ndarray) -> int | None:
    """Return the place of the first whole number that no float equals; None if there is none.

    Args:
        values: Numbers of any kind.
    """
    if values.dtype.kind not in "iu" or not len(values):
        return None
    if max(int(values.max()), -int(values.min())) <= LARGEST_EXACT_INTEGER:
        return None
    with np.errstate(invalid="ignore"):
        lost = values.astype(float).astype(values.dtype) != values
    return int(np.argmax(lost)) if lost.any() else None


def since_first(values: np.ndarray) -> Float[np.ndarray, " n"]:
    """Return whole numbers less the smallest of them, t_i − min t, subtracted before they become floats."""
    return (values - values.min()).astype(float)
