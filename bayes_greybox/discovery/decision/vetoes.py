"""The verdict of a study over all its equations: held-out samples and free runs may veto that something is *named*."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from bayes_greybox.data.columns import derivative_label

from . import reasons as codes
from .criteria import CRITERIA, Criteria
from .decide import VERDICTS, Verdict
from .probabilities import RECALIBRATE
from .reasons import Reason

FREE_RUN, FAILURE = "free-run NRMSE", "time to failure"
"""Metrics of free runs: error of a state, and time until any run fails."""

MISFIT = "misfit of samples"
"""Metric: residuals of samples, over the spread that noise and coefficients allow; 1 where all is explained."""

NAMES_ALONE = "unexplained share, names alone"
"""Metric: share still unexplained by the named effects alone, if the extended model holds f beside them."""


def verdict_of(
    verdicts: Mapping[str, Verdict],
    gap: pd.DataFrame,
    lost: Sequence[str] = (),
    labels: Mapping[str, str] | None = None,
    criteria: Criteria = CRITERIA,
) -> tuple[str, tuple[Reason, ...]]:
    """Return the verdict of a study, and the reasons against it."""
    code = max((verdict.code for verdict in verdicts.values()), key=VERDICTS.index)
    labels = labels or {name: derivative_label(name) for name in verdicts}
    about = {name: f"in {labels[name]}: " if len(verdicts) > 1 else "" for name in verdicts}
    every = [(name, reason) for name, verdict in verdicts.items() for reason in verdict.reasons]
    reasons = [Reason(each.code, about[name] + each.text, name) for name, each in every]
    vetoes: list[Reason] = []
    if code == RECALIBRATE or any(verdict.places for verdict in verdicts.values()):
        vetoes += [Reason(codes.NOT_COMPARED, text) for text in lost]
        vetoes += [Reason(codes.WORSE_RUN, worse_in_words(key)) for key in worsened(gap, criteria)]
    # Whatever the answer is: that nothing is missing has to hold for held-out samples too.
    for name, misfit in left_over(gap, criteria).items():
        vetoes.append(Reason(codes.HELD_OUT, about[name] + left_in_words(misfit), name))
    return "partly named" if vetoes and code == "named" else code, (*reasons, *vetoes)


def worsened(gap: pd.DataFrame, criteria: Criteria = CRITERIA) -> tuple[tuple[str, str, str], ...]:
    """Return the rows of the gap table, (data, metric, variable), whose free run is worse after than before.

    The error of the mean path has grown by more than a share `worse`, or the median draw fails sooner by more than
    that, and so does the upper end of its interval, or the model before never failed. Held-out data count where there
    are any.
    """
    records = zip(gap.index, gap.to_dict("records"), strict=True)
    every = [((str(key[0]), str(key[1]), str(key[2])), row) for key, row in records]
    # A state at rest has no error to speak of.
    rows = [each for each in every if each[0][1] == FREE_RUN and not np.isnan(each[1]["before"])]
    rows += [each for each in every if each[0][1] == FAILURE]
    keys = []
    for key, row in [each for each in rows if each[0][0] == "test"] or rows:
        before, after = row["before"], row["after"]
        if key[1] == FREE_RUN:
            worse = after > before + max(criteria.worse * before, criteria.integrator)
        else:
            # A run that never fails has NaN.
            before, after, upper = (np.inf if np.isnan(time) else time for time in (before, after, row["upper"]))
            worse = after < (1 - criteria.worse) * before and (upper < before or not np.isfinite(before))
        if worse:
            keys.append(key)
    return tuple(keys)


def left_over(gap: pd.DataFrame, criteria: Criteria = CRITERIA) -> dict[str, float]:
    """Return the misfit of held-out samples, for each equation that explains the training samples alone."""
    train, test = misfits(gap, "train"), misfits(gap, "test")
    return {name: left for name, left in test.items() if left > criteria.misfit * max(1.0, train.get(name, 1.0))}


def misfits(gap: pd.DataFrame, part: str) -> dict[str, float]:
    """Return the misfit of samples after, by equation, on the data "train" or "test"."""
    records = zip(gap.index, gap.to_dict("records"), strict=True)
    return {str(key[2]): float(row["after"]) for key, row in records if (key[0], key[1]) == (part, MISFIT)}


def worse_in_words(key: tuple[str, str, str]) -> str:
    """Return the sentence for a row of `worsened`."""
    _, metric, name = key
    return f"the free run of {name} gets worse" if metric == FREE_RUN else "the free run fails sooner"


def left_in_words(misfit: float) -> str:
    """Return the sentence for a misfit of `left_over`."""
    return f"held-out samples are left {misfit:.2g} times as far off as their noise allows"
