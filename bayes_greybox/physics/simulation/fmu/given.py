"""An FMU as users give it."""

import math
import numbers
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.fmu.description import MODEL_EXCHANGE, Description, Variable
from bayes_greybox.data.fmu.reading import read_fmu

from .running import running


@dataclass(frozen=True)
class FMU:
    """A simulation that is an FMU of FMI 2.0 for Model Exchange, run by FMPy (extra `fmu`).

    Its continuous states are states of the model, by the names that `states` gives them, else by their own with "_"
    for what no column may be called: "mass.s" is `mass_s`. A state that the data lack is hidden, as on rows of samples.

    Attributes:
        path: The file.
        parameters: Values of parameters, and of inputs that no column feeds, by the FMU's names.
        states: The FMU's state by the column's name, {"y": "mass.s"}.
        inputs: The FMU's input by the column's name.
        outputs: The FMU's variable by the name of a measured output.

    Raises:
        InputError: FMPy is not installed; no such file, or one that cannot be run here; a variable that there is not,
            or that is no real number; one column for two variables, or two for one.
    """

    path: str | os.PathLike[str]
    parameters: Mapping[str, float] = field(default_factory=dict)
    states: Mapping[str, str] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", str(Path(self.path).resolve()))
        for name in ("parameters", "states", "inputs", "outputs"):
            object.__setattr__(self, name, dict(getattr(self, name)))
        found = self.description
        states = [state.name for state, _ in found.states]
        if not states:
            raise InputError(f"The FMU {found.name} has no continuous state: there is no rate that it could give.")
        for name in (*self.parameters, *self.outputs.values()):
            _real(found, name, (*found.variables,))
        for name in self.inputs.values():
            _real(found, name, [v.name for v in found.variables.values() if v.causality == "input"])
        for name in self.states.values():
            _real(found, name, states)
        for name in self.parameters:
            if found.variables[name].causality not in ("parameter", "input"):
                raise InputError(f"{name!r} of the FMU {found.name} is no parameter and no input: it cannot be set.")
            value = self.parameters[name]
            if not isinstance(value, numbers.Real) or not math.isfinite(value):
                raise InputError(f"{name!r} of the FMU {found.name} is set to {value!r}: give a finite number.")
        # Any kind of number; a file holds plain ones.
        object.__setattr__(self, "parameters", {name: float(value) for name, value in self.parameters.items()})
        for variable in found.variables.values():
            if variable.causality == "input":
                _real(found, variable.name, (variable.name,))
        for name in self.inputs.values():
            if name in self.parameters:
                raise InputError(f"The input {name!r} of the FMU {found.name} is held and fed by a column: do one.")
        columns = [name for name, _ in (*self._of_states(), *self._of_inputs())]
        _require_once(found, "column", [*columns, *self.outputs])
        for given in (self.states, self.inputs):
            _require_once(found, "variable", list(given.values()))

    @property
    def description(self) -> Description:
        """What the file says of itself."""
        return read_fmu(self.path)

    @property
    def state_columns(self) -> dict[str, Variable]:
        """States by the name of their column, in the FMU's order."""
        return dict(self._of_states())

    @property
    def input_columns(self) -> dict[str, Variable]:
        """Inputs that columns feed, by the name of the column."""
        return dict(self._of_inputs())

    @property
    def derivatives(self) -> str:
        """By what the rates are differentiated, in words: what the FMU declares is used once it was found right."""
        if not self.description.interfaces[MODEL_EXCHANGE].directional:
            return "central differences: the FMU declares no directional derivatives"
        return {
            None: "the FMU's directional derivatives, if they agree with central differences: not looked at yet",
            True: "the FMU's directional derivatives, which agree with central differences",
            False: "central differences: the FMU's directional derivatives are not those of its rates",
        }[running(self.description).right(self.parameters)]

    def record(self) -> dict[str, Any]:
        """The FMU as plain values for a file: where it is, its GUID, and what was given with it."""
        given = {name: dict(getattr(self, name)) for name in ("parameters", "states", "inputs", "outputs")}
        return {"path": str(self.path), "guid": self.description.guid, **given}

    def _of_states(self) -> list[tuple[str, Variable]]:
        return _by_column([state for state, _ in self.description.states], self.states)

    def _of_inputs(self) -> list[tuple[str, Variable]]:
        known = self.description.variables.values()
        fed = [v for v in known if v.causality == "input" and v.name not in self.parameters]
        return _by_column(fed, self.inputs)


def fmu_from(record: Mapping[str, Any]) -> FMU:
    """The inverse of `FMU.record`.

    Raises:
        InputError: The file is not where it was, or is another one.
    """
    path = record["path"]
    again = "give it again, bg.load(path, simulation=bg.FMU(...))"
    if not Path(path).is_file():
        raise InputError(f'The model\'s simulation was the FMU "{path}", which is not there: {again}.')
    found = FMU(path, **{name: record[name] for name in ("parameters", "states", "inputs", "outputs")})
    if found.description.guid != record["guid"]:
        raise InputError(
            f'The model\'s simulation was the FMU "{path}" with the GUID {record["guid"]}, and the one that is there '
            f"now has {found.description.guid}: {again}."
        )
    return found


def given_again(record: Mapping[str, Any], fmu: FMU) -> FMU:
    """An FMU that is given in the place of a saved one, with that one's parameters and names where it has none.

    Args:
        record: Of `FMU.record`.
        fmu: What was given.
    """
    given = ("parameters", "states", "inputs", "outputs")
    return fmu if any(getattr(fmu, name) for name in given) else FMU(fmu.path, **{name: record[name] for name in given})


def _by_column(variables: list[Variable], given: Mapping[str, str]) -> list[tuple[str, Variable]]:
    names = {variable: column for column, variable in given.items()}
    return [(names.get(each.name, each.column), each) for each in variables]


def _require_once(found: Description, what: str, names: list[str]) -> None:
    """Refuse a name that stands for two."""
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InputError(
            f"The FMU {found.name} has the {what} {twice[0]!r} twice: give each of its variables a column of its own, "
            "bg.FMU(..., states={'column': 'variable'}, inputs={...})."
        )


def _real(found: Description, name: str, known: Any) -> None:
    """Refuse a variable that there is not, or that is no single real number."""
    if name not in known:
        near = get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(list(known)[:20]) or 'none'}."
        raise InputError(f"The FMU {found.name} has no {name!r} that could be that; {hint}")
    if found.variables[name].kind != "Real" or not found.variables[name].scalar:
        raise InputError(
            f"{name!r} of the FMU {found.name} is of type {found.variables[name].kind}: only Real is used."
        )
