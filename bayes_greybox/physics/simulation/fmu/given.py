"""An FMU as users give it."""

import math
import numbers
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from bayes_greybox.running.errors import InputError

from .description import Description, Variable
from .files import read_fmu
from .loaded import Key, Ports
from .running import running

MAPPINGS = ("parameters", "states", "inputs", "outputs", "starts")
"""Fields that are tables of names."""


@dataclass(frozen=True)
class FMU:
    """A simulation that is an FMU, run by FMPy (extra `fmu`): of FMI 2.0 or 3.0, by Model Exchange, else Co-Simulation.

    Its continuous states are states of the model, by the names that `states` gives them, else by their own with "_" in
    place of characters that no column may have: "mass.s" is `mass_s`. A state that the data lack is hidden, as on rows
    of samples.

    A Co-Simulation is started anew at every point, with the states as its start. Rates are its own variables where it
    declares them; else they are differences of the states over three steps, D(h) = (−11 x₀ + 18 x₁ − 9 x₂ + 2 x₃) / 6h,
    and x′ = 2 D(h/2) − D(h). That is right where its error is in proportion to h, as by one step of Euler's method in
    each, or is small, as of a solver with a tolerance. Where it takes fixed steps of its own within h, give `step` no
    longer than these.

    Attributes:
        path: The file. Later changes of it have no effect: a copy is kept.
        parameters: Values of parameters, and of inputs that no column feeds, by the FMU's names.
        states: The FMU's state by the column's name, {"y": "mass.s"}; all of them for a Co-Simulation that declares
            none.
        inputs: The FMU's input by the column's name.
        outputs: The FMU's variable by the name of a measured output.
        starts: Parameter that sets a state where a Co-Simulation starts, by the column's name, {"y": "s0"}; the state
            itself by default.
        step: Length of the steps of a Co-Simulation, s; by default that of the FMU. The data need no such steps.
        description: Content of the file's description.

    Raises:
        InputError: FMPy is not installed; the file is missing or cannot be run here; a variable is missing or no real
            number; two variables have one column, or one has two; a state cannot be set.
    """

    path: str | os.PathLike[str]
    parameters: Mapping[str, float] = field(default_factory=dict)
    states: Mapping[str, str] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)
    starts: Mapping[str, str] = field(default_factory=dict)
    step: float | None = None
    description: Description = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", str(Path(self.path).resolve()))
        for name in MAPPINGS:
            object.__setattr__(self, name, dict(getattr(self, name)))
        object.__setattr__(self, "description", fmu := read_fmu(self.path))
        states = [state.name for state, _ in self.dynamics]
        declared = states if fmu.states or fmu.exchanged else [*fmu.variables]
        for name in self.states.values():
            _require_real(fmu, name, declared)
        if not states:
            if fmu.exchanged:
                raise InputError(f"The FMU {fmu.name} has no continuous state: there is no rate that it could give.")
            raise InputError(
                f"The FMU {fmu.name} is for Co-Simulation and does not declare its states: name all of them, "
                "bg.FMU(..., states={'column': 'variable'}), or export it for Model Exchange."
            )
        for name in (*self.parameters, *self.outputs.values(), *self.starts.values()):
            _require_real(fmu, name, (*fmu.variables,))
        for name in self.inputs.values():
            _require_real(fmu, name, [v.name for v in fmu.variables.values() if v.causality == "input"])
        for name in self.parameters:
            if fmu.variables[name].causality not in ("parameter", "input"):
                raise InputError(f"{name!r} of the FMU {fmu.name} is no parameter and no input: it cannot be set.")
            value = self.parameters[name]
            if not isinstance(value, numbers.Real) or not math.isfinite(value):
                raise InputError(f"{name!r} of the FMU {fmu.name} is set to {value!r}: give a finite number.")
        # Any kind of number; a file holds plain ones.
        object.__setattr__(self, "parameters", {name: float(value) for name, value in self.parameters.items()})
        for variable in fmu.variables.values():
            if variable.causality == "input":
                _require_real(fmu, variable.name, (variable.name,))
        for name in self.inputs.values():
            if name in self.parameters:
                raise InputError(f"The input {name!r} of the FMU {fmu.name} is held and fed by a column: do one.")
        dynamic = [state for state, _ in self.dynamics]
        pairs = (*_by_column(dynamic, self.states), *_by_column(self._fed, self.inputs))
        _require_once(fmu, "column", [*(name for name, _ in pairs), *self.outputs])
        for given in (self.states, self.inputs):
            _require_once(fmu, "variable", list(given.values()))
        if fmu.exchanged:
            if self.starts or self.step is not None:
                raise InputError(
                    f"The FMU {fmu.name} is run by Model Exchange: starts and step are of Co-Simulation; leave them "
                    "out."
                )
            return
        self._require_settable()

    def _require_settable(self) -> None:
        """Refuse a Co-Simulation whose states cannot be set, or whose rates nothing gives."""
        fmu, columns = self.description, self.state_columns
        for column, name in self.starts.items():
            if column not in columns:
                raise InputError(f"bg.FMU(starts=...) names {column!r}, which is no state: {', '.join(columns)}.")
            if name in self.parameters:
                raise InputError(f"{name!r} of the FMU {fmu.name} is a parameter and the start of {column!r}: do one.")
        for column, variable in columns.items():
            start = fmu.variables[self.starts.get(column, variable.name)]
            if start.initial not in ("exact", "approx"):
                raise InputError(
                    f"{start.name!r} of the FMU {fmu.name} cannot be set where a Co-Simulation starts: say which "
                    f"parameter sets it, bg.FMU(..., starts={{{column!r}: 'parameter'}}), or export the FMU for Model "
                    "Exchange."
                )
        if self.step is not None and not (isinstance(self.step, numbers.Real) and 0 < self.step < math.inf):
            raise InputError(f"step={self.step!r} of the FMU {fmu.name} must be a number of seconds above 0.")
        if self.step is not None and 0 < fmu.step < self.step:
            # Its own integrator's error would be taken for the equations': damping that is not there.
            raise InputError(
                f"step={self.step:g} s of the FMU {fmu.name} is longer than the {fmu.step:g} s that it says it is "
                "run with: give as much or less."
            )
        if self.stepped and not self.ports((), ()).step:
            lacking = next(state.name for state, rate in self.dynamics if rate is None)
            raise InputError(
                f"The FMU {fmu.name} declares no rate of {lacking!r}, so that it takes steps, and does not say how "
                "long: bg.FMU(..., step=0.001), in s; or export it for Model Exchange."
            )

    def __reduce__(self) -> Any:
        """Have another process read the file again."""
        given = {name: getattr(self, name) for name in (*MAPPINGS, "step")}
        return _read_again, (self.path, given, self.description.content)

    @property
    def dynamics(self) -> tuple[tuple[Variable, Variable | None], ...]:
        """States, each with the variable that is its rate; users name those that a Co-Simulation does not declare."""
        fmu = self.description
        if fmu.states or fmu.exchanged:
            return fmu.states
        named = [fmu.variables[name] for name in self.states.values() if name in fmu.variables]
        return tuple((each, fmu.rates.get(each.name)) for each in named)

    @property
    def stepped(self) -> bool:
        """True if rates are differences over steps: a Co-Simulation that does not give them."""
        return any(rate is None for _, rate in self.dynamics)

    def ports(self, states: Sequence[str], inputs: Sequence[str]) -> Ports:
        """Return the variables that are set at a point, for columns of states in the FMU's order, and of inputs."""
        fmu, state_columns, input_columns = self.description, self.state_columns, self.input_columns
        starts = [fmu.variables[self.starts[each]] if each in self.starts else state_columns[each] for each in states]
        return Ports(
            inputs=tuple(input_columns[each].ref for each in inputs),
            states=tuple(state_columns[each].ref for each in states),
            starts=tuple(each.ref for each in starts),
            step=0.0 if fmu.exchanged else float(self.step or fmu.step),
        )

    @property
    def key(self) -> Key:
        """Its parameters as a key."""
        return tuple(sorted(self.parameters.items()))

    @property
    def state_columns(self) -> dict[str, Variable]:
        """States by the name of their column, in the FMU's order."""
        return dict(_by_column([state for state, _ in self.dynamics], self.states))

    @property
    def input_columns(self) -> dict[str, Variable]:
        """Inputs that columns feed, by the name of the column."""
        return dict(_by_column(self._fed, self.inputs))

    @property
    def derivatives(self) -> str:
        """The method by which rates are differentiated, in words; declared derivatives are used once found right."""
        if not self.description.exchanged:
            return "central differences: a Co-Simulation is started anew at every point"
        if not self.description.directional:
            return "central differences: the FMU declares no directional derivatives"
        return {
            None: "the FMU's directional derivatives, if they agree with central differences: not looked at yet",
            True: "the FMU's directional derivatives, which agree with central differences",
            False: "central differences: the FMU's directional derivatives are not those of its rates",
        }[running(self.description).derivatives_right.get(self.key)]

    @property
    def rates(self) -> str:
        """The kind of rates, in words."""
        if self.description.exchanged:
            return "the FMU's own, by Model Exchange"
        if self.stepped:
            step = self.ports((), ()).step
            return f"differences of the states over steps of {step:g} s and of half of it, by Co-Simulation"
        return "variables of the FMU, which is started at each point, by Co-Simulation"

    def __str__(self) -> str:
        """Describe the FMU, its rates and their derivatives."""
        columns = ", ".join(f"{column} = {v.name}" for column, v in self.state_columns.items())
        return f"FMU {self.description.name}: {columns}\nrates: {self.rates}\nderivatives: {self.derivatives}"

    def record(self) -> dict[str, Any]:
        """Return the FMU as plain values for a file: its path, its GUID, and what was given with it."""
        given = {name: dict(getattr(self, name)) for name in MAPPINGS}
        return {"path": str(self.path), "guid": self.description.guid, **given, "step": self.step}

    @property
    def _fed(self) -> list[Variable]:
        variables = self.description.variables.values()
        return [v for v in variables if v.causality == "input" and v.name not in self.parameters]


def _by_column(variables: list[Variable], given: Mapping[str, str]) -> list[tuple[str, Variable]]:
    """Pair variables, in the FMU's order, with their columns: those that users named, or the variables' own names."""
    names = {variable: column for column, variable in given.items()}
    return [(names.get(each.name, each.column), each) for each in variables]


def _require_real(fmu: Description, name: str, known: Collection[str]) -> None:
    """Refuse a variable that is not among the known names, or is no single real number."""
    if name not in known:
        near = get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(list(known)[:20]) or 'none'}."
        raise InputError(f"The FMU {fmu.name} has no {name!r} that could be that; {hint}")
    if fmu.variables[name].kind != "Real" or not fmu.variables[name].scalar:
        raise InputError(f"{name!r} of the FMU {fmu.name} is of type {fmu.variables[name].kind}: only Real is used.")


def _require_once(fmu: Description, what: str, names: list[str]) -> None:
    """Refuse a name, of a "column" or a "variable", that stands twice in a list."""
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InputError(
            f"The FMU {fmu.name} has the {what} {twice[0]!r} twice: give each of its variables a column of its own, "
            "bg.FMU(..., states={'column': 'variable'}, inputs={...})."
        )


def fmu_from(record: Mapping[str, Any]) -> FMU:
    """Invert `FMU.record`."""
    path = record["path"]
    again = "give it again, bg.load(path, simulation=bg.FMU(...))"
    if not Path(path).is_file():
        raise InputError(f'The model\'s simulation was the FMU "{path}", which is not there: {again}.')
    fmu = FMU(path, **_given(record))
    if fmu.description.guid != record["guid"]:
        raise InputError(
            f'The model\'s simulation was the FMU "{path}" with the GUID {record["guid"]}, and the one that is there '
            f"now has {fmu.description.guid}: {again}."
        )
    return fmu


def with_record(record: Mapping[str, Any], fmu: FMU) -> FMU:
    """Give an FMU in the place of a saved one that one's parameters and names, where it has none."""
    return fmu if any(getattr(fmu, name) for name in (*MAPPINGS, "step")) else FMU(fmu.path, **_given(record))


def _given(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return what was given with a file; older records lack the fields of Co-Simulation."""
    return {name: record[name] for name in (*MAPPINGS, "step") if name in record}


def _read_again(path: str, given: Mapping[str, Any], content: str) -> FMU:
    """Read an FMU in another process."""
    fmu = FMU(path, **given)
    if fmu.description.content != content:
        raise InputError(f'The FMU "{path}" has been changed since it was read: give it again.')
    return fmu
