"""The verdict of a study over all its equations, and what speaks against it, in words."""

from collections.abc import Mapping, Sequence

import pandas as pd

from bayes_greybox.data.columns import derivative_label

from .answer.gap.denials import left_over, worsened
from .decision.decide import VERDICTS, Verdict


def verdict_of(
    findings: Mapping[str, Verdict],
    gap: pd.DataFrame,
    lost: Sequence[str] = (),
    labels: Mapping[str, str] | None = None,
) -> tuple[str, tuple[str, ...]]:
    """Verdict of a study, and what speaks against it: held-out samples and free runs may veto what is called *named*.

    Args:
        findings: By equation; of several, each says in which equation it doubts.
        gap: Before and after.
        lost: Why held-out data could not be compared, in words.
        labels: What each equation gives, `Runs.target_label`; by default the derivative of a state.
    """
    verdict = max((found.code for found in findings.values()), key=VERDICTS.index)
    labels = labels or {name: derivative_label(name) for name in findings}
    about = {name: f"in {labels[name]}: " if len(findings) > 1 else "" for name in findings}
    against = tuple(about[name] + text for name, found in findings.items() for text in found.reasons)
    claims = any(found.places for found in findings.values()) or verdict == "recalibrate"
    worse = worsened(gap) if claims else ()
    # Whatever the answer is: that nothing is missing has to hold for held-out samples too.
    held_out = [about[name] + left_in_words(misfit) for name, misfit in left_over(gap).items()]
    said = [*(lost if claims else ()), *(worse_in_words(key) for key in worse), *held_out]
    if said:
        verdict = "partly named" if verdict == "named" else verdict
    return verdict, (*against, *said)


def worse_in_words(key: tuple[str, str, str]) -> str:
    """What a row of the gap table that got worse means."""
    _, metric, name = key
    return f"the free run of {name} gets worse" if metric == "free-run NRMSE" else "the free run fails sooner"


def left_in_words(misfit: float) -> str:
    """What held-out samples say that the model after does not explain."""
    return f"held-out samples are left {misfit:.2g} times as far off as their noise allows"
