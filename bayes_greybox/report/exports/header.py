"""Header of an exported program: its origin, its uncertainty, and what is not in it."""

import textwrap
from importlib.metadata import version

from bayes_greybox.data.writing import unit_text
from bayes_greybox.report.words.formatting import estimate, interval, probability_text

from .model import ExportedModel, Factor, Quantity

COMMENT_WIDTH = 100
"""Characters of a line of comments."""


def header(model: ExportedModel, names: dict[str, str], slots: tuple[str, str], in_seconds: bool = False) -> list[str]:
    """Return the lines of the header; without a date, so that the same model gives the same text.

    Args:
        model: The model.
        names: Identifiers by the names of the data.
        slots: Patterns by which states and inputs are indexed, such as "x[{}]".
        in_seconds: If true, time is in seconds there, whatever it was in the data.
    """
    what = "amended by a study" if model.origin == "study" else "fitted to data"
    lines = [f"A model {what}; written by bayes_greybox {version('bayes-greybox')}."]
    lines += [text for text in (model.notes.verdict, model.rule, *model.notes.remarks) if text]
    lines += ["Coefficients are posterior means, with standard deviation and 90 % interval."]
    lines += [
        f"Not in it, as it has no formula: f of {name}, {text}." for name, text in model.notes.discrepancy.items()
    ]
    unit = unit_text(model.time)
    if in_seconds and model.per_second != 1.0:
        lines.append(
            f"Time is in s here, and rates are per s: what the data, with their time in {unit}, say is multiplied by "
            f"{model.per_second:.15g}. Coefficients have the units of the data."
        )
    elif unit:
        lines.append(f"Time is in {unit}: rates are per {unit}.")
    for slot, quantities in zip((*slots, "output"), (model.states, model.inputs, model.outputs), strict=True):
        for k, each in enumerate(quantities):
            start = f", {_start(each)} where the data start" if slot == slots[0] else ""
            renamed = f' (called "{each.name}" in the data)' if names[each.name] != each.name else ""
            unit = f" [{unit_text(each.unit)}]" if unit_text(each.unit) else ""
            lines.append(f"{slot.format(k)}  {names[each.name]}{renamed}{unit}: {each.about}{start}")
    for name, inner in model.inner:
        text = estimate(inner.value.mean, inner.value.sd, inner.unit)
        lines.append(f"Within {inner.effect} of {name}: {inner.name} = {text}, a number in the formula.")
    for a, b, value in model.correlations:
        lines.append(f"Posterior correlation of {a} and {b}: {value:.2f}")
    return lines


def _start(state: Quantity) -> str:
    if state.start_sd is None:
        return f"{state.start:.6g}"
    return estimate(state.start, state.start_sd)


def comment(text: str, mark: str, end: str = "") -> list[str]:
    """Return text as lines of a comment between `mark` and `end`, none of them longer than `COMMENT_WIDTH`."""
    lines = textwrap.wrap(text, COMMENT_WIDTH - len(mark) - len(end), break_long_words=False, break_on_hyphens=False)
    return [f"{mark}{line}{end}" for line in lines or [""]]


def uncertainty(factor: Factor) -> str:
    """Return the term of a coefficient, its uncertainty and its probability, as a comment."""
    value = factor.value
    parts = [f"{factor.formula} in {factor.equation}"]
    if value.sd > 0:
        parts.append(f"{estimate(value.mean, value.sd, factor.unit)}, 90 % {interval(value.lower, value.upper)}")
    elif unit_text(factor.unit):
        parts.append(unit_text(factor.unit))
    if factor.correction and (value.lower < 0.0 < value.upper or value.sd > abs(value.mean)):
        # That it is there is likely, and says nothing where its sign is not known.
        parts.append("not told from zero")
    elif factor.probability is not None:
        parts.append(f"P {probability_text(factor.probability)}")
    return "; ".join([*parts, *([factor.about] if factor.about else [])])
