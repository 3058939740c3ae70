"""Names of an FMU's variables as users give them, and checks of these."""

import math
import numbers
from collections.abc import Collection, Mapping
from difflib import get_close_matches
from typing import Any

from bayes_greybox.running.errors import InputError

from .description import Description, Variable


def by_column(variables: list[Variable], given: Mapping[str, str]) -> list[tuple[str, Variable]]:
    """Pair variables, in the FMU's order, with their columns: those that users named, or the variables' own names."""
    names = {variable: column for column, variable in given.items()}
    return [(names.get(each.name, each.column), each) for each in variables]


def without_states(fmu: Description) -> str:
    """Say that an FMU has, or declares, no state."""
    if fmu.exchanged:
        return f"The FMU {fmu.name} has no continuous state: there is no rate that it could give."
    return (
        f"The FMU {fmu.name} is for Co-Simulation and does not declare its states: name all of them, "
        "bg.FMU(..., states={'column': 'variable'}), or export it for Model Exchange."
    )


def require_real(fmu: Description, name: str, known: Collection[str]) -> None:
    """Refuse a variable that is not among the known names, or is no single real number.

    Raises:
        InputError: The variable is refused.
    """
    if name not in known:
        near = get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(list(known)[:20]) or 'none'}."
        raise InputError(f"The FMU {fmu.name} has no {name!r} that could be that; {hint}")
    if fmu.variables[name].kind != "Real" or not fmu.variables[name].scalar:
        raise InputError(f"{name!r} of the FMU {fmu.name} is of type {fmu.variables[name].kind}: only Real is used.")


def require_number(fmu: Description, name: str, value: Any) -> None:
    """Refuse a value of a parameter that is no finite number.

    Raises:
        InputError: The value is refused.
    """
    if not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise InputError(f"{name!r} of the FMU {fmu.name} is set to {value!r}: give a finite number.")


def require_once(fmu: Description, what: str, names: list[str]) -> None:
    """Refuse a name, of a "column" or a "variable", that stands twice in a list.

    Raises:
        InputError: A name is refused.
    """
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InputError(
            f"The FMU {fmu.name} has the {what} {twice[0]!r} twice: give each of its variables a column of its own, "
            "bg.FMU(..., states={'column': 'variable'}, inputs={...})."
        )
