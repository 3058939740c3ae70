"""The verdict of a study in one sentence."""

import pandas as pd

from bayes_greybox.discovery.study import StudyResult

from .formatting import number, percent_text, probability_text
from .study_words import LIKELY, MOST_CLOSED


def sentence(study: StudyResult) -> str:
    """Say the verdict so that someone who never heard of evidence knows what to do.

    Args:
        study: The study.
    """
    closed = closed_in_words(study.gap)
    if study.verdict == "no gap":
        return "Nothing is missing: simulation and measurements agree to within the noise."
    if study.verdict == "recalibrate":
        off = study.corrections[study.corrections["probability"] > LIKELY]
        right = "; ".join(
            f"{row['term']} in d({row['equation']})/dt should have {number(row['nominal'] + row['mean'], 4)}, not "
            f"{number(row['nominal'], 4)}"
            for row in off.reset_index().to_dict("records")
        )
        return (
            f"No effect is missing; coefficients of the simulation are off "
            f"({right or 'which one the data cannot say'}), and setting them right {closed}."
        )
    said = []
    for row in study.effects.query("status == 'added'").to_dict("records"):
        tied = f", not to be told from {', '.join(row['tied_with'])}" if len(row["tied_with"]) else ""
        p = probability_text(row["probability"])
        said.append(f"{row['name'].lower()} in d({row['equation']})/dt (probability {p}{tied})")
    lacks = f"The simulation lacks {' and '.join(said)}"
    if study.verdict == "named":
        return f"{lacks}; adding {'it' if len(said) == 1 else 'them'} {closed}."
    if study.verdict == "partly named":
        return f"{lacks}, and something else that the catalogue does not have; adding what has a name {closed}."
    return "Something is missing that the catalogue does not have; the maps show its shape."


def closed_in_words(gap: pd.DataFrame) -> str:
    """What became of the gap, on held-out data where the rates were measured there.

    Args:
        gap: The gap before and after, as a study has it.
    """
    shares = gap.xs("unexplained share", level="metric")
    held_out = "test" in shares.index.get_level_values("data")
    where = "held-out data" if held_out else "the training data"
    before, after = shares.loc["test" if held_out else "train", ["before", "after"]].sum()
    if not before > 0:
        return f"leaves no gap on {where}"
    if after > before:
        return f"widens the gap on {where} by {percent_text(after / before - 1)}"
    return f"closes {percent_text(min(1 - after / before, MOST_CLOSED))} of the gap on {where}"
