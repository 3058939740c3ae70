"""Numbers within formulas as arguments, so that formulas which differ in them alone compile to the same."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import sympy

from .expressions import evaluate
from .grammar import symbol


class Named(NamedTuple):
    """A formula that is read once for all values of numbers in it.

    Attributes:
        formula: With a symbol for each of these numbers.
        numbers: In the order of `as_columns`.
    """

    formula: sympy.Expr
    numbers: tuple[float, ...]


class Parts(NamedTuple):
    """Formulas with a symbol for each largest part of them that depends on no column, and these parts."""

    formulas: tuple[sympy.Expr, ...]
    parts: tuple[sympy.Expr, ...]

    def at(self, values: Mapping[str, float]) -> tuple[Named, ...]:
        """The formulas at values of what the parts depend on."""
        known = {name: np.asarray(value, float) for name, value in values.items()}
        numbers = tuple(float(evaluate(part, known)) for part in self.parts)
        return tuple(Named(formula, numbers) for formula in self.formulas)


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


def parted(formulas: Iterable[sympy.Basic], names: Collection[str]) -> Parts:
    """Parts of formulas that depend on no column, as SymPy's own sums and products of numbers are.

    Args:
        formulas: Over columns and inner parameters.
        names: Of the inner parameters, which are positive.
    """
    positive: dict[Any, Any] = {symbol(name): sympy.Symbol(name, positive=True) for name in names}
    inner, parts = set(positive.values()), {}

    def fold(expr: Any) -> Any:
        used = expr.free_symbols
        if not used & inner:
            return expr
        if used <= inner:
            return parts.setdefault(expr, symbol(_name(len(parts))))
        if isinstance(expr, sympy.Add | sympy.Mul):
            alone = [arg for arg in expr.args if arg.free_symbols <= inner]
            # What has no inner parameter in it stays as it is.
            if any(arg.free_symbols for arg in alone):
                rest = [fold(arg) for arg in expr.args if not arg.free_symbols <= inner]
                return expr.func(fold(expr.func(*alone)), *rest)
        return expr.func(*map(fold, expr.args))

    given: list[Any] = list(formulas)
    folded = tuple(fold(each.xreplace(positive)) for each in given)
    return Parts(folded, tuple(parts))


def as_columns(numbers: Sequence[Any]) -> dict[str, Any]:
    """The numbers by the names of their symbols.

    Args:
        numbers: In the order of `without_numbers`.
    """
    return {_name(k): number for k, number in enumerate(numbers)}


def _name(k: int) -> str:
    return f"#{k}"
