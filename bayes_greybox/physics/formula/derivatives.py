"""Derivatives of formulas along a path, with jumps rounded to the resolution of the path's nodes.

A jump such as that of sign(v) has no derivative, but a small change of the path moves the time at which it comes: over
a crossing at the slope a it is worth a kick of 2/|a|. So jumps are rounded for their derivative, and only for it,

    sign(x) → tanh(x / w),    w = `JUMP_HALF_WIDTH` RMS change of x from node to node,

which has that kick whatever w is, as long as nodes resolve it.
"""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import sympy
from jaxtyping import Float

from .expressions import evaluate
from .grammar import symbol
from .rounding import smooth_jump

JUMP_HALF_WIDTH = 2.0
"""Half width of a rounded jump, in changes of its argument from node to node."""


def gradient(
    expr: sympy.Expr, names: tuple[str, ...], columns: Mapping[str, Float[np.ndarray, "*n"]]
) -> Float[np.ndarray, "*n n_name"]:
    """Return derivatives of a formula by some columns; zero where they are not finite, as at the tip of a root.

    Neighbours lie along the last axis of the columns.
    """
    derivatives, widths = _derivatives(expr, names)
    values = dict(columns)
    for name, argument in widths:
        change = np.diff(np.asarray(evaluate(argument, columns)), axis=-1)
        values[name] = np.asarray(JUMP_HALF_WIDTH * np.sqrt(np.mean(change**2)) or 1.0)
    with np.errstate(all="ignore"):
        slopes = np.stack([np.asarray(evaluate(each, values)) for each in derivatives], axis=-1)
    return np.where(np.isfinite(slopes), slopes, 0.0)


@lru_cache(maxsize=4096)
def _derivatives(
    expr: sympy.Expr, names: tuple[str, ...]
) -> tuple[tuple[sympy.Expr, ...], tuple[tuple[str, sympy.Expr], ...]]:
    """Return the derivatives, and the name of each width in them with the argument that jumps there."""
    widths, rounded = [], {}
    for jump in expr.atoms(sympy.sign, sympy.Heaviside):
        width, argument = symbol(f"width_{len(widths)}"), jump.args[0]
        rounded[jump] = smooth_jump(jump, width)
        widths.append((width.name, argument))
    smoothed = expr.xreplace(rounded)
    return tuple(sympy.diff(smoothed, symbol(name)) for name in names), tuple(widths)
