"""Jumps in formulas, rounded: an integrator cannot stay on one, as friction keeps a mass at rest.

sign(x) → tanh(x / w),   heaviside(x) → (1 + tanh(x / w)) / 2
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import sympy
from jaxtyping import Float

from .expressions import evaluate

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
