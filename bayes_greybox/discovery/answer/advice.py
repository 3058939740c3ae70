"""Advice where the data do not tell effects apart: the range beyond the data where their curves differ."""

from collections.abc import Sequence

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.data.writing import unit_text
from bayes_greybox.physics.terms import Term

ANOTHER_SENSOR = "show the sensor a motion that is known, or measure with another one beside it"
"""Advice where only a fault of the sensor does the same as an effect: no range of the data tells them apart."""

CURVE_POINTS, DIFFERING = 41, 4
"""Points at which curves are compared, and noise standard deviations by which they have to differ."""


def how_to_tell_apart(tied: Sequence[tuple[Term, float]], sigma: float, data: Trajectories) -> str:
    """Return the smallest range beyond the data where tied effects differ, in words."""
    if any(term.states for term, _ in tied):
        # No curve over the states tells effects with memory from those without.
        return (
            "To tell them apart, measure at other amplitudes and other frequencies: what remembers depends on how far "
            "and how fast the motion went before."
        )
    options = []
    for name in sorted({column for term, _ in tied for column in term.symbols} & set(data.columns)):
        low, top = float(np.min(data.column(name))), float(np.max(np.abs(data.column(name))))
        for reach in (1.25, 1.5, 2.0, 3.0, 5.0):
            at = {column: np.full(CURVE_POINTS, np.median(values)) for column, values in data.columns.items()}
            at[name] = np.linspace(-reach * top if low < 0 else low, reach * top, CURVE_POINTS)
            first, *others = [mean * np.asarray(term.evaluate(at)) for term, mean in tied]
            apart = max(float(np.max(np.abs(first - other))) for other in others)
            if np.isfinite(apart) and apart > DIFFERING * sigma:
                unit = f" {unit_text(data.unit(name))}" if unit_text(data.unit(name)) else ""
                shown = f"|{name}|" if low < 0 else name
                options.append((reach, f"measure up to {shown} = {reach * top:.3g}{unit} (the data reach {top:.3g})"))
                break
    if not options:
        return (
            "More data of the same kind, or less noise: within five times the data's range the effects hardly differ."
        )
    return f"To tell them apart, {min(options)[1]}: there they differ by more than four noise standard deviations."
