"""Learned equations as plain values, for JSON."""

from dataclasses import asdict
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from bayes_greybox.equations.learned import INTERVAL_LEVEL, LearnedSystem, LearnedTerm
from bayes_greybox.physics.formula.printing import to_text
from bayes_greybox.physics.units import target_unit
from bayes_greybox.report.equations.markup import left_latex, right_latex
from bayes_greybox.running.plain_values import plain_values

from .text import equation_text

RECORD_FORMAT = 1
"""Version of the record; it grows where a reader of the one before would be misled."""


def equations_record(system: LearnedSystem) -> dict[str, Any]:
    """Return equations with terms, coefficients, units, nonlinear parameters and hidden states.

    The right-hand side of an equation is its `simulation` plus the sum of `mean` times `expression` over its `terms`,
    plus f where `discrepancy` says that it is left. `given` lists the terms of the simulation whose coefficients were
    fixed. Formulas are those of configuration files, at the means of the `parameters`.
    """
    data, code = system.data, any(system.simulation.formula(name).atoms(AppliedUndef) for name in system.names)
    called = "a function (t, x, u) -> dx/dt, which cannot be written down: its rates add to the terms"
    names = (*system.states, *system.inputs)
    return plain_values(
        {
            "format": RECORD_FORMAT,
            "of": system.origin,
            "rule": system.rule,
            "interval": INTERVAL_LEVEL,
            "time": data.time_name,
            "states": list(system.states),
            "inputs": list(system.inputs),
            "hidden_states": list(system.hidden),
            "units": {name: data.unit(name) for name in ("t", *names)},
            "simulation": called if code else "formulas",
            "parameters": [asdict(each) for each in system.parameters],
            "equations": [_equation(system, name) for name in system.names],
        }
    )


def _equation(system: LearnedSystem, name: str) -> dict[str, Any]:
    simulated, learned = system.simulation.formula(name), system.learned.get(name)
    coded = simulated.atoms(AppliedUndef)
    known = simulated.xreplace(dict.fromkeys(coded, sympy.S.Zero))
    f = None if learned is None else learned.discrepancy
    return {
        "name": name,
        "label": system.data.target_label(name),
        "gives": "output" if system.is_output(name) else "rate",
        "unit": target_unit(name, system.data) or None,
        # Terms with fixed coefficients stand here beside code too.
        "simulation": to_text(known),
        "function": bool(coded),
        "learned": learned is not None,
        "pattern_probability": None if learned is None else learned.pattern,
        **{key: [_term(each) for each in getattr(learned, key, ())] for key in ("given", "terms", "left_out")},
        "inner_parameters": [
            {"name": i.name, "effect": i.effect, "meaning": i.meaning, **asdict(i.value), "unit": i.unit or None}
            for i in getattr(learned, "inner", ())
        ],
        "discrepancy": None if f is None else {"left": f.left, "variables": list(f.variables)},
        "text": equation_text(system, name),
        "latex": f"{left_latex(system, name)} = {right_latex(system, name)}",
    }


def _term(each: LearnedTerm) -> dict[str, Any]:
    return {
        "name": each.name,
        "expression": each.term.text,
        **asdict(each.value),
        "unit": each.unit or None,
        "inclusion": each.probability,
        "stated": None if each.stated is None else each.stated.record(),
    }
