"""The verdict of a study in one sentence."""

from collections.abc import Mapping

import pandas as pd

from bayes_greybox.data.trajectories import Trajectories

from .equation import EquationStudy


def sentence(
    findings: Mapping[str, EquationStudy], data: Trajectories, verdict: str, effects: pd.DataFrame, gap: pd.DataFrame
) -> str:
    """Say the verdict so that someone who never heard of evidence knows what to do.

    Args:
        findings: By equation.
        data: Training data.
        verdict: Of the whole study.
        effects: The study's table of effects.
        gap: The study's gap table.
    """
    closed = _closed(gap)
    if verdict == "no gap":
        return "Nothing is missing: simulation and measurements agree to within the noise."
    if verdict == "recalibrate":
        names = [n for n, found in findings.items() if found.finding.verdict == "recalibrate"]
        worst = []
        for n in names:
            table = findings[n].corrections(data)
            chosen = table[table["probability"] > 0.5]
            for row in chosen.reset_index().to_dict("records"):
                right = row["nominal"] + row["mean"]
                worst.append(f"{row['term']} in d({n})/dt should have {right:.4g}, not {row['nominal']:.4g}")
        listed = "; ".join(worst) or "which one the data cannot say"
        return (
            f"No effect is missing; coefficients of the simulation are off ({listed}), and setting them right {closed}."
        )
    said = []
    for row in effects.query("status == 'added'").to_dict("records"):
        tied = f", not to be told from {', '.join(row['tied_with'])}" if len(row["tied_with"]) else ""
        p = _rounded(row["probability"])
        said.append(f"{row['name'].lower()} in d({row['equation']})/dt (probability {p}{tied})")
    lacks = f"The simulation lacks {' and '.join(said)}"
    if verdict == "named":
        return f"{lacks}; adding {'it' if len(said) == 1 else 'them'} {closed}."
    if verdict == "partly named":
        return f"{lacks}, and something else that the catalogue does not have; adding what has a name {closed}."
    return "Something is missing that the catalogue does not have; the maps show its shape."


def _closed(gap: pd.DataFrame) -> str:
    """What became of the gap, on held-out data where the rates were measured there."""
    shares = gap.xs("unexplained share", level="metric")
    held_out = "test" in shares.index.get_level_values("data")
    where = "held-out data" if held_out else "the training data"
    before, after = shares.loc["test" if held_out else "train", ["before", "after"]].sum()
    if not before > 0:
        return f"leaves no gap on {where}"
    if after > before:
        return f"widens the gap on {where} by {100 * (after / before - 1):.0f} %"
    return f"closes {_percent(1 - after / before)} of the gap on {where}"


def _rounded(probability: float) -> str:
    """Never rounded to certainty."""
    return "above 0.99" if probability > 0.99 else f"{probability:.2f}"


def _percent(share: float) -> str:
    return "more than 99 %" if share > 0.99 else f"{100 * share:.0f} %"
