"""Examples of named numbers and of hidden states, in the names and units of a table."""

import re

from bayes_greybox.data.reading.units import registry

from .clock import time_unit
from .plan import DAMPER, MASS, SPRING, Plan, is_angle

TIME_CONSTANT = 10.0
"""Number of the example of first order, in units of the time."""

TEXT_OF_PARAMETERS = [
    "# [parameters]",
    "# Numbers of the formulas above by name, in units of the table. With sd one is learned by fit; without, it is",
    "# believed, and discover says if it is off, and what it should be.",
]


def parameters_text(plan: Plan) -> str:
    """Write examples of named numbers, as a comment: a section of numbers that no formula has is refused."""
    positions = {rate: position for position, rate in plan.known.items()}
    equation = next((name for name in plan.equations if name in positions), plan.equations[0])
    if equation in positions:
        formula, numbers = _of_motion(plan, positions[equation], equation)
    else:
        formula, numbers = _of_first_order(plan, equation)
    # Parentheses stand around products only.
    (name, value, unit), *others = [
        (name, value, re.sub(r"\(([^*/^()]+)\)", r"\1", unit)) for name, value, unit in numbers
    ]
    lines = [f'# {name} = {{ value = {value:.4g}, sd = {value / 10:.4g}, lower = 0.0, unit = "{unit}" }}']
    lines += [f'# {name} = {{ value = {value:.4g}, unit = "{unit}" }}' for name, value, unit in others]
    return "\n".join([*TEXT_OF_PARAMETERS, *lines, f'# With these the formula is {equation} = "{formula}".'])


def starts_text(plan: Plan) -> str:
    """Write an example of a hidden state, as a comment: a start of a state without a formula is refused."""
    if plan.sampled:
        return ""
    followed, hidden = plan.name(plan.guess.states)[0], plan.free("lagging")
    return "\n".join(
        [
            "# [starts]",
            "# A state that no sensor reads, with a formula of inputs, states and other hidden states in [simulation],",
            "# follows from where it starts: a number, or the column that has the value where a run starts.",
            f'# {hidden} = "{followed}"  # beside {hidden} = "({followed} - {hidden})/{TIME_CONSTANT:g}" above',
        ]
    )


def _of_first_order(plan: Plan, equation: str) -> tuple[str, list[tuple[str, float, str]]]:
    others, tau = [name for name in plan.variables if name != equation], plan.free("tau")
    unit = plan.unit(plan.guess.time) or time_unit(plan.guess.time or "") or "s"
    toward = f"({others[-1]} - {equation})" if others else f"-{equation}"
    return f"{toward}/{tau}", [(tau, TIME_CONSTANT, unit)]


def _of_motion(plan: Plan, position: str, rate: str) -> tuple[str, list[tuple[str, float, str]]]:
    """Write m a = F - k x - c v with its parameters."""
    columns = {name: column for column, name in plan.names.items()}
    length, time = plan.unit(columns[position]) or "m", plan.unit(plan.guess.time) or "s"
    turns = is_angle(length)
    driver = plan.guess.inputs[0] if plan.guess.inputs else None
    force = plan.unit(driver) or ("N*m" if turns else "N")
    m, k, c, b = (plan.free(name) for name in "mkcb")
    usual = {MASS: "kg*m^2", SPRING: "N*m/rad", DAMPER: "N*m*s/rad"} if turns else {}
    usual = usual or {MASS: "kg", SPRING: "N/m", DAMPER: "N*s/m"}
    units = [f"({force})*({time})^2/({length})", f"({force})/({length})", f"({force})*({time})/({length})"]
    given = [registry().Quantity(value, unit) for value, unit in usual.items()]
    # The mass of a table in SI units is in kg.
    shown = [own if _same(own, unit) else unit for own, unit in zip(usual.values(), units, strict=True)]
    if all(each.is_compatible_with(unit) for each, unit in zip(given, units, strict=True)):
        values = [float(each.to(unit).magnitude) for each, unit in zip(given, units, strict=True)]
        sum_ = f"{plan.names[driver]} - {k}*{position} - {c}*{rate}" if driver else f"-{k}*{position} - {c}*{rate}"
        return f"({sum_})/{m}", list(zip((m, k, c), values, shown, strict=True))
    # What drives it is no force.
    spring = float(registry().Quantity(SPRING / MASS, "1/s^2").to(f"1/({time})^2").magnitude)
    damper = float(registry().Quantity(DAMPER / MASS, "1/s").to(f"1/({time})").magnitude)
    driven = f"{b}*{plan.names[driver]} - " if driver else "-"
    numbers = [(b, 2.0, f"{length}/({time})^2/({force})"), (k, spring, f"1/({time})^2"), (c, damper, f"1/({time})")]
    return f"{driven}{k}*{position} - {c}*{rate}", numbers


def _same(one: str, other: str) -> bool:
    units = registry()
    return units.Quantity(1.0, one).is_compatible_with(other) and units.Quantity(1.0, one).to(other).magnitude == 1.0
