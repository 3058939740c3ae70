"""Notation of units and formulas: one way, however a file, a user or a calculation spells them."""

import re
from fractions import Fraction

_TO_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_FROM_SUPERSCRIPT = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹⋅", "-0123456789.")
_SUPERSCRIPT_SIGNS = "⁻⁰¹²³⁴⁵⁶⁷⁸⁹⋅"
_TOKEN = re.compile(
    rf"\s*(?:(?P<over>/|\bper\b)|(?P<name>(?:(?![{_SUPERSCRIPT_SIGNS}])[^\W\d]|[°%])+|1(?![\d.]))"
    rf"|(?P<power>(?:\*\*|\^)\s*(?:-?[\d.]+|\(\s*-?[\d./]+\s*\))|[{_SUPERSCRIPT_SIGNS}]+)"
    r"|(?P<times>[*·⋅])|(?P<open>\()|(?P<close>\))|(?P<other>.))\s*",
    re.DOTALL,
)


def unit_text(unit: str | None) -> str:
    """Write a unit with powers as superscripts, and a product after at most one stroke.

    `m/s/s`, `m/s**2`, `m/s^2` and `m s⁻²` all become m/s²; `1/m²/s²` becomes 1/(m²·s²); `N*m` becomes N·m. The unit
    of a plain number, "", "1" or "dimensionless", is empty; text that is no product of powers stays as it is.
    """
    if not unit or unit.strip() in ("1", "dimensionless"):
        return ""
    try:
        factors = _factors(unit)
    except (ValueError, ZeroDivisionError):  # a power that is no number
        factors = None
    if factors is None:
        return unit.strip()
    above = [_power(name, power) for name, power in factors.items() if power > 0]
    below = [_power(name, -power) for name, power in factors.items() if power < 0]
    if not below:
        return "·".join(above)
    under = "·".join(below)
    return f"{'·'.join(above) or '1'}/{f'({under})' if len(below) > 1 else under}"


def formula(expression: str) -> str:
    """Write a formula or the name of a term in mathematical notation: y**3*ydot becomes y³·ydot."""
    whole = r"\*\*(?:(-?\d+)(?![\d.])|\((-?\d+)\))"
    raised = re.sub(whole, lambda match: (match[1] or match[2]).translate(_TO_SUPERSCRIPT), expression)
    return re.sub(r"\s*\*\s*", "·", raised.replace("**", "^")).replace("-", "−")


def _power(name: str, power: Fraction) -> str:
    if power == 1:
        return name
    return f"{name}{str(power).translate(_TO_SUPERSCRIPT)}" if power.denominator == 1 else f"{name}^{float(power):g}"


def _factors(unit: str) -> dict[str, Fraction] | None:
    """Return names and their powers, in the order of the text; None if it is no product of powers."""
    tokens = [(str(match.lastgroup), match[0].strip()) for match in _TOKEN.finditer(unit)]
    powers: dict[str, Fraction] = {}
    # Sign that each open bracket puts on the powers inside; the last one is the current bracket's.
    signs, sign, last, before = [1], 1, "", ""
    for kind, text in [*tokens, ("end", "")]:
        if before in ("times", "over", "open") and kind not in ("name", "open"):
            return None
        if text == "1" and before in ("name", "power", "close"):
            return None
        before = kind
        if kind == "name":
            last = text
            if text != "1":
                powers[text] = powers.get(text, Fraction(0)) + signs[-1] * sign
        elif kind == "power" and last not in ("", "1"):
            power = Fraction(text.translate(_FROM_SUPERSCRIPT).strip("*^() "))
            powers[last] += signs[-1] * sign * (power - 1)
            last = ""
        elif kind == "open":
            signs.append(signs[-1] * sign)
            sign, last = 1, ""
        elif kind == "close" and len(signs) > 1:
            signs.pop()
            last = ""
        elif kind in ("times", "over"):
            sign, last = (-1 if kind == "over" else 1), ""
        elif kind != "end":
            return None
    return {name: power for name, power in powers.items() if power} if len(signs) == 1 else None
