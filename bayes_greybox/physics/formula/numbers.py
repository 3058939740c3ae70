"""Numbers within formulas as arguments, so that formulas which differ in them alone compile to the same."""

from collections.abc import Iterable, Sequence
from typing import Any

import sympy

from .grammar import symbol


def without_numbers(formulas: Iterable[sympy.Expr]) -> tuple[tuple[sympy.Expr, ...], tuple[float, ...]]:
    """Formulas with a symbol for each decimal number in them, and these numbers.

    No column can be called what these symbols are: such a name is no identifier (see `grammar.check_name`).

    Args:
        formulas: Over columns.
    """
    given: list[Any] = list(formulas)
    within = sorted(set().union(*(each.atoms(sympy.Float) for each in given)))
    names: dict[Any, Any] = {number: symbol(_name(k)) for k, number in enumerate(within)}
    return tuple(each.xreplace(names) for each in given), tuple(float(number) for number in within)


def as_columns(numbers: Sequence[Any]) -> dict[str, Any]:
    """The numbers by the names of their symbols.

    Args:
        numbers: In the order of `without_numbers`.
    """
    return {_name(k): number for k, number in enumerate(numbers)}


def _name(k: int) -> str:
    return f"#{k}"
