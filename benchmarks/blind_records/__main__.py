"""Study every record with default settings and write what was said: `python -m benchmarks.blind_records [NAME ...]`."""

import argparse
import csv
import time
from pathlib import Path

import bayes_greybox as bg

from .records import Record, names, record

HELD_OUT = 0.3
"""Last part of each table, held out as in the README."""

SURE, LIKELY = 0.9, 0.5

COLUMNS = (
    "record", "kind", "verdict", "acceptable", "names above 0.5", "wrong above 0.5", "wrong above 0.9", "seconds",
)  # fmt: skip


def studied(made: Record) -> bg.Study:
    """Return the study of a record, as its owner would ask for it; nothing is sampled."""
    given = dict(made.study_kwargs)
    reading = {key: given.pop(key) for key in ("states", "inputs", "derivatives", "units", "missing") if key in given}
    learned = given.pop("learn", None)
    train, test = bg.read(made.table, time="t", **reading).split(1 - HELD_OUT)
    model = bg.GreyBox(simulation=made.equations, **({"dictionary": {learned: []}} if learned else {}))
    return bg.find_missing_effects(model, train, test=test, settle=False, progress=False, **given)


def row_of(made: Record) -> dict[str, object]:
    """Return what was said of a record, and whether it is right."""
    started = time.perf_counter()
    try:
        study = studied(made)
    except bg.InputError as error:
        return {"record": made.name, "kind": made.kind, "verdict": f"refused: {error}", "acceptable": False}
    likely = study.effects[study.effects["probability"] > LIKELY]
    wrong = likely[~likely["slug"].isin(made.right | made.harmless)]
    sure = wrong[wrong["probability"] > SURE]
    named = [f"{slug}:{p:.3f}" for slug, p in zip(likely["slug"], likely["probability"], strict=True)]
    return {
        "record": made.name, "kind": made.kind, "verdict": study.verdict,
        "acceptable": study.verdict in made.verdicts_ok,
        "names above 0.5": " ".join(named),
        "wrong above 0.5": " ".join(wrong["slug"]), "wrong above 0.9": " ".join(sure["slug"]),
        "seconds": f"{time.perf_counter() - started:.1f}",
    }  # fmt: skip


def main() -> None:
    """Study the records and print a line for each."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.blind_records")
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[*names(), []], help="of records; all by default")
    parser.add_argument("-o", "--output", type=Path, default=Path("blind_records"), help="folder for records.csv")
    asked = parser.parse_args()
    asked.output.mkdir(parents=True, exist_ok=True)
    rows = []
    with (asked.output / "records.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="")
        writer.writeheader()
        for name in asked.names or names():
            rows.append(row_of(record(name)))
            writer.writerow(rows[-1])
            file.flush()
            print(" | ".join(str(rows[-1].get(column, "")) for column in COLUMNS))
    fine, wrong = sum(bool(row["acceptable"]) for row in rows), sum(bool(row.get("wrong above 0.9")) for row in rows)
    print(f"{fine} of {len(rows)} verdicts acceptable, {wrong} with a wrong name above {SURE}")


if __name__ == "__main__":
    main()
