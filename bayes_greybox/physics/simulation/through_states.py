"""Slopes of parameters that act through hidden states, whose sensitivities are hidden states beside them."""

from collections.abc import Collection, Mapping
from typing import Any

import sympy

from bayes_greybox.physics.formula.expressions import symbol_names
from bayes_greybox.physics.formula.grammar import symbol
from bayes_greybox.physics.formula.printing import to_text
from bayes_greybox.physics.hidden_states import HiddenState, Starts
from bayes_greybox.physics.parameters import Parameters, at_here, slope_by

Formulas = Mapping[str, sympy.Expr]
"""Formulas by state or output, with names of parameters."""


def acting_through(formulas: Formulas, starts: Starts, parameters: Collection[str]) -> frozenset[str]:
    """Return the parameters that stand in the rates of hidden states with a start, or are a start."""
    names = {name for state in starts if state in formulas for name in symbol_names(formulas[state])}
    return frozenset((names | {start for start in starts.values() if isinstance(start, str)}) & {*parameters})


def through_states(
    equation: str, parameter: str, formulas: Formulas, starts: Starts, parameters: Parameters
) -> tuple[sympy.Expr, tuple[HiddenState, ...]]:
    """Return Σ_i ∂g/∂z_i s_i, the part of dg/dp by way of hidden states, and their sensitivities s_i = dz_i/dp.

    Both are at the values that formulas are linearised at. With ż = r(x, u, z, p), z known where a run starts,

        ds_i/dt = ∂r_i/∂p + Σ_j ∂r_i/∂z_j s_j,   s_i = 0 where a run starts; 1 of a state that starts at p.
    """
    moved = _moved(parameter, formulas, starts)
    called = {state: f"slope_of_{state}_by_{parameter}" for state in moved}
    used = [state for state in moved if state in symbol_names(formulas[equation])]
    if not used:
        return sympy.S.Zero, ()

    def along(formula: sympy.Expr) -> sympy.Expr:
        parts = [slope_by(formula, z, 1.0) * symbol(called[z]) for z in moved if z in symbol_names(formula)]
        return sympy.Add(*parts)

    states, here = [], parameters[parameter].here
    for state in moved:
        rate: Any = slope_by(formulas[state], parameter, here) + along(formulas[state])
        rest = 1.0 if starts[state] == parameter else 0.0
        states.append(HiddenState(called[state], to_text(at_here(rate, parameters)), state, rest=rest))
    return at_here(along(formulas[equation]), parameters), tuple(states)


def _moved(parameter: str, formulas: Formulas, starts: Starts) -> list[str]:
    """Return the hidden states that a parameter moves, by their own rates or starts or by other hidden states."""
    names = {state: symbol_names(formulas[state]) for state in starts if state in formulas}
    moved = [state for state in names if parameter in (*names[state], starts[state])]
    for _ in names:
        moved = [state for state in names if state in moved or set(names[state]) & {*moved}]
    return moved
