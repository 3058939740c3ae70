"""Codes that files of earlier versions lack, read from the texts that they have instead."""

import re
from collections.abc import Mapping
from typing import Any

import pandas as pd

from bayes_greybox.discovery.answer.checks.doubts import SAMPLES_TELL
from bayes_greybox.discovery.answer.equation_study import KINDS_IN_WORDS
from bayes_greybox.discovery.decision import reasons as codes
from bayes_greybox.discovery.decision.decide import AND_MORE_IN_WORDS, ONE_LAW_IN_WORDS
from bayes_greybox.discovery.decision.reasons import Reason
from bayes_greybox.discovery.sensor_errors.memory import kind_and_channel

REASON_ENDINGS = {
    ONE_LAW_IN_WORDS: codes.ONE_LAW,
    AND_MORE_IN_WORDS: codes.ONE_LAW_AND_MORE,
    SAMPLES_TELL: codes.UNSEEN_SHAPE,
}
"""Codes by how the texts of reasons end."""

UNPLAYED = re.compile(r"no column plays the role '(\w+)'")


def add_codes(values: dict[str, Any]) -> None:
    """Add the codes that are missing to the values of a study's file.

    Args:
        values: Fields of `StudyResult` by name.
    """
    if "reasons" not in values:
        data, equations = values["train"], list(values["maps"])
        about = {name: f"in {data.target_label(name)}: " if len(equations) > 1 else "" for name in equations}
        values["reasons"] = tuple(_reason(text, about) for text in values["against"])
    if "kind" not in values["memory"]:
        values["memory"] = with_kinds(values["memory"])
    if "lacking_roles" not in values:
        found = {key: UNPLAYED.match(why) for key, why in values["left_out"].items()}
        values["lacking_roles"] = {key: match[1] for key, match in found.items() if match}


def with_kinds(memory: pd.DataFrame) -> pd.DataFrame:
    """Return the table of what remains with its columns `kind` and `channel`."""
    whole = {text: kind for kind, text in KINDS_IN_WORDS.items()}
    names = [str(name) for name in memory.index.get_level_values(-1)] if len(memory) else []
    pairs = [(whole[name], "") if name in whole else kind_and_channel(name) for name in names]
    return memory.assign(kind=[kind for kind, _ in pairs], channel=[channel for _, channel in pairs])


def _reason(text: str, about: Mapping[str, str]) -> Reason:
    equation = next((name for name, start in about.items() if start and text.startswith(start)), "")
    equation = equation or (next(iter(about)) if len(about) == 1 else "")
    return Reason(
        next((code for end, code in REASON_ENDINGS.items() if text.endswith(end)), codes.CHECK), text, equation
    )
