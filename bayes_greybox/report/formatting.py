"""How numbers, probabilities, shares, units and formulas are printed: one way for every page, figure and terminal."""

import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

PROBABILITIES = {"inclusion": "P(included)", "outside_rope": "P(|θ| > ROPE)"}
"""What the probability of a term is called; continuous priors have no inclusion."""

_LEAST = 1e-3
"""Probabilities nearer than this to 0 or 1 are not told from each other, and never rounded to certainty."""

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def probability_text(value: float | np.floating) -> str:
    """A probability to three decimals, never rounded to certainty."""
    if not np.isfinite(value):
        return "–"
    if value < _LEAST:
        return "<\u00a00.001"
    return ">\u00a00.999" if value > 1 - _LEAST else f"{value:.3f}"


def percent_text(share: float | np.floating, digits: int | None = None) -> str:
    """A share in percent, never rounded to all or nothing, in one piece: its spaces do not break.

    Args:
        share: The share, 1 being all.
        digits: Decimals; a sensible number by default.
    """
    if not np.isfinite(share):
        return "–"
    percent = 100 * float(share)
    if digits is None:
        if 0 < abs(percent) < 0.01:
            return "<\u00a00.01\u00a0%" if percent > 0 else "0\u00a0%"
        # All but what floating point loses is all.
        if 99.95 <= percent < 100 - 1e-9:
            return ">\u00a099.9\u00a0%"
        digits = 0 if abs(percent) >= 99.95 or percent == 0 else 1 if abs(percent) >= 1 else 2
    return f"{percent:.{digits}f}\u00a0%".replace("-", "−")


def level_text(level: float | np.floating) -> str:
    """The probability that an interval holds, as intervals are called: 90 %."""
    return percent_text(level, 0)


def nmse_text(value: float | np.floating) -> str:
    """A mean square error over the variance of the measurements: the share that was not predicted."""
    return percent_text(value)


def number(value: Any, digits: int = 3) -> str:
    """A number to some significant digits, whole numbers with all; a dash for none; other values as they are."""
    if value is None:
        return "–"
    if isinstance(value, bool | str) or not hasattr(value, "__float__"):
        return str(value)
    if isinstance(value, int | np.integer):
        return str(value).replace("-", "−")
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if float(value) == int(value) and abs(value) < 1e6:
        return f"{int(value)}".replace("-", "−")
    text = f"{float(value):.{digits}g}".replace("-", "−")
    mantissa, _, power = text.partition("e")
    return f"{mantissa}·10{str(int(power.replace('−', '-'))).translate(_SUPERSCRIPT)}" if power else text


def nats(value: float) -> str:
    """A log density, to a tenth of a nat."""
    return f"{value:.1f}".replace("-", "−") if math.isfinite(value) else number(value)


def pareto(k: float) -> str:
    """A Pareto k; a dash where no fold relies on importance sampling."""
    return f"{k:.2f}".replace("-", "−") if math.isfinite(k) else "–" if k < 0 else number(k)


def weight_text(weight: float) -> str:
    """The weight of a model among others."""
    return f"{weight:.2f}"


def estimate(mean: float, sd: float, unit: str = "") -> str:
    """`mean ± sd unit`, to two significant digits of the sd."""
    tail = f" {unit_text(unit)}" if unit_text(unit) else ""
    if not (math.isfinite(mean) and math.isfinite(sd)):
        return number(mean) + tail
    size = max(abs(mean), sd)
    if sd <= 0 or not 1e-4 < size < 1e5 or sd < 1e-6 * size:
        digits = 4 if sd <= 0 else min(8, max(2, math.ceil(math.log10(size / sd)) + 2))
        return f"{number(mean, digits)} ± {number(sd, 2)}{tail}"
    decimals = max(0, 1 - math.floor(math.log10(sd)))
    return f"{mean:.{decimals}f} ± {sd:.{decimals}f}".replace("-", "−") + tail


class Concise(NamedTuple):
    """Size and standard deviation of a number in one: digits 1.23(4) times a power of ten, 0 for none."""

    digits: str
    power: int

    def __str__(self) -> str:
        return f"{self.digits}·10{str(self.power).translate(_SUPERSCRIPT)}" if self.power else self.digits


def concise(mean: float, sd: float) -> tuple[bool, Concise]:
    """A coefficient with its standard deviation in units of the last digit: −1.001(2) is −1.001 ± 0.002.

    The standard deviation has one digit, two where the first is 1, as rounding would change that too much.

    Args:
        mean: The number.
        sd: Its standard deviation; nothing is put in brackets where it is zero or not known.

    Returns:
        Whether it is negative, and its size.
    """
    size = abs(mean)
    if not (math.isfinite(mean) and math.isfinite(sd) and sd > 0):
        if not math.isfinite(mean):
            return False, Concise("–", 0)
        mantissa, _, power = f"{size:.4g}".partition("e")
        return mean < 0, Concise(mantissa, int(power or 0))
    last = math.floor(math.log10(sd))
    if round(sd / 10.0 ** (last - 1)) < 20:
        last -= 1
    if size > 0:
        # Nobody reads more than nine digits; the standard deviation is then at most the last of them.
        last = max(last, math.floor(math.log10(size)) - 8)
    whole, off = round(size / 10.0**last), max(1, round(sd / 10.0**last))
    top = last + len(str(max(whole, off))) - 1
    # Zeros that are no digits are not written: neither before nor after the point.
    power = top if last > 0 or not -3 <= top < 5 else 0
    decimals = power - last
    text = str(whole).rjust(decimals + 1, "0")
    digits = f"{text[:-decimals]}.{text[-decimals:]}" if decimals else text
    return mean < 0 and whole > 0, Concise(f"{digits}({off})", power)


def exact(value: float) -> tuple[bool, Concise]:
    """A number that is known, with all digits that it has: whether it is negative, and its size."""
    mantissa, _, power = repr(abs(float(value))).partition("e")
    return value < 0, Concise(mantissa.removesuffix(".0"), int(power or 0))


def exact_text(value: float, unit: str = "") -> str:
    """A number that is known, as a table has it: `−40 1/m²/s²`."""
    negative, size = exact(value)
    return f"{'−' if negative else ''}{size}{f' {unit_text(unit)}' if unit_text(unit) else ''}"


def figure_estimate(mean: float | np.floating, sd: float | np.floating, unit: str = "") -> str:
    """`mean ± sd [unit]` for a figure: two significant digits of the sd, one common power of ten where needed."""
    mean, sd, shown = float(mean), float(sd), unit_text(unit)
    tail = f" [{shown}]" if shown else ""
    size = max(abs(mean), sd)
    if sd == 0.0 or not np.isfinite(size):
        return number(mean) + tail
    power = int(np.floor(np.log10(size)))
    power = power if power >= 5 or power <= -4 else 0
    decimals = max(0, 1 - int(np.floor(np.log10(sd / 10.0**power))))
    if decimals <= 6:
        body = f"{mean / 10.0**power:.{decimals}f} ± {sd / 10.0**power:.{decimals}f}"
    else:
        body = f"{mean / 10.0**power:.6f} ± {sd / 10.0**power:.0e}"
    # A mean that rounds to zero carries no sign.
    body = re.sub(r"^-(?=[0.]+ )", "", body).replace("-", "−")
    return (f"({body})$\\times 10^{{{power}}}$" if power else body) + tail


def interval(lower: float, upper: float) -> str:
    """`lower to upper`, with digits enough to tell them apart."""
    if not (math.isfinite(lower) and math.isfinite(upper)):
        return "–"
    width, size = upper - lower, max(abs(lower), abs(upper))
    digits = 3 if width <= 0 else min(8, max(3, math.ceil(math.log10(size / width)) + 2))
    return f"{number(lower, digits)} to {number(upper, digits)}"


def probability_column(inclusion: pd.DataFrame) -> str:
    """The column of an inclusion table that says how probable each term is."""
    return next((name for name in PROBABILITIES if name in inclusion), "outside_rope")


def listed(words: Sequence[str]) -> str:
    """Words as a sentence lists them: a, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def unit_text(unit: str | None) -> str:
    """A unit as people write it: `m/s**2` becomes m/s², `N*m` becomes N·m, nothing stays empty."""
    if not unit or unit == "dimensionless":
        return ""
    raised = re.sub(r"(?:\*\*|\^)(-?\d+)(?![\d.])", lambda found: found[1].translate(_SUPERSCRIPT), unit)
    return re.sub(r"(?<!\*)\s*\*\s*(?!\*)", "·", raised)


def formula(expression: str) -> str:
    """A formula as people write it: y**3*ydot becomes y³·ydot."""
    raised = re.sub(r"\*\*(-?\d+)(?![\d.])", lambda found: found[1].translate(_SUPERSCRIPT), expression)
    return re.sub(r"\s*(?<!\*)\*(?!\*)\s*", "·", raised).replace("-", "−")
