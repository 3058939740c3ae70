"""Arrays as users pass them, with a mask, a unit, imaginary parts or too many digits, and as columns of floats."""

from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_greybox.running.errors import InputError

LARGEST_EXACT_INTEGER = 2**53  # largest number up to which every whole number is a float
NO_UNIT = ("", "dimensionless")  # units of a plain number in libraries of units


def plain_array(values: Any, what: str) -> np.ndarray:
    """Return values as an array of their own type; if some are masked, as floats with NaN for these.

    Complex numbers, and a unit of the values' own, are refused; the message calls the values `what`.
    """
    kind, dtype = type(values), getattr(values, "dtype", None)
    if getattr(dtype, "kind", "") not in ("m", "M"):
        # Of a class that has units, such as pint's: elsewhere an attribute of that name may be anything.
        unit = next((str(getattr(values, name)) for name in ("units", "unit") if hasattr(kind, name)), "")
        if unit not in NO_UNIT:
            raise InputError(
                f"The {what} has a unit of its own, {unit}, which would be lost: give its numbers, and that unit in "
                "units={...}."
            )
    if hasattr(kind, "magnitude"):
        values = values.magnitude
    if np.ma.is_masked(values) and values.dtype.kind in "iuf":
        values = np.ma.filled(values.astype(float), np.nan)
    array = np.asarray(values)
    if array.dtype.kind == "c":
        raise InputError(f"The {what} holds complex numbers, of which a row has none: give real and imaginary parts.")
    return array


def first_lost(values: np.ndarray) -> int | None:
    """Return the place of the first whole number that no float equals; None if there is none."""
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
