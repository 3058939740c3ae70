"""What each way of choosing an experiment came to, and how sure the differences are."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

LEAST = 1e-3
"""A truth less probable than this scores as if it were so probable: the logarithm has no end."""

OURS = "information"
"""The way that the others are compared with."""

RESAMPLED = 10_000
"""Bootstrap samples."""


def score(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """One row for each way, "before" first.

    Args:
        rows: Of `run.measure`; those without a tie are left out.

    Returns:
        ties; right (share *named* with what is hidden and nothing else); probability (of it, mean); log (mean of its
        logarithm); wrong (ties with a wrong name, as `Answer.wrong` says).
    """
    tied = [row for row in rows if row["ways"]]
    ways = list(tied[0]["ways"]) if tied else []
    table = {}
    for way in ["before", *ways]:
        own = [row["before"] if way == "before" else row["ways"][way] for row in tied]
        table[way] = {
            "ties": len(own),
            "right": _mean([answer["right"] for answer in own]),
            "probability": _mean([answer["probability"] for answer in own]),
            "log": _mean([answer["log"] for answer in own]),
            "wrong": sum(bool(answer["wrong"]) for answer in own),
        }
    return pd.DataFrame.from_dict(table, orient="index").rename_axis("way")


def differences(rows: Sequence[Mapping[str, Any]], level: float = 0.95, seed: int = 0) -> pd.DataFrame:
    """How much better the information is than each other way, in the same ties with the same noise.

    Args:
        rows: Of `run.measure`.
        level: Of the intervals, by the bootstrap of ties.
        seed: Of the bootstrap.

    Returns:
        By other way and score (right, probability, log): difference, lower, upper; of right also the ties in which the
        one alone and the other alone is right, and the exact two-sided p of McNemar's test (1947).
    """
    tied = [row["ways"] for row in rows if row["ways"]]
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


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")
