"""The worth of one finished case: right answers, and further measures."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float

from benchmarks.answers import SURE
from benchmarks.hidden_effects.solvers.oracle import NONE
from benchmarks.hidden_effects.solvers.study import ONE_STEP

PEERS = ("stlsq", "ensemble")
"""PySINDy's STLSQ and its ensemble."""

SOLVERS = ("study", "oracle", *PEERS)
"""The study, the Bayes-optimal classifier, and PySINDy."""

FAILED = "failed"
"""Verdict of a solver that raised an error."""

LARGEST_TIE = 3
"""A larger set of tied effects names nothing."""

SEPARATED = 0.95
"""Probability of its first name from which on the oracle is said to separate the effects of a case."""

PROBABILITY_BINS = np.linspace(0.0, 1.0, 11)
"""Edges of the bins of a reliability curve."""

_QUARTILE = 0.6744897501960817


def is_right(family: str, truth: Sequence[str], verdict: str, names: Sequence[str]) -> bool:
    """Return True if an answer is right; the same rule for every solver.

    One effect has to be named first, and two both have to be named; of the other families the verdict has to be "no
    gap", "recalibrate", or anything but "named".
    """
    if family == "null":
        return verdict == "no gap"
    if family == "mis-calibrated":
        return verdict == "recalibrate"
    if family == "off-catalogue":
        return verdict not in ("named", FAILED)
    if verdict not in ("named", "one of", "partly named"):
        return False
    return list(names[:1]) == list(truth) if family == "catalogue" else set(truth) <= set(names)


def is_exact(family: str, truth: Sequence[str], verdict: str, names: Sequence[str]) -> bool:
    """Return True if an answer is right and names nothing else."""
    if family not in ("catalogue", "two effects"):
        return is_right(family, truth, verdict, names)
    return verdict == "named" and set(names) == set(truth)


def answers(row: Mapping[str, Any]) -> dict[str, tuple[str, list[str]]]:
    """Return verdict and names by solver; solvers that did not run, or do not apply to the family, are left out."""
    study = row.get("study")
    if study is None:
        given = {"study": (FAILED, [])}
    else:
        given = {"study": (study["verdict"], [e["slug"] for e in study["effects"] if e["status"] == "added"])}
    # What the oracle knows is true of these families only.
    if row.get("oracle") and row["family"] in ("catalogue", "null"):
        first = next(iter(row["oracle"]))
        given["oracle"] = ("no gap", []) if first == NONE else ("named", [first])
    for peer in PEERS:
        if row.get(peer):
            given[peer] = (row[peer]["verdict"], row[peer]["names"])
    return given


def case_scores(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return one row of the table of cases."""
    family, truth, given = row["family"], row["effects"], answers(row)
    study = row.get("study") or {}
    verdict, names = given["study"]
    right = {solver: is_right(family, truth, *given[solver]) if solver in given else None for solver in SOLVERS}
    # A case without data, because making them failed, has only the ratio that was wanted.
    ratios = [item["ratio"] for item in row["truth"]] or ([row["off"][1]] if row["off"] else row["ratios"])
    closed = study.get("closed", {})
    return {
        **{name: row[name] for name in ("key", "family", "domain", "host", "noise")},
        "effects": "+".join(truth),
        "ratio": row["visible"] if row.get("visible") else min(ratios, default=None),
        "study verdict": verdict,
        "study names": "+".join(names),
        **right,
        "exact": is_exact(family, truth, verdict, names),
        **{f"{peer} exact": is_exact(family, truth, *given[peer]) if peer in given else None for peer in PEERS},
        "right or tied": bool(right["study"]) or _is_excused(row),
        "overlap": study.get("overlap", {}).get("iou"),
        "closed": next((closed[metric] for metric in ONE_STEP if metric in closed), None),
        "closed in free run": closed.get("free-run NRMSE"),
        "closable": study.get("closable", row["closable"]),
        "seconds": study.get("seconds"),
    }


def values(scored: Iterable[Mapping[str, Any]], column: str, missing: float | None = None) -> list[float]:
    """Return the scores of a column; cases without one are left out, or count as `missing`."""
    found = [missing if case[column] is None else case[column] for case in scored]
    return [float(value) for value in found if value is not None]


def stated(rows: Iterable[Mapping[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    """Return probabilities of the first names that the study stated, in any family, and whether they were right.

    A name is right if it is one of the hidden effects; in a family without effects of the catalogue none is. Where a
    broken assumption cannot be told from an effect, its name is neither right nor wrong and is left out.
    """
    found = []
    for row in rows:
        first = _first_added(row)
        if first is None or first["probability"] is None or first["slug"] in row.get("excused", ()):
            continue
        found.append((first["probability"], first["slug"] in right_names(row)))
    return _columns(found)


def right_names(row: Mapping[str, Any]) -> set[str]:
    """Return slugs that are right somewhere in a case: its hidden effects, and names that count as them."""
    return {slug for slugs in row.get("accepted", ()) for slug in slugs}.union(row["effects"])


def wrong_names(row: Mapping[str, Any], surely: bool = False) -> set[str]:
    """Return effects that the study added, in any equation, and that were not hidden.

    With `surely` they are those in which somebody would believe: any that is listed with a probability above `SURE`,
    added or not, and all that belong to a verdict "named".
    """
    study = row.get("study") or {}
    fine = right_names(row).union(row.get("excused", ()))
    named = study.get("verdict") == "named"
    found = set()
    for place in ("effects", "elsewhere"):
        for effect in study.get(place) or ():
            added = effect["status"] == "added"
            believed = (effect["probability"] or 0.0) > SURE or (added and named)
            # What belongs in one equation is wrong in every other.
            if (believed if surely else added) and (place == "elsewhere" or effect["slug"] not in fine):
                found.add(effect["slug"])
    return found


def listed(rows: Iterable[Mapping[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest probability of an effect in each case of one effect, and whether it was the hidden one."""
    found = []
    for row in rows:
        known = [e for e in (row.get("study") or {}).get("effects", ()) if e["probability"] is not None]
        if row["family"] == "catalogue" and known:
            first = max(known, key=lambda effect: effect["probability"])
            found.append((first["probability"], [first["slug"]] == list(row["effects"])))
    return _columns(found)


def reliability_curve(probability: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"]) -> pd.DataFrame:
    """Compare stated probabilities with how often they were right.

    Returns:
        By bin: number of cases, mean stated probability, share right, and the bin's part of the expected
        calibration error sum_b n_b / n |right_b - stated_b|, which is the sum of the column "ece".
    """
    place = np.clip(np.digitize(probability, PROBABILITY_BINS) - 1, 0, len(PROBABILITY_BINS) - 2)
    rows = []
    for b, (low, high) in enumerate(zip(PROBABILITY_BINS[:-1], PROBABILITY_BINS[1:], strict=True)):
        here = place == b
        n = int(np.sum(here))
        said = float(np.mean(probability[here])) if n else np.nan
        share = float(np.mean(right[here])) if n else np.nan
        part = n / len(probability) * abs(share - said) if n else 0.0
        rows.append((float(low), float(high), n, said, share, part))
    return pd.DataFrame(rows, columns=["low", "high", "cases", "stated", "right", "ece"])


def coverage_table(rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Return the coverage of the study's intervals, over the effects that it added and that were hidden.

    Returns:
        By family and for "all": number of intervals, and shares of 50 and 90 % intervals that hold the true
        coefficient. The 50 % interval is the normal one about the posterior mean.
    """
    found = []
    for row in rows:
        truth = {item["slug"]: item["coefficient"] for item in row["truth"]}
        for effect in (row.get("study") or {}).get("effects", ()):
            if effect["status"] == "added" and effect["slug"] in truth and effect["sd"] is not None:
                value = truth[effect["slug"]]
                half = abs(value - effect["mean"]) <= _QUARTILE * effect["sd"]
                found.append((row["family"], float(half), float(effect["lower"] <= value <= effect["upper"])))
    table = pd.DataFrame(found, columns=["family", "50 %", "90 %"])
    table = pd.concat([table, table.assign(family="all")])
    return table.groupby("family", sort=False).agg(
        **{"intervals": ("90 %", "size"), "50 %": ("50 %", "mean"), "90 %": ("90 %", "mean")}
    )


def _first_added(row: Mapping[str, Any]) -> Mapping[str, Any] | None:
    effects = (row.get("study") or {}).get("effects", ())
    return next((effect for effect in effects if effect["status"] == "added"), None)


def _is_excused(row: Mapping[str, Any]) -> bool:
    """Return True if the study's first name is tied with the true one, and the oracle cannot separate them either."""
    first = _first_added(row)
    if row["family"] != "catalogue" or first is None or not row.get("oracle"):
        return False
    tied = {first["slug"], *first["tied_with"]}
    unsure = next(iter(row["oracle"].values())) < SEPARATED
    return unsure and len(tied) <= LARGEST_TIE and set(row["effects"]) <= tied


def _columns(found: list[tuple[float, bool]]) -> tuple[np.ndarray, np.ndarray]:
    return np.array([p for p, _ in found], float), np.array([right for _, right in found], bool)
