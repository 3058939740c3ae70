"""Table of units that the whole package shares."""

from functools import cache
from typing import Any


@cache
def registry() -> Any:
    """Return pint's table of units, built on first use (it takes a noticeable part of a second)."""
    import pint

    return pint.UnitRegistry()
