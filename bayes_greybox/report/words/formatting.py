"""Numbers, probabilities, shares, units and formulas in one way for every page, figure and terminal.

Units and formulas are written by `data.writing`, which the sentences of the rooms before this one use too.
"""

import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from bayes_greybox.data.writing import formula as formula
from bayes_greybox.data.writing import unit_text as unit_text

PROBABILITIES = {"inclusion": "P(included)", "outside_rope": "P(|θ| > ROPE)"}
"""What the probability of a term is called; continuous priors have no inclusion."""


_LEAST_SHARE = 1e-4
"""Shares below it are not told from each other: that none is left of anything is not known so well."""

_WITHOUT_POWER = 1e-3, 1e5
"""Numbers below the first and from the second on are written with a power of ten."""


def probability_text(value: float | np.floating) -> str:
    """Return a probability to three decimals, never rounded to certainty."""
    if not np.isfinite(value):
        return "–"
    if value < 1e-3:
        return "<\u00a00.001"
    return ">\u00a00.999" if value > 1 - 1e-3 else f"{value:.3f}"


def percent_text(share: float | np.floating, digits: int | None = None) -> str:
    """Return a share in percent, never rounded to all or nothing, with spaces that do not break."""
    if not np.isfinite(share):
        return "–"
    percent = 100 * float(share)
    if abs(percent) >= _WITHOUT_POWER[1]:
        # Of 2320176 % nobody counts the digits.
        return f"{number(percent)}\u00a0%"
    if digits is None:
        if 0 < abs(percent) < 100 * _LEAST_SHARE:
            return "<\u00a00.01\u00a0%" if percent > 0 else "0\u00a0%"
        # All but what floating point loses is all.
        if 99.95 <= percent < 100 - 1e-9:
            return ">\u00a099.9\u00a0%"
        digits = 0 if abs(percent) >= 99.95 or percent == 0 else 1 if abs(percent) >= 1 else 2
    return f"{percent:.{digits}f}\u00a0%".replace("-", "−")


def level_text(level: float | np.floating) -> str:
    """Return the probability of an interval as intervals are called: 90 %."""
    return percent_text(level, 0)


def share_text(share: float | np.floating) -> str:
    """Return a share in percent; one too small to show is less than 0.01 %, and not nothing."""
    return "<\u00a00.01\u00a0%" if abs(share) < _LEAST_SHARE else percent_text(share)


def known_share(share: float) -> str:
    """Return a share in percent; a dash where it is not known."""
    return "–" if math.isnan(share) else share_text(share)


def share_interval(lower: float | np.floating, upper: float | np.floating) -> str:
    """Return the interval of a share, `1.2 to 3.4 %`; one text where both ends read alike."""
    ends = [share_text(lower), share_text(upper)]
    if ends[0] == ends[1]:
        return ends[0]
    # Nothing but an end below what shows is the end of an interval at nothing.
    low = "0" if abs(lower) < _LEAST_SHARE else ends[0].removesuffix("\u00a0%")
    return f"{low} to {ends[1]}"


def number(value: Any, digits: int = 3) -> str:
    """Return a number to some significant digits, whole numbers with all; a dash for none; other values as text."""
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
    rounded = float(f"{float(value):.{digits}g}")
    if _WITHOUT_POWER[0] <= abs(rounded) < _WITHOUT_POWER[1]:
        whole = math.floor(math.log10(abs(rounded))) + 1
        # Digits before the point are all written.
        return (f"{float(value):.0f}" if whole > digits else f"{rounded:.{digits}g}").replace("-", "−")
    power = math.floor(math.log10(abs(rounded)))
    return f"{float(f'{rounded / 10.0**power:.{digits}g}'):.{digits}g}{_times(power)}".replace("-", "−")


def numbers_in(text: str) -> str:
    """Return text such as "y < -0.43 m" with its numbers written as pages write them."""
    return re.sub(r"(?<![\w.-])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?!\w)", lambda match: number(float(match[0]), 4), text)


def unbroken(text: str) -> str:
    """Return text such as "t = 0 to 2.5 s" in which lines do not end between a number and its unit."""
    return re.sub(r"(?<=\d) (?=(?!to\b|and\b|or\b)[^\W\d_])", "\u00a0", text)


def quantity(value: Any, unit: str | None, digits: int = 3) -> str:
    """Return a number with its unit."""
    return f"{number(value, digits)} {unit_text(unit)}".rstrip()


def count_text(value: float) -> str:
    """Return a number of things, such as an effective sample size; a dash where it is not known."""
    return f"{value:.0f}" if math.isfinite(value) else "–"


def p_text(p: float) -> str:
    """Return a p-value: p = 0.337, p < 0.001."""
    text = probability_text(p)
    return f"p\u00a0{text}" if text[0] in "<>" else f"p\u00a0= {number(float(p), 2)}"


def nats(value: float, digits: int = 1) -> str:
    """Return a log density in nats, to fixed decimals: columns of them stand point under point."""
    return f"{value:.{digits}f}".replace("-", "−") if math.isfinite(value) else number(value)


def pareto(k: float) -> str:
    """Return a Pareto k; a dash where no fold relies on importance sampling."""
    return f"{k:.2f}".replace("-", "−") if math.isfinite(k) else "–" if k < 0 else number(k)


def estimate(mean: float | np.floating, sd: float | np.floating, unit: str | None = "") -> str:
    """Return `mean ± sd unit`, to two significant digits of the sd, with one power of ten for both if needed."""
    mean, sd = float(mean), float(sd)
    tail = f" {unit_text(unit)}" if unit_text(unit) else ""
    if not (math.isfinite(mean) and math.isfinite(sd)):
        return number(mean) + tail
    size = max(abs(mean), sd)
    if sd <= 0 or sd < 1e-7 * size:
        digits = 4 if sd <= 0 else 10
        return f"{number(mean, digits)} ± {number(sd, 2)}{tail}"
    power = _power(size)
    sd, mean = sd / 10.0**power, mean / 10.0**power
    decimals = max(0, 1 - math.floor(math.log10(float(f"{sd:.2g}"))))
    # A mean that rounds to zero carries no sign.
    text = re.sub(r"^-(?=[0.]+ )", "", f"{mean:.{decimals}f} ± {sd:.{decimals}f}").replace("-", "−")
    return (f"({text}){_times(power)}" if power else text) + tail


def _power(size: float) -> int:
    """Return the power of ten that numbers of this size are written with; 0 for none."""
    return 0 if size == 0 or _WITHOUT_POWER[0] <= size < _WITHOUT_POWER[1] else math.floor(math.log10(size))


def _times(power: int) -> str:
    return "·10" + str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


class Concise(NamedTuple):
    """Size and standard deviation of a number in one: digits 1.23(4) times a power of ten, 0 for none."""

    digits: str
    power: int

    def __str__(self) -> str:
        return f"{self.digits}{_times(self.power)}" if self.power else self.digits


def concise(mean: float, sd: float) -> tuple[bool, Concise]:
    """Return whether a coefficient is negative, and its size with its standard deviation: −1.001(2) is −1.001 ± 0.002.

    The standard deviation is in units of the last digit, with one digit, two where the first is 1, as rounding would
    change that too much. Nothing is put in brackets where it is zero or not known.
    """
    size = abs(mean)
    if not math.isfinite(mean):
        return False, Concise("–", 0)
    if not (math.isfinite(sd) and sd > 0):
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
    """Return whether a known number is negative, and its size with all its digits."""
    mantissa, _, power = repr(abs(float(value))).partition("e")
    return value < 0, Concise(mantissa.removesuffix(".0"), int(power or 0))


def interval(lower: float, upper: float) -> str:
    """Return `lower to upper`, with digits that tell them apart and one power of ten for both if needed."""
    if not (math.isfinite(lower) and math.isfinite(upper)):
        return "–"
    width, size = upper - lower, max(abs(lower), abs(upper))
    digits = 3 if width <= 0 else min(8, max(3, math.ceil(math.log10(size / width)) + 2))
    power = _power(size)
    # What does not show beside the other end is nothing.
    decimals = digits - 1 - (math.floor(math.log10(size)) - power if size else 0)
    ends = (lower / 10.0**power, upper / 10.0**power)
    # The same decimals for both, without zeros that neither needs; nothing is a plain zero.
    while decimals > 0 and all(round(end, decimals - 1) == round(end, decimals) for end in ends):
        decimals -= 1
    places = max(decimals, 0)
    low, high = ("0" if round(end, places) == 0 else f"{end:.{places}f}".replace("-", "−") for end in ends)
    if low == high:
        return number(lower, digits)
    return f"({low} to {high}){_times(power)}" if power else f"{low} to {high}"


def probability_column(inclusion: pd.DataFrame) -> str:
    """Return the column of an inclusion table that holds the probability of each term."""
    return next((name for name in PROBABILITIES if name in inclusion), "outside_rope")


def counted(count: int, what: str) -> str:
    """Return a number of things: 1 asset, 2 assets."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def shorter(name: str, most: int) -> str:
    """Return a name with at most so many letters."""
    return name if len(name) <= most else f"{name[: most - 1]}…"


def listed(words: Sequence[str]) -> str:
    """Return words as a sentence lists them: a, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
