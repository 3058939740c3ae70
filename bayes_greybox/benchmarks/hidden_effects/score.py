"""Scores of a benchmark: by family, by size of the effect, coverage, calibration, and the bars that it has to clear."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.errors import InputError

from .cases import FAMILIES
from .marks import SOLVERS, case_marks, coverage_table, listed, reliability_curve, stated

RATIO_BINS = (0.3, 1.0, 3.0, 10.0, 30.0)
"""Edges of the ranges of effect over noise that accuracy is given for."""


@dataclass(frozen=True)
class Scores:
    """The benchmark's tables; in all of them the share of right answers has the solver's name.

    Attributes:
        cases: One row for each case: verdict, names, and whether they are right, by solver.
        families: By family, for all, and for those that the oracle applies to ("one or none"); with `exact` (the
            study names all that was hidden and nothing else), `right or tied`, overlap with the true region, share
            of the closable gap closed on held-out data, and seconds a case.
        ratios: Family "catalogue" by the size of the effect.
        groups: Family "catalogue" by domain, noise level and effect.
        verdicts: Shares of the study's verdicts by family.
        coverage: Coverage of the study's intervals of coefficients.
        reliability: Reliability curve of the probabilities of names that the study stated ("stated"), and of the most
            probable effect of every case of the family "catalogue" ("listed").
        bars: What must hold, what was reached, and whether that is enough.
    """

    cases: pd.DataFrame
    families: pd.DataFrame
    ratios: pd.DataFrame
    groups: pd.DataFrame
    verdicts: pd.DataFrame
    coverage: pd.DataFrame
    reliability: pd.DataFrame
    bars: pd.DataFrame

    def tables(self) -> dict[str, pd.DataFrame]:
        """All tables by name."""
        return dict(vars(self))


def score(rows: Iterable[Mapping[str, Any]]) -> Scores:
    """Score finished cases.

    Args:
        rows: Records of the cases, as `run` writes them; a case on which the study failed counts as wrong.

    Raises:
        InputError: No case.
    """
    records = list(rows)
    if not records:
        raise InputError("There is no finished case to score; run the benchmark first.")
    cases = pd.DataFrame([case_marks(row) for row in records])
    for solver in SOLVERS:
        cases[solver] = cases[solver].astype(float)
    single = cases[cases["family"] == "catalogue"]
    families = _families(cases)
    coverage = coverage_table(records)
    curves = {"stated": reliability_curve(*stated(records)), "listed": reliability_curve(*listed(records))}
    reliability = pd.concat(curves, names=["names", "bin"])
    groups = {key: _accuracy(single, single[key]) for key in ("domain", "noise", "effects")}
    return Scores(
        cases=cases,
        families=families,
        ratios=_accuracy(single, pd.cut(single["ratio"], RATIO_BINS).map(_range)),
        groups=pd.concat(groups, names=["by", "group"]),
        verdicts=pd.crosstab(cases["family"], cases["study verdict"], normalize="index"),
        coverage=coverage,
        reliability=reliability,
        bars=_bars(single, families, coverage, reliability),
    )


def _range(interval: Any) -> str:
    return f"{interval.left:g} to {interval.right:g}"


def _accuracy(cases: pd.DataFrame, by: Any) -> pd.DataFrame:
    """Shares of right answers by group."""
    columns = [*SOLVERS, "exact", "right or tied"]
    groups = cases[columns].astype(float).groupby(by, observed=False, sort=True)
    table = groups.mean()
    table.insert(0, "cases", groups.size())
    return table


def _families(cases: pd.DataFrame) -> pd.DataFrame:
    kinds = {name: cases[cases["family"] == name] for name in FAMILIES}
    kinds = {name: part for name, part in kinds.items() if len(part)}
    kinds["one or none"] = cases[cases["family"].isin(("catalogue", "null"))]
    kinds["all"] = cases
    rows = {}
    for name, part in kinds.items():
        # What the study failed on has closed nothing.
        closed = {key: part[key].astype(float).fillna(0.0).mean() for key in ("closed", "closed in free run")}
        rows[name] = {
            "cases": len(part),
            **{column: part[column].astype(float).mean() for column in (*SOLVERS, "exact", "right or tied")},
            "overlap": part["overlap"].astype(float).mean(),
            "closed": closed["closed"] / part["closable"].mean() if name not in ("null", "all") else np.nan,
            "closed in free run": closed["closed in free run"] if name not in ("null", "all") else np.nan,
            "seconds": part["seconds"].astype(float).mean(),
        }
        # The oracle answers only what it applies to; a mean over the rest would not be its.
        if part["oracle"].isna().any():
            rows[name]["oracle"] = np.nan
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("family")


def _bars(
    single: pd.DataFrame, families: pd.DataFrame, coverage: pd.DataFrame, reliability: pd.DataFrame
) -> pd.DataFrame:
    """What the benchmark asks for, with what was reached; no verdict where there were no cases."""

    def reached(family: str, column: str = "study") -> float:
        return float(families.loc[family, column]) if family in families.index else np.nan

    ahead = [
        families.loc[name, "study"] - families.loc[name, ["stlsq", "ensemble"]].astype(float).max()
        for name in FAMILIES
        if name in families.index
    ]
    covered = float(coverage.loc["all", "90 %"]) if "all" in coverage.index else np.nan
    rows = [
        ("right name first, or excusably tied, ratio ≥ 3", float(single[single["ratio"] >= 3]["right or tied"].mean()), 0.95, 1.0),
        ("accuracy less that of the oracle, all sizes", reached("catalogue") - reached("catalogue", "oracle"), -0.05, 1.0),
        ("lead on PySINDy in the family where it is least", float(np.min(ahead)) if ahead else np.nan, 1e-9, 1.0),
        ("nulls kept silent", reached("null"), 0.95, 1.0),
        ("mis-calibrated recognised", reached("mis-calibrated"), 0.9, 1.0),
        ("off-catalogue not named", reached("off-catalogue"), 0.9, 1.0),
        ("two effects both found", reached("two effects"), 0.8, 1.0),
        ("coverage of 90 % intervals", covered, 0.85, 0.95),
        ("expected calibration error of stated names", float(reliability.loc["stated"]["ece"].sum()), 0.0, 0.05),
        ("held-out gap closed, of what the true model closes", reached("catalogue", "closed"), 0.95, np.inf),
    ]  # fmt: skip
    table = pd.DataFrame(rows, columns=["bar", "reached", "least", "most"]).set_index("bar")
    inside = (table["reached"] >= table["least"]) & (table["reached"] <= table["most"])
    table["holds"] = inside.astype(object).where(table["reached"].notna(), None)
    return table
