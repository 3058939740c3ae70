"""What the sections of a file say of one name: an input has no equation, and a rate that has a name has one."""

from collections.abc import Iterable, Mapping


def equation_of_input(inputs: Iterable[str], states: Iterable[str], sections: Mapping[str, Iterable[str]]) -> str:
    """What is wrong where a section has an equation of an input; "" where none has.

    Args:
        inputs: Of the data.
        states: Of the data.
        sections: Names that have an equation, by section.
    """
    outside = set(inputs) - set(states)
    for section, names in sections.items():
        name = next((name for name in names if name in outside), None)
        if name is not None:
            return (
                f"{section} still has a line for {name!r}, which [data] has among its inputs: what acts from outside "
                "has no equation; delete that line"
            )
    return ""


def rate_without_equation(simulation: Mapping[str, str], known: Iterable[str]) -> str:
    """What is wrong where a rate is only named, and nothing is said of it; "" where that is not so.

    Args:
        simulation: Formula by state.
        known: Names that the data or other sections have.
    """
    every = {*known, *simulation, "t", "pi"}
    for state, formula in simulation.items():
        if formula.isidentifier() and formula not in every:
            return (
                f"[simulation] says that the rate of {state!r} is {formula!r}, and not what the rate of {formula!r} "
                f'is: add a line {formula} = "..." with what your simulation says'
            )
    return ""
