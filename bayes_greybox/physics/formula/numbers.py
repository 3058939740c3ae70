"""Numbers within formulas as arguments, so that formulas which differ in them alone compile to the same."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import sympy

from .expressions import evaluate
from .grammar import symbol


class Named(NamedTuple):
    """A formula that is read once for all values of numbers in it: with symbols for these, as `as_columns` has them."""

    formula: sympy.Expr
    numbers: tuple[float, ...]


class Parts(NamedTuple):
    """Formulas with a symbol for each largest part of them that depends on no column, and these parts."""

    formulas: tuple[sympy.Expr, ...]
    parts: tuple[sympy.Expr, ...]

    def at(self, values: Mapping[str, float]) -> tuple[Named, ...]:
        """Return the formulas at values of the parameters on which the parts depend."""
        columns = {name: np.asarray(value, float) for name, value in values.items()}
        numbers = tuple(float(evaluate(part, columns)) for part in self.parts)
        return tuple(Named(formula, numbers) for formula in self.formulas)


def without_numbers(formulas: Iterable[sympy.Expr]) -> tuple[tuple[sympy.Expr, ...], tuple[float, ...]]:
    """Replace each decimal number in formulas over columns by a symbol; return the formulas and the numbers.

    No column can have the name of such a symbol, which is no identifier (see `grammar.check_name`).
    """
    expressions: list[Any] = list(formulas)
    numbers = sorted(set().union(*(each.atoms(sympy.Float) for each in expressions)))
    symbols: dict[Any, Any] = {number: symbol(_name(k)) for k, number in enumerate(numbers)}
    return tuple(each.xreplace(symbols) for each in expressions), tuple(float(number) for number in numbers)


def parted(formulas: Iterable[sympy.Basic], names: Collection[str]) -> Parts:
    """Collect the parts of formulas that depend on nonlinear parameters alone, by name; parameters are positive."""
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
            # Parts without a nonlinear parameter stay as they are.
            if any(arg.free_symbols for arg in alone):
                rest = [fold(arg) for arg in expr.args if not arg.free_symbols <= inner]
                return expr.func(fold(expr.func(*alone)), *rest)
        return expr.func(*map(fold, expr.args))

    expressions: list[Any] = list(formulas)
    return Parts(tuple(fold(each.xreplace(positive)) for each in expressions), tuple(parts))


def as_columns(numbers: Sequence[Any]) -> dict[str, Any]:
    """Return numbers, in the order of `without_numbers`, by the names of their symbols."""
    return {_name(k): number for k, number in enumerate(numbers)}


def _name(k: int) -> str:
    return f"#{k}"
