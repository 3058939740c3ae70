"""The verdict of a study over all its equations, and the reasons against it."""

from collections.abc import Mapping, Sequence

import pandas as pd

from bayes_greybox.data.columns import derivative_label

from .answer.gap.denials import left_over, worsened
from .decision import reasons as codes
from .decision.decide import VERDICTS, Verdict
from .decision.reasons import Reason


def verdict_of(
    findings: Mapping[str, Verdict],
    gap: pd.DataFrame,
    lost: Sequence[str] = (),
    labels: Mapping[str, str] | None = None,
) -> tuple[str, tuple[Reason, ...]]:
    """Return the verdict of a study, and the reasons against it.

    Held-out samples and free runs may veto what is called *named*.

    Args:
        findings: Verdicts by equation; where there are several, each reason says which equation it doubts.
        gap: Gap table, before and after.
        lost: Reasons why held-out data could not be compared, in words.
        labels: Names of what each equation gives, `Runs.target_label`; by default the derivative of a state.
    """
    verdict = max((found.code for found in findings.values()), key=VERDICTS.index)
    labels = labels or {name: derivative_label(name) for name in findings}
    about = {name: f"in {labels[name]}: " if len(findings) > 1 else "" for name in findings}
    reasons = [
        Reason(each.code, about[name] + each.text, name) for name, found in findings.items() for each in found.reasons
    ]
    vetoes: list[Reason] = []
    if verdict == "recalibrate" or any(found.places for found in findings.values()):
        vetoes += [Reason(codes.NOT_COMPARED, text) for text in lost]
        vetoes += [Reason(codes.WORSE_RUN, worse_in_words(key)) for key in worsened(gap)]
    # Whatever the answer is: that nothing is missing has to hold for held-out samples too.
    for name, misfit in left_over(gap).items():
        vetoes.append(Reason(codes.HELD_OUT, about[name] + left_in_words(misfit), name))
    if vetoes and verdict == "named":
        verdict = "partly named"
    return verdict, (*reasons, *vetoes)


def worse_in_words(key: tuple[str, str, str]) -> str:
    """Return the meaning of a row of the gap table that got worse."""
    _, metric, name = key
    return f"the free run of {name} gets worse" if metric == "free-run NRMSE" else "the free run fails sooner"


def left_in_words(misfit: float) -> str:
    """Return in words that the extended model does not explain held-out samples."""
    return f"held-out samples are left {misfit:.2g} times as far off as their noise allows"
