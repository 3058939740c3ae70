"""Jumps in formulas, rounded: an integrator cannot stay on one, as friction keeps a mass at rest.

sign(x) → tanh(x / w),   heaviside(x) → (1 + tanh(x / w)) / 2

A jump has no derivative either, but a small change of the path moves the time at which it comes: over a crossing at the
slope a it is worth a kick of 2/|a|. So jumps are rounded for their derivative too, with w = `JUMP_HALF_WIDTH` RMS
change of x from node to node, which has that kick whatever w is, as long as nodes resolve it.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import sympy
from jaxtyping import Float

from .expressions import evaluate
from .grammar import symbol

ROUNDED = 1e-4
"""Half width w of a jump for an integrator, in RMS values of its argument: a body that sticks creeps by this share of
its speed."""


def smooth_jump(jump: sympy.Expr, width: Any) -> sympy.Expr:
    """Round a jump, sign(x) or heaviside(x), to the half width w."""
    smooth = sympy.tanh(jump.args[0] / width)
    return smooth if isinstance(jump, sympy.sign) else (1 + smooth) / 2


def rounded(expr: sympy.Expr, columns: Mapping[str, Float[np.ndarray, " n"]]) -> sympy.Expr:
    """Round each jump of a formula over `ROUNDED` of the RMS of its argument on the columns."""
    smooth: dict[Any, sympy.Expr] = {}
    jumps: set[Any] = expr.atoms(sympy.sign, sympy.Heaviside)
    inner = [jump for jump in jumps if not jump.args[0].atoms(sympy.sign, sympy.Heaviside)]
    for jump in inner:
        with np.errstate(all="ignore"):
            size = float(np.sqrt(np.nanmean(np.square(np.asarray(evaluate(jump.args[0], columns), float)))))
        if 0 < size < np.inf:
            smooth[jump] = smooth_jump(jump, sympy.Float(ROUNDED * size))
    if not smooth:
        return expr
    whole: Any = expr.xreplace(smooth)
    # A jump within a jump goes first.
    return rounded(whole, columns) if len(inner) < len(jumps) else whole


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
    widths, replaced = [], {}
    for jump in expr.atoms(sympy.sign, sympy.Heaviside):
        width, argument = symbol(f"width_{len(widths)}"), jump.args[0]
        replaced[jump] = smooth_jump(jump, width)
        widths.append((width.name, argument))
    smoothed = expr.xreplace(replaced)
    return tuple(sympy.diff(smoothed, symbol(name)) for name in names), tuple(widths)
