"""Simulations as users give them, and as files hold them."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard

from bayes_greybox.physics.formula.expressions import parse_expression
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.parameters import Parameters
from bayes_greybox.running.errors import InputError

from .code import CallableSimulation
from .fmu.given import FMU, fmu_from, with_record
from .fmu.simulation import fmu_simulation
from .formulas import ExpressionSimulation
from .protocol import RightHandSide, Simulation, Starts

NO_STATES = (
    "the simulation is a function or an FMU, which no hidden states can be added to: give it as formulas, one for "
    "each state, simulation={'y': 'v', 'v': 'F - 2*y'}"
)
"""Reason why effects with memory are left out beside such a simulation."""

FUNCTION = "function"
"""Word that stands in files for a simulation that is code."""

FMU_RECORD = "an FMU"
"""Key of an FMU's record in files: no state can have this name."""

UserSimulation = Mapping[str, str] | RightHandSide | FMU | None
"""Expressions by state or output, a function of all states at once, an FMU, or None for no simulation."""


def simulation_of(
    given: UserSimulation, states: tuple[str, ...], inputs: tuple[str, ...], outputs: Sequence[str] = (),
    units: Mapping[str, str] | None = None, parameters: Parameters | None = None, starts: Starts | None = None,
) -> Simulation:  # fmt: skip
    """Read the user's simulation for data with these names; units are compared with those of an FMU."""
    if isinstance(given, FMU):
        return fmu_simulation(given, states, inputs, outputs, units or {})
    if callable(given):
        return CallableSimulation(states, inputs, given)
    given = given or {}
    unknown = [name for name in given if name not in (*states, *outputs)]
    if unknown:
        raise InputError(
            f"The simulation has an equation for {unknown[0]!r}, {not_known(unknown[0], states, outputs)}."
        )
    parameters = parameters or {}
    taken = next((name for name in parameters if name in (*states, *inputs)), None)
    if taken is not None:
        raise InputError(f"The parameter {taken!r} has the name of a column of the data: give it another name.")
    known = (*states, *inputs, *parameters)
    for text in map(str, given.values()):
        hidden = next((name for name in re.findall(r"[A-Za-z_]\w*", text) if name in given and name not in known), None)
        if hidden is not None:
            raise InputError(
                f"The formula {text!r} of the simulation uses {hidden!r}, which has a formula and no sensor: if it is "
                f"a hidden state, say where it starts, starts={{{hidden!r}: 1.0}}, in a file [starts]."
            )
    parsed = {name: parse_expression(str(text), known) for name, text in given.items()}
    return ExpressionSimulation.with_parameters(states, inputs, parsed, parameters, starts or {})


def readable(given: UserSimulation) -> TypeGuard[Mapping[str, str] | None]:
    """Return True if a user's simulation is formulas, or none at all: code cannot be read."""
    return not (callable(given) or isinstance(given, FMU))


def named_states(given: Any) -> tuple[str, ...]:
    """Return names that formulas have equations for, or the states of an FMU; a function names none."""
    if isinstance(given, FMU):
        return tuple(given.state_columns)
    return () if callable(given) else tuple(given or {})


def named_outputs(given: Any) -> tuple[str, ...]:
    """Return names that formulas have equations for, or the outputs of an FMU; a function gives none."""
    return tuple(given.outputs) if isinstance(given, FMU) else named_states(given)


def with_states(given: UserSimulation, states: Sequence[HiddenState]) -> Mapping[str, str]:
    """Return a user's simulation with more states; one of the same name takes the place of the one before."""
    if not readable(given):
        raise InputError(NO_STATES)
    return {**(given or {}), **{state.name: state.rate for state in states}}


def not_known(name: str, states: Sequence[str], outputs: Sequence[str], hint: str = "") -> str:
    """Say that the data lack the name of an equation, and which names they have; `hint` stands in brackets."""
    if not outputs:
        of = f"{states[0]}, or of another of them" if len(states) > 1 else "".join(states)
        remedy = f". If it is the rate of {of}: data.differentiate(rates={{{states[0]!r}: {name!r}}})" if states else ""
        return f"which is not a state of the data{hint}; states: {', '.join(states)}{remedy}"
    known = [f"{what}: {', '.join(names)}" for what, names in (("states", states), ("outputs", outputs)) if names]
    return f"which is neither a state nor an output of the data{hint}; {'; '.join(known)}"


def simulation_record(given: UserSimulation) -> Any:
    """Return a user's simulation as plain values for a file; of code only that it is code, or which FMU."""
    if isinstance(given, FMU):
        return {FMU_RECORD: given.record()}
    return FUNCTION if callable(given) else {name: str(text) for name, text in (given or {}).items()}


def simulation_from(
    record: Any, function: RightHandSide | FMU | None = None
) -> Mapping[str, str] | RightHandSide | FMU:
    """Invert `simulation_record`; a file cannot hold code, so a function is given again."""
    if record != FUNCTION:
        if FMU_RECORD in record:
            saved = record[FMU_RECORD]
            return with_record(saved, function) if isinstance(function, FMU) else function or fmu_from(saved)
        return record
    if function is None:
        raise InputError(
            "The model's simulation was a Python function, which a file cannot hold: give it again, "
            "bg.load(path, simulation=function)."
        )
    return function
