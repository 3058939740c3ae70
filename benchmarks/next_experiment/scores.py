"""Scores of each way of choosing an experiment, and how sure the differences are."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from benchmarks.runner import Record, Tables, mean

LEAST_PROBABILITY = 1e-3
"""A truth less probable than this scores as if it were so probable: the logarithm has no end."""

OURS = "information"
"""The way that the others are compared with."""

RESAMPLED = 10_000
"""Bootstrap samples."""


def score(records: list[Record]) -> Tables:
    """Return the scores of the ways, and the differences between them."""
    return {"ways": ways(records), "differences": differences(records)}


def ways(records: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Return one row for each way, "before" first; cases without a tie are left out.

    Its columns are ties; right (share *named* with the hidden effect and nothing else); probability (of it, mean); log
    (mean of its logarithm); wrong (ties with a wrong name, as in `Answer.wrong`).
    """
    tied = [record for record in records if record["ways"]]
    table = {}
    for way in ["before", *(tied[0]["ways"] if tied else [])]:
        answers = [record["before"] if way == "before" else record["ways"][way] for record in tied]
        table[way] = {
            "ties": len(answers),
            **{key: mean([answer[key] for answer in answers]) for key in ("right", "probability", "log")},
            "wrong": sum(bool(answer["wrong"]) for answer in answers),
        }
    return pd.DataFrame.from_dict(table, orient="index").rename_axis("way")


def differences(records: Sequence[Mapping[str, Any]], level: float = 0.95, seed: int = 0) -> pd.DataFrame:
    """Compare the information with each other way, in the same ties with the same noise.

    Returns:
        By other way and score (right, probability, log): difference, lower, upper; of right also the ties in which the
        one alone and the other alone is right, and the exact two-sided p of McNemar's test (1947).
    """
    tied = [record["ways"] for record in records if record["ways"]]
    columns = ["difference", "lower", "upper", "ours alone", "other alone", "p"]
    table = {}
    for way in [name for name in (tied[0] if tied else {}) if name != OURS]:
        for key in ("right", "probability", "log"):
            each = np.array([float(ways[OURS][key]) - float(ways[way][key]) for ways in tied])
            # The same samples for every way and score.
            places = np.random.default_rng(seed).integers(len(each), size=(RESAMPLED, len(each)))
            low, high = np.quantile(np.mean(each[places], axis=1), [(1 - level) / 2, (1 + level) / 2])
            found = [float(np.mean(each)), float(low), float(high), np.nan, np.nan, np.nan]
            if key == "right":
                ours, other = int(np.sum(each > 0)), int(np.sum(each < 0))
                p = binomtest(ours, ours + other).pvalue if ours + other else 1.0
                found[3:] = [ours, other, float(p)]
            table[way, key] = dict(zip(columns, found, strict=True))
    index = pd.MultiIndex.from_tuples(list(table), names=["other", "score"])
    return pd.DataFrame(list(table.values()), index=index, columns=columns)


def show(tables: Tables) -> dict[str, pd.DataFrame]:
    """Return the score of each way, then by how much the information is better."""
    shown = tables["differences"].reset_index("score").rename(columns={"ours alone": "ours", "other alone": "other"})
    return {
        "Ties after one more run: share of right names, probability of the truth": tables["ways"],
        "By how much the expected information is better; 95 % intervals": shown,
    }
