"""What the gap after holds against an answer: free runs that get worse, held-out samples that are not explained."""

import numpy as np
import pandas as pd

from bayes_greybox.discovery.decision.criteria import Criteria

GREW = Criteria().worse
"""A free run is worse, or fails sooner, only beyond this share of what it was before."""

NOTHING = 1e-4
"""Error of a free run, over the standard deviation of the measurement, that is none: the integrator's."""

MISFIT = "misfit of samples"
"""Metric: what is left of samples over what their noise and the coefficients leave open; 1 where all is explained."""

NAMED = "unexplained share, names alone"
"""Metric: the unexplained share after by what has a name alone, where the model after holds f beside it."""

LEFT = Criteria().misfit
"""Misfit of held-out samples, over that of training samples, from which on the model after does not hold for them."""


def worsened(gap: pd.DataFrame) -> tuple[tuple[str, str, str], ...]:
    """What the amended model does worse in free run than the model before: what vetoes that a gap was closed.

    A state's free-run NRMSE has grown where the error of the mean path exceeds the error before by more than `GREW` of
    it: a model that can only be said to be no worse has closed nothing. The time to failure has fallen where the median
    draw fails sooner by more than that, and so does the upper end of the interval, or the model before never failed.

    Args:
        gap: Gap table; its free runs on held-out data are looked at, on training data where there are none.

    Returns:
        Rows of the table, (data, metric, variable); a time to failure has the variable "all".
    """
    metrics = ("free-run NRMSE", "time to failure")
    records = zip(gap.index, gap.to_dict("records"), strict=True)
    # A state at rest has no error to speak of.
    rows = [
        (key, row) for key, row in records
        if key[1] in metrics and (key[1] == "time to failure" or not np.isnan(row["before"]))
    ]  # fmt: skip
    held_out = [(key, row) for key, row in rows if key[0] == "test"]
    found = []
    for key, row in held_out or rows:
        if key[1] == "free-run NRMSE":
            worse = row["after"] > row["before"] + max(GREW * row["before"], NOTHING)
        else:
            # Never is later than any time.
            before, after, upper = (
                np.inf if np.isnan(row[name]) else row[name] for name in ("before", "after", "upper")
            )
            worse = after < (1 - GREW) * before and (upper < before or not np.isfinite(before))
        if worse:
            found.append((str(key[0]), str(key[1]), str(key[2])))
    return tuple(found)


def left_over(gap: pd.DataFrame) -> dict[str, float]:
    """Where the model after explains the training samples and not the held-out ones: misfit there, by equation.

    A model that is right explains both; one that bends to the training data, or that stands for something else there,
    does not.

    Args:
        gap: Gap table; without held-out data, or with rates, there is nothing to tell.
    """
    train, test = misfits(gap, "train"), misfits(gap, "test")
    return {name: left for name, left in test.items() if left > LEFT * max(1.0, train.get(name, 1.0))}


def misfits(gap: pd.DataFrame, part: str) -> dict[str, float]:
    """Misfit of the samples after, by equation; none of rates.

    Args:
        gap: Gap table.
        part: "train" or "test".
    """
    records = zip(gap.index, gap.to_dict("records"), strict=True)
    return {str(key[2]): float(row["after"]) for key, row in records if key[:2] == (part, MISFIT)}
