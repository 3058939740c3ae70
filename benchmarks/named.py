"""One effect that is hidden in a machine of its field, or none: whether a study names it."""

from typing import Any

from .answers import SURE
from .runner import Record, Tables, by_group, mean, median


def named(found: Any, seconds: float, hidden: str, size: float | None = None) -> Record:
    """Return what a study says of the effect that is hidden; "" where nothing is.

    Its keys are verdict; probability; found (the effect is in the answer, alone or not); right (the effect
    above 0.9; where nothing is hidden: *no gap*); named (*named* with it alone); wrong (other effects above 0.9); holds
    (whether the 90 % interval has its size, where it is given); instrument (errors of the measurement above 0.9);
    seconds.
    """
    rows = found.effects.sort_values("probability", ascending=False, kind="stable").to_dict("records")
    likely = [str(row["slug"]) for row in rows if row["probability"] > SURE]
    errors = found.instrument.to_dict("records")
    own = next((row for row in rows if row["slug"] == hidden), None)
    return {
        "verdict": found.verdict,
        "probability": float(own["probability"]) if own else None,
        "found": bool(own and own["status"]),
        "right": hidden in likely if hidden else found.verdict == "no gap",
        "named": found.verdict == "named" and likely == [hidden],
        "wrong": sorted(set(likely) - {hidden}),
        "holds": bool(own["lower"] <= size <= own["upper"]) if own and size is not None else None,
        "instrument": [str(row["text"]) for row in errors if row["status"] and row["probability"] > SURE],
        "seconds": seconds,
    }


def counted(records: list[Record], what: str) -> Tables:
    """Return a row for each kind of record; see `named`.

    Its columns are the number of records; of those that are found, right, named and wrong; the share of intervals that
    hold; and the median of seconds.
    """

    def of_group(group: list[Record]) -> Record:
        return {
            what: len(group),
            **{key: sum(bool(record[key]) for record in group) for key in ("found", "right", "named", "wrong")},
            "holds": mean([record["holds"] for record in group if record["holds"] is not None]),
            "seconds": median([record["seconds"] for record in group]),
        }

    return {what: by_group(records, {"kind": "kind"}, of_group)}
