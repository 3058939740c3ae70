"""Scores of a benchmark: by family, by size of the effect, coverage, calibration, and the bars that it has to clear."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.hidden_effects.assumptions.score import (
    assumption_bars,
    assumption_scores,
    assumption_table,
    is_assumption,
)
from benchmarks.hidden_effects.cases import HIDDEN_FAMILIES
from benchmarks.runner import Tables, mean

from .case_scores import PEERS, SOLVERS, case_scores, coverage_table, listed, reliability_curve, stated, values

RATIO_BINS = (0.3, 1.0, 3.0, 10.0, 30.0)
"""Edges of the ranges of effect over noise that accuracy is given for; the first and last range have no outer end."""

SHARES = (*SOLVERS, "exact", *(f"{peer} exact" for peer in PEERS), "right or tied")
"""Scores whose means are shares of right answers."""

CaseScores = Sequence[Mapping[str, Any]]
"""Cases, as `case_scores` describes them."""

Bar = tuple[str, float, float, float]
"""A sentence, the value that was reached, and the least and the most that is enough."""


def score(every: Sequence[Mapping[str, Any]]) -> Tables:
    """Score finished cases; a case on which the study failed counts as wrong.

    In all tables the share of right answers has the solver's name. Cases of broken assumptions have tables of their
    own, and are in no other but the reliability and the bars.

    Returns:
        cases: One row for each case: verdict, names, and whether they are right, by solver.
        families: By family, for all, and for those that the oracle applies to ("one or none"); with `exact` (the
            study, or a peer, names all hidden effects and nothing else), `right or tied`, overlap with the true
            region, share of the closable gap closed on held-out data, and seconds a case.
        ratios: Family "catalogue" by the size of the effect.
        groups: Family "catalogue" by domain, noise level and effect.
        verdicts: Shares of the study's verdicts by family.
        coverage: Coverage of the study's intervals of coefficients.
        reliability: Reliability curve of the probabilities of names that the study stated ("stated"), and of the most
            probable effect of every case of the family "catalogue" ("listed"); and of all names that it stated, with
            broken assumptions or without ("all stated").
        bars: Bars, the values that were reached, and whether that is enough.
        assumptions: Broken assumptions by family, and for all; see `assumptions.score.assumption_table`.
        breaches: The same by family and by the way in which the assumption is broken.
        assumption_cases: One row for each case of a broken assumption.
        assumption_verdicts: Shares of the study's verdicts on these by family.
    """
    records = [row for row in every if not is_assumption(row)]
    broken = [assumption_scores(row) for row in every if is_assumption(row)]
    scored = [case_scores(row) for row in records]
    single = [case for case in scored if case["family"] == "catalogue"]
    families = _families(scored)
    coverage = coverage_table(records)
    curves = {
        "stated": reliability_curve(*stated(records)),
        "listed": reliability_curve(*listed(records)),
        "all stated": reliability_curve(*stated(every)),
    }
    reliability = pd.concat(curves, names=["names", "bin"])
    groups = {by: _accuracy(single, lambda case, by=by: case[by]) for by in ("domain", "noise", "effects")}
    sizes = [_label(*edges) for edges in pairwise(RATIO_BINS)]
    bars = [
        *_hidden_bars(single, families, coverage, reliability),
        ("expected calibration error of all stated names", *_calibration(reliability, "all stated")),
        *assumption_bars(every, broken),
    ]
    return {
        "cases": pd.DataFrame(scored),
        "families": families,
        "ratios": _accuracy(single, lambda case: _range(case["ratio"]), sizes),
        "groups": pd.concat(groups, names=["by", "group"]),
        "verdicts": _verdicts(scored),
        "coverage": coverage,
        "reliability": reliability,
        "bars": _bars(bars),
        "assumptions": assumption_table(broken),
        "breaches": assumption_table(broken, ("family", "breach")),
        "assumption_cases": pd.DataFrame(broken),
        "assumption_verdicts": _verdicts(broken),
    }


def _label(low: float, high: float) -> str:
    return f"{low:g} to {high:g}"


def _range(ratio: float) -> str:
    place = int(np.clip(np.searchsorted(RATIO_BINS, ratio, side="right") - 1, 0, len(RATIO_BINS) - 2))
    return _label(RATIO_BINS[place], RATIO_BINS[place + 1])


def _accuracy(scored: CaseScores, by: Callable[[Any], Any], order: Sequence[Any] | None = None) -> pd.DataFrame:
    """Shares of right answers by group."""
    groups = order or sorted({by(case) for case in scored})
    parts = {group: [case for case in scored if by(case) == group] for group in groups}
    rows = {group: {"cases": len(part), **{c: mean(values(part, c)) for c in SHARES}} for group, part in parts.items()}
    return pd.DataFrame.from_dict(rows, orient="index", columns=["cases", *SHARES])


def _families(scored: CaseScores) -> pd.DataFrame:
    parts = {name: [case for case in scored if case["family"] == name] for name in HIDDEN_FAMILIES}
    parts["one or none"] = [*parts["catalogue"], *parts["null"]]
    parts["all"] = list(scored)
    rows = {}
    for name, part in parts.items():
        if not part:
            continue
        gap = name not in ("null", "one or none", "all")
        rows[name] = {
            "cases": len(part),
            **{column: mean(values(part, column)) for column in (*SHARES, "overlap")},
            # What the study failed on has closed nothing.
            "closed": mean(values(part, "closed", 0.0)) / mean(values(part, "closable", 0.0)) if gap else np.nan,
            "closed in free run": mean(values(part, "closed in free run")) if gap else np.nan,
            "seconds": mean(values(part, "seconds")),
        }
        # A mean over those that it applies to would not compare with the others'.
        if any(case["oracle"] is None for case in part):
            rows[name]["oracle"] = np.nan
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("family")


def _verdicts(scored: CaseScores) -> pd.DataFrame:
    rows = {}
    for family in dict.fromkeys(case["family"] for case in scored):
        counts = Counter(case["study verdict"] for case in scored if case["family"] == family)
        rows[family] = {verdict: n / counts.total() for verdict, n in counts.items()}
    return pd.DataFrame.from_dict(rows, orient="index").fillna(0.0).rename_axis("family")


def _bars(bars: Iterable[Bar]) -> pd.DataFrame:
    """Bars with whether each holds; no verdict where there were no cases."""
    rows = [(*bar, bool(bar[2] <= bar[1] <= bar[3]) if np.isfinite(bar[1]) else None) for bar in bars]
    return pd.DataFrame(rows, columns=["bar", "reached", "least", "most", "holds"]).set_index("bar")


def _calibration(reliability: pd.DataFrame, names: str) -> tuple[float, float, float]:
    """Expected calibration error with its bar; none where no name was stated."""
    curve = reliability.loc[names]
    return (float(curve["ece"].sum()) if curve["cases"].sum() else np.nan, 0.0, 0.05)


def _hidden_bars(
    single: CaseScores, families: pd.DataFrame, coverage: pd.DataFrame, reliability: pd.DataFrame
) -> list[Bar]:
    """Return the bars of cases where all assumptions hold."""
    table = families.to_dict("index")
    covered = coverage.to_dict("index")

    def reached(family: str, column: str = "study") -> float:
        return table[family][column] if family in table else np.nan

    ahead = [reached(f) - np.fmax(reached(f, "stlsq"), reached(f, "ensemble")) for f in HIDDEN_FAMILIES if f in table]
    clear = mean(values([case for case in single if case["ratio"] >= 3], "right or tied"))
    return [
        ("right name first, or excusably tied, ratio >= 3", clear, 0.95, 1.0),
        ("accuracy less the oracle's, all sizes", reached("catalogue") - reached("catalogue", "oracle"), -0.05, 1.0),
        ("lead on PySINDy, family where it is least", float(np.min(ahead)) if ahead else np.nan, 1e-9, 1.0),
        ("nulls kept silent", reached("null"), 0.95, 1.0),
        ("mis-calibrated recognised", reached("mis-calibrated"), 0.9, 1.0),
        ("off-catalogue not named", reached("off-catalogue"), 0.9, 1.0),
        ("two effects both found", reached("two effects"), 0.8, 1.0),
        ("coverage of 90 % intervals", covered["all"]["90 %"] if "all" in covered else np.nan, 0.85, 0.95),
        ("expected calibration error of stated names", *_calibration(reliability, "stated")),
        ("held-out gap closed, of what the true model closes", reached("catalogue", "closed"), 0.95, np.inf),
    ]
