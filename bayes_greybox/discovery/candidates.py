"""Lists beside an answer, for a headline: its rivals, the law behind them, and the errors of sensors."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from .answer.instrument import IN_MODEL, LISTED, NOISY
from .study import StudyResult
from .summary import answer, rows_of
from .ties import sorted_by_probability


def rivals(study: StudyResult, equation: str) -> list[tuple[str, float]]:
    """Return the likeliest explanations of an equation other than its answer that are listed, with probabilities."""
    table: Any = rows_of(study.hypotheses, equation)
    likely, own = sorted_by_probability(table[table["probability"] >= LISTED]), answer(study, equation)
    found = zip(map(str, likely.index), map(float, likely["probability"]), strict=True)
    # A headline has room for so many.
    return [(name, p) for name, p in found if name != own][:3]


def law_behind(
    study: StudyResult, equations: Sequence[str], quantities: Sequence[str | None]
) -> tuple[str, float] | None:
    """Return columns and probability of the law that all of some effects are, if they are one and it is sure."""
    if len(equations) != 1 or len(set(quantities)) != 1 or not len(study.quantities):
        return None
    known = rows_of(study.quantities, equations[0])["probability"].to_dict()
    p = float(known.get(quantities[0], 0.0))
    return (str(quantities[0]), p) if p >= study.criteria.named else None


def fault_probability(study: StudyResult, name: str) -> float:
    """Return the probability of a sensor error by its name, "offset of y"; NaN where it is not listed."""
    for row in study.instrument.to_dict("records"):
        if name == f"{row.get('suspect')} of {row.get('channel')}":
            return float(row["probability"])
    return float("nan")


def found_of_sensors(study: StudyResult) -> pd.DataFrame:
    """Return the sensor errors that belong to the answer, without noise that is only the rounding of the file."""
    table: Any = study.instrument
    if not len(table):
        return table
    rounded = [
        row.get("suspect") == NOISY and is_rounding(study, row["channel"], row["mean"])
        for row in table.to_dict("records")
    ]
    return table[(table["status"] == IN_MODEL) & ~np.array(rounded)]


def is_rounding(study: StudyResult, channel: str, sd: float) -> bool:
    """Return whether noise of a channel is no larger than half the last digit of its samples, as rounding makes it."""
    samples = study.train.samples or study.train
    if channel not in samples.states:
        return False
    steps = np.diff(np.unique(samples.column(channel)))
    return bool(len(steps) and sd <= 0.5 * steps.min())
