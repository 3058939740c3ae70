"""Scores of data with a broken assumption: names, the instrument, and whether the free run bears them out."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.hidden_effects.scoring.case_scores import FAILED, PEERS, right_names, values, wrong_names
from benchmarks.runner import mean, median

from .families import FAMILIES

FAULT_FOUND = 0.5
"""An instrument's fault is found if it is more likely than this, or if it is in the model."""

HALF_STEP = 0.5
"""Least delay, in sampling steps, that has to be found."""

WORSE = 1.05
"""A free run has worsened if the errors of all states together, each over its spread, grew by this factor."""

QUIET = ("correlated noise", "state-dependent noise", "heavy tails")
"""Families whose noise alone must not be taken for something missing."""

MOST_WRONG, MOST_WRONG_IN_FAMILY = 0.01, 0.05
"""Largest share of cases with a wrong name that somebody would believe in, in all and in any family."""

_CLAIM = re.compile(r"\bcloses\b.*?(\d+(?:\.\d+)?) ?%")

_AVERAGED = (
    *("wrong above 0.9", "wrong", "right", "silent", "unknown", "instrument found", "delay covered", "claim denied"),
    *(f"{peer} {kind}" for peer in PEERS for kind in ("wrong", "right")),
)


def is_assumption(row: Mapping[str, Any]) -> bool:
    """Return True if a finished case belongs to one of the families of broken assumptions."""
    return row["family"] in FAMILIES


def assumption_scores(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return one row of the table of cases; None for what does not apply."""
    study = row.get("study") or {}
    verdict = study.get("verdict", FAILED)
    added = [effect["slug"] for effect in study.get("effects", ()) if effect["status"]]
    hidden = bool(row["effects"])
    silent = row.get("silent", ())
    before, after = free_run(study)
    scores = {
        **{name: row[name] for name in ("key", "family", "breach", "size", "domain", "host", "noise", "rows")},
        "effects": "+".join(row["effects"]),
        "ratio": min((item["ratio"] for item in row["truth"]), default=None),
        "study verdict": verdict,
        "study names": "+".join(added),
        "instrument": "+".join(entry["suspect"] for entry in _believed(study)),
        # A study that failed has said nothing wrong, and nothing right.
        "wrong above 0.9": bool(wrong_names(row, surely=True)),
        "wrong": bool(wrong_names(row)),
        "right": is_right(row, verdict, added) if hidden else None,
        "silent": verdict in silent if silent and not hidden else None,
        "unknown": verdict == "unknown",
        "instrument found": _found(row, study),
        "delay covered": delay_covered(row, study),
        "claim denied": claim_denied(study),
        "free run before": before,
        "free run after": after,
        "seconds": study.get("seconds"),
    }
    fine = right_names(row).union(row.get("excused", ()))
    for peer in PEERS:
        names = row[peer]["names"] if row.get(peer) else None
        scores[f"{peer} wrong"] = None if names is None else not set(names) <= fine
        scores[f"{peer} right"] = None if names is None or not hidden else _all_named(row, names)
    return scores


def is_right(row: Mapping[str, Any], verdict: str, names: Sequence[str]) -> bool:
    """Return True if all hidden effects were named.

    In a verdict "named" they are among the names, in "partly named" and "one of" they come first.
    """
    if verdict == "named":
        return _all_named(row, names)
    return verdict in ("partly named", "one of") and _all_named(row, names[: len(row["effects"])])


def delay_covered(row: Mapping[str, Any], study: Mapping[str, Any]) -> bool | None:
    """Return True if the interval of a delay that was found holds the true one; None if there is none."""
    for suspect in row.get("suspects", ()):
        if suspect["samples"] is None:
            continue
        entries = [entry for entry in _believed(study) if _is_meant(entry, suspect)]
        if entries:
            entry = max(entries, key=lambda entry: entry["probability"] or 0.0)
            low, high = entry["lower_samples"], entry["upper_samples"]
            signs = (1.0, -1.0) if suspect["either"] else (1.0,)
            return any(low <= sign * suspect["samples"] <= high for sign in signs)
    return None


def claim_denied(study: Mapping[str, Any]) -> bool | None:
    """Return True if the sentence says that the gap is closed while the held-out free run worsened.

    A sentence that speaks of the free run itself hides nothing. None without a sentence or a free run.
    """
    sentence, (before, after) = study.get("sentence"), free_run(study)
    if sentence is None or before is None:
        return None
    claim = _CLAIM.search(sentence)
    claims = claim is not None and float(claim.group(1)) > 0.0 and "free run" not in sentence
    return claims and (after is None or after > WORSE * before)


def free_run(study: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Return the root mean square of a free run's NRMSE over states, before and after; None where it blew up."""
    states = (study.get("free_run") or {}).values()
    if not states:
        return None, None
    pairs = [[state[when] for state in states] for when in ("before", "after")]
    first, second = (
        None if any(value is None for value in values) else float(np.sqrt(np.mean(np.square(values))))
        for values in pairs
    )
    return first, second


def assumption_table(scored: Sequence[Mapping[str, Any]], by: Sequence[str] = ("family",)) -> pd.DataFrame:
    """Return shares of cases by family (and breach), and for "all"; NaN where nothing applies.

    Columns: wrong names that somebody would believe in, wrong names at all, right names where something is hidden,
    "no gap" or "instrument" where nothing is, verdict "unknown", instrument's fault found, coverage of a delay's 90 %
    interval, sentences that the free run denies, wrong and right names of PySINDy, medians of the free run's error
    before and after, and seconds a case.
    """
    rows = {}
    groups = list(dict.fromkeys(tuple(case[name] for name in by) for case in scored))
    parts = {group: [case for case in scored if tuple(case[name] for name in by) == group] for group in groups}
    if len(by) == 1 and scored:
        parts[("all",)] = list(scored)
    for group, part in parts.items():
        rows[group] = {
            "cases": len(part),
            **{column: mean(values(part, column)) for column in _AVERAGED},
            **{column: median(values(part, column)) for column in ("free run before", "free run after")},
            "seconds": mean(values(part, "seconds")),
        }
    index = pd.MultiIndex.from_tuples(list(rows), names=list(by))
    table = pd.DataFrame(list(rows.values()), index=index)
    return table.droplevel(list(by[1:])) if len(by) == 1 else table


def assumption_bars(
    records: Sequence[Mapping[str, Any]], scored: Sequence[Mapping[str, Any]]
) -> list[tuple[str, float, float, float]]:
    """Return the bars: a sentence, the value that was reached, the least and the most that is enough."""
    believed: dict[str, list[bool]] = {}
    for row in records:
        believed.setdefault(row["family"], []).append(bool(wrong_names(row, surely=True)))
    worst = max(mean(wrong) for wrong in believed.values())
    delays = [case for case in scored if case["family"] == "delay" and abs(case["size"]) >= HALF_STEP]
    found = [case for case in delays if case["instrument found"]]
    quiet = [case for case in scored if case["family"] in QUIET and not case["effects"]]
    named = [{"named": case["study verdict"] in ("named", "partly named")} for case in quiet]
    return [
        ("wrong names above 0.9, or in a verdict, all cases", mean(sum(believed.values(), [])), 0.0, MOST_WRONG),
        ("wrong names above 0.9, or in a verdict, worst family", worst, 0.0, MOST_WRONG_IN_FAMILY),
        ("delays of half a step or more found", mean(values(delays, "instrument found")), 0.9, 1.0),
        ("coverage of these delays' 90 % intervals", mean(values(delays, "delay covered")), 0.85, 0.95),
        ("right names beside a delay that was found", mean(values(found, "right")), 0.9, 1.0),
        ("no gap under noise that is not white and normal", mean(values(quiet, "silent")), 0.9, 1.0),
        ("names under such noise alone", mean(values(named, "named")), 0.0, 0.0),
        ("sentences that the free run denies", mean(values(scored, "claim denied")), 0.0, 0.0),
    ]


def _all_named(row: Mapping[str, Any], names: Iterable[str]) -> bool:
    given = set(names)
    # A case whose data could not be made has nothing but its effects.
    accepted = row.get("accepted") or [[slug] for slug in row["effects"]]
    return all(given & set(slugs) for slugs in accepted)


def _believed(study: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return faults of the instrument that the study believes in."""
    entries = study.get("instrument") or ()
    return [e for e in entries if e["status"] == "in the model" or (e["probability"] or 0.0) > FAULT_FOUND]


def _is_meant(entry: Mapping[str, Any], suspect: Mapping[str, Any]) -> bool:
    if entry["suspect"] != suspect["name"]:
        return False
    return not suspect["channels"] or suspect["either"] or entry["channel"] in suspect["channels"]


def _found(row: Mapping[str, Any], study: Mapping[str, Any]) -> bool | None:
    suspects = row.get("suspects", ())
    if not suspects:
        return None
    return any(_is_meant(entry, suspect) for entry in _believed(study) for suspect in suspects)
