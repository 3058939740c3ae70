"""Arrays as users pass them: with a mask, a unit or imaginary parts, none of which a column of floats has."""

from typing import Any

import numpy as np

from bayes_greybox.running.errors import InputError

NO_UNIT = ("", "dimensionless")
"""Units of a plain number in libraries of units."""


def plain_array(values: Any, what: str) -> np.ndarray:
    """Return values as an array of their own type; if some are masked, as floats with NaN for these.

    Raises:
        InputError: Complex numbers; a unit of the values' own. The message calls the values `what`.
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
