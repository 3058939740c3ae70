"""Numbers, units and formulas as people read them."""

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.report.plots.ranking import percent_text, probability_text
from bayes_greybox.report.plots.style import number_text, unit_text

__all__ = [
    "PROBABILITIES",
    "estimate",
    "formula",
    "interval",
    "listed",
    "nats",
    "number",
    "pareto",
    "percent_text",
    "probability_column",
    "probability_text",
    "unit_text",
]

PROBABILITIES = {"inclusion": "P(included)", "outside_rope": "P(|θ| > ROPE)"}
"""What the probability of a term is called; continuous priors have no inclusion."""

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


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
    text = number_text(value, digits)
    mantissa, _, power = text.partition("e")
    return f"{mantissa}·10{str(int(power.replace('−', '-'))).translate(_SUPERSCRIPT)}" if power else text


def nats(value: float) -> str:
    """A log density, to a tenth of a nat."""
    return f"{value:.1f}".replace("-", "−") if math.isfinite(value) else number(value)


def pareto(k: float) -> str:
    """A Pareto k; a dash where no fold relies on importance sampling."""
    return f"{k:.2f}".replace("-", "−") if math.isfinite(k) else "–" if k < 0 else number(k)


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


def formula(expression: str) -> str:
    """A formula as people write it: y**3*ydot becomes y³·ydot."""
    raised = re.sub(r"\*\*(-?\d+)(?![\d.])", lambda found: found[1].translate(_SUPERSCRIPT), expression)
    return re.sub(r"\s*(?<!\*)\*(?!\*)\s*", "·", raised).replace("-", "−")
