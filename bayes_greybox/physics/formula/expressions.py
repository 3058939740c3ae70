"""Formulas written as text: read through a whitelist into SymPy, evaluated with NumPy or JAX."""

from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache, reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import sympy
from jaxtyping import Array, Float

from bayes_greybox.running.errors import InputError

from .functions import FUNCTIONS, NODE_CLASSES
from .grammar import FUNCTION_LIST, REMEMBERED_FORMULAS, check_known, check_name, check_size, read, symbol


def parse_expression(text: str, names: Iterable[str] | None = None) -> sympy.Expr:
    """Read a formula such as `"y**2*abs(ydot) + sin(2*y)"` into a SymPy expression, in SymPy's canonical form.

    Numbers, the given names (None: any), `pi`, `+ - * / **`, parentheses and the functions sin, cos, tan, asin, acos,
    atan, sinh, cosh, tanh, exp, log, sqrt, abs, sign, min, max and heaviside (0 below zero, 1/2 at zero, 1 above) are
    allowed. Names become real SymPy symbols.

    Raises:
        InputError: A part is outside the whitelist; the message names it and says what to write instead.
    """
    if not isinstance(text, str):
        raise InputError(f"A formula must be text, not {type(text).__name__}; write for example 'y**2'.")
    return read(text, None if names is None else tuple(check_name(name) for name in names))


def check_expression(expr: sympy.Expr) -> sympy.Expr:
    """Return a SymPy expression of a user's own over real symbols, as `parse_expression` does."""
    real: Any = expr.xreplace({s: symbol(check_name(s.name)) for s in expr.atoms(sympy.Symbol)})
    for node in sympy.preorder_traversal(real):
        if not isinstance(node, NODE_CLASSES):
            raise InputError(f"{node} in {expr} is not available; use {FUNCTION_LIST}.")
    check_size(real, str(expr))
    return real


@lru_cache(REMEMBERED_FORMULAS)
def symbol_names(expr: sympy.Expr) -> tuple[str, ...]:
    """Return the names of the columns in an expression, sorted."""
    return tuple(sorted(s.name for s in expr.atoms(sympy.Symbol)))


def evaluate(
    expr: sympy.Expr, columns: Mapping[str, Float[Array | np.ndarray, "..."]]
) -> Float[Array | np.ndarray, "..."]:
    """Evaluate an expression on columns by name, of shapes that broadcast; works under jit, vmap and grad.

    Integer powers and their gradients are finite at zero and for negative bases. The
    gradients of sqrt, abs, sign and heaviside at zero are taken as 0. The result has the columns' common shape, also
    where the expression is a constant; NumPy's results are read-only.

    Raises:
        InputError: A column of the expression is missing.
    """
    check_known(symbol_names(expr), columns, expr)
    xp = namespace(columns.values())
    values: list[Any] = []
    # The caller judges values that are not finite, as under JAX.
    with np.errstate(all="ignore"):
        for operation, places in _operations(expr):
            values.append(operation(xp, columns, [values[place] for place in places]))
    return xp.broadcast_to(values[-1], np.broadcast_shapes(*(np.shape(c) for c in columns.values())))


def namespace(arrays: Iterable[Any]) -> Any:
    """Return `numpy` for NumPy's arrays, so that nothing is compiled to be run once, and `jax.numpy` for all others."""
    return jnp if any(isinstance(a, jax.Array) for a in arrays) else np


Operation = Callable[[Any, Mapping[str, Any], list[Any]], Any]
"""(namespace, columns, values of the arguments) -> value of a node."""


@lru_cache(REMEMBERED_FORMULAS)
def _operations(expr: sympy.Basic) -> tuple[tuple[Operation, tuple[int, ...]], ...]:
    """List the nodes of an expression once, each after its arguments and with their places; the last one is the whole.

    A path evaluates the same formulas thousands of times, and a walk through SymPy's tree takes longer than the
    arithmetic.
    """
    places: dict[sympy.Basic, int] = {}
    operations = []
    for node in sympy.postorder_traversal(expr):
        if node not in places:
            operations.append((_operation(node), tuple(places[arg] for arg in node.args)))
            places[node] = len(places)
    return tuple(operations)


def _operation(node: sympy.Basic) -> Operation:
    if isinstance(node, sympy.Symbol):
        name = node.name
        return lambda xp, columns, args: xp.asarray(columns[name], dtype=float)
    if isinstance(node, sympy.Number | sympy.NumberSymbol):
        number = float(node)
        return lambda xp, columns, args: xp.asarray(number)
    if isinstance(node, sympy.Add):
        return lambda xp, columns, args: reduce(xp.add, args)
    if isinstance(node, sympy.Mul):
        return lambda xp, columns, args: reduce(xp.multiply, args)
    if isinstance(node, sympy.Pow):
        exponent = node.args[1]
        return lambda xp, columns, args: _power(args[0], exponent, args[1], xp)
    for function in FUNCTIONS.values():
        if isinstance(node, function.node):
            array = function.array
            return lambda xp, columns, args: array(xp, *args)
    raise InputError(f"{node} is not available in formulas; use {FUNCTION_LIST}.")


def _power(base: Any, exponent: sympy.Basic, exponent_value: Any, xp: Any) -> Any:
    if isinstance(exponent, sympy.Integer):
        # Products are ten times as fast as NumPy's powers.
        return reduce(xp.multiply, [base] * int(exponent)) if 1 < exponent < 8 else base ** int(exponent)
    if isinstance(exponent, sympy.Rational) and exponent.q == 2:
        return FUNCTIONS["sqrt"].array(xp, base) ** int(exponent.p)
    return xp.power(base, exponent_value)
