"""The functions and constants that a formula may use: one row each, for SymPy and arrays."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from typing import Any

import sympy


@dataclass(frozen=True)
class Function:
    """One function of the formula language.

    Attributes:
        symbolic: Function that builds the SymPy node; takes `evaluate`.
        node: The SymPy class of that node (an empty tuple where the node is a plain power).
        array: The function on arrays: takes their namespace, `numpy` or `jax.numpy`, then the arguments of the SymPy
            node.
        arity: Smallest and largest number of arguments.
    """

    symbolic: Callable[..., sympy.Expr]
    node: Any
    array: Callable[..., Any]
    arity: tuple[int, int] = (1, 1)

    def written(self, args: tuple[Any, ...]) -> tuple[Any, ...]:
        """Select the arguments that a user writes from those of the SymPy node."""
        return args[: self.arity[1]]


def _sqrt(xp: Any, x: Any) -> Any:
    # The inner where keeps the gradient at zero finite (0 instead of infinity); negative x still gives NaN.
    return xp.where(x == 0.0, 0.0, xp.sqrt(xp.where(x == 0.0, 1.0, x)))


def _abs(xp: Any, x: Any) -> Any:
    # Its gradient at zero is 0, where that of jnp.abs is 1.
    return x * xp.sign(x)


def _heaviside(xp: Any, x: Any, at_zero: Any = 0.5) -> Any:
    return xp.where(x > 0.0, 1.0, xp.where(x < 0.0, 0.0, xp.where(x == 0.0, at_zero, xp.nan)))


def _plain(node: Any) -> Function:
    """Describe a function that NumPy and JAX have under SymPy's name."""
    name = node.__name__
    return Function(symbolic=node, node=node, array=lambda xp, x: getattr(xp, name)(x))


_PLAIN = (
    sympy.sin, sympy.cos, sympy.tan, sympy.asin, sympy.acos, sympy.atan, sympy.sinh, sympy.cosh, sympy.tanh, sympy.exp,
    sympy.log,
)  # fmt: skip

FUNCTIONS: dict[str, Function] = {
    **{node.__name__: _plain(node) for node in _PLAIN},
    "sqrt": Function(lambda x, evaluate: sympy.Pow(x, sympy.Rational(1, 2), evaluate=evaluate), (), _sqrt),
    "abs": Function(sympy.Abs, sympy.Abs, _abs),
    "sign": _plain(sympy.sign),
    "min": Function(sympy.Min, sympy.Min, lambda xp, *a: reduce(xp.minimum, a), (2, 8)),
    "max": Function(sympy.Max, sympy.Max, lambda xp, *a: reduce(xp.maximum, a), (2, 8)),
    # 0 below zero, 1/2 at zero, 1 above.
    "heaviside": Function(
        lambda x, evaluate: sympy.Heaviside(x, sympy.S.Half, evaluate=evaluate), sympy.Heaviside, _heaviside
    ),
}

CONSTANTS: dict[str, sympy.Expr] = {"pi": sympy.pi}

ALIASES = {
    "ln": "log", "arcsin": "asin", "arccos": "acos", "arctan": "atan", "fabs": "abs", "Abs": "abs",
    "sgn": "sign", "minimum": "min", "maximum": "max", "step": "heaviside", "theta": "heaviside", "pow": "**",
}  # fmt: skip
"""Names in other languages, for "did you mean"."""

NODE_CLASSES = (
    sympy.Symbol, sympy.Integer, sympy.Rational, sympy.Float, sympy.NumberSymbol, sympy.Add, sympy.Mul, sympy.Pow,
    *(f.node for f in FUNCTIONS.values() if f.node),
)  # fmt: skip
"""Node classes that an expression may contain."""
