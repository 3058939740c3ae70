"""An equation of motion as an example, with its numbers in the units of a table."""

from bayes_greybox.data.reading.units import registry

MASS, SPRING, DAMPER = 2.0, 30.0, 0.8
"""Of the example, in kg, N/m and N s/m; of a rotation in kg m², N m/rad and N m s/rad."""


def is_length_or_angle(unit: str) -> bool:
    """Return True if a unit is that of a length, such as mm, or of an angle, such as deg."""
    parsed = registry().parse_units(unit)
    return parsed.is_compatible_with("m") or _is_angle(unit)


def is_electrical(unit: str) -> bool:
    """Return True if a unit is that of a voltage, a current, a charge or a flux."""
    return bool(unit) and any(registry().parse_units(unit).is_compatible_with(each) for each in ("V", "A", "C", "Wb"))


def equation_of_motion(position: str, rate: str, forces: tuple[str, str] | None, units: tuple[str, str]) -> str:
    """Write the rate of a rate, m a = F - k x - c v, and its parameters.

    Args:
        position: Name of the position.
        rate: Name of its rate.
        forces: Name of an input and its unit, "" if that is unknown; None without inputs.
        units: Units of the position and of the time; "" if they are unknown.

    Returns:
        A formula in quotation marks and words: '"F/2000 - 1.5e-05*x - 0.0004*v" (2 kg, 30 N/m, 0.8 N s/m in mm, ms)'.
    """
    length, time = units[0] or "m", units[1] or "s"
    turns = _is_angle(length)
    per_time = registry().Quantity(1.0, "1/s").to(f"1/({time})").magnitude
    parts = [f"- {SPRING / MASS * per_time**2:.4g}*{position}", f"- {DAMPER / MASS * per_time:.4g}*{rate}"]
    notes = [f"{MASS:g} kg m²", f"{SPRING:g} N m/rad", f"{DAMPER:g} N m s/rad"] if turns else []
    notes = notes or [f"{MASS:g} kg", f"{SPRING:g} N/m", f"{DAMPER:g} N s/m"]
    used = [length, time]
    if forces is not None:
        name, unit = forces
        force = registry().Quantity(1.0 / MASS, f"({unit or ('N*m' if turns else 'N')})/(kg{'*m^2' if turns else ''})")
        wanted = registry().parse_units(f"({length})/({time})^2")
        if force.is_compatible_with(wanted):
            gain = force.to(wanted).magnitude
            parts.insert(0, f"{gain:.4g}*{name}" if gain > 1 else f"{name}/{1 / gain:.4g}")
            used.append(unit or ("N m" if turns else "N"))
        else:
            parts.insert(0, f"2*{name}")
            notes.append("a gain")
    text = " ".join(parts).removeprefix("- ")
    text = text if forces is not None else f"-{text}"
    return f'"{text}" ({", ".join(notes)} in {", ".join(used)})'


def _is_angle(unit: str) -> bool:
    parsed = registry().parse_units(unit)
    return str(registry().get_base_units(parsed)[1]) == "radian" and parsed.dimensionless
