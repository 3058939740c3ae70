"""Study every record with default settings: `python -m benchmarks.measured_records FOLDER [NAME ...]`."""

import argparse
import csv
import time
from pathlib import Path

import bayes_greybox as bg

from .records import READ, Record, records

LIKELY = 0.3
"""Effects, corrections and kinds of what is left that are likelier are listed."""

COLUMNS = ("record", "samples", "verdict", "effects", "corrections", "kind of what is left", "right", "seconds", "says")


def row_of(name: str, record: Record) -> dict[str, object]:
    """Return what was said of a record, and how long it took; no posterior is sampled."""
    model = bg.GreyBox(
        simulation=record.simulation, dictionary={record.equation: []},
        **({"rows": bg.TrajectoryRows()} if record.sampled else {}),
    )  # fmt: skip
    started = time.perf_counter()
    study = bg.find_missing_effects(
        model, record.data, catalogue=record.catalogue, roles=record.roles or None, settle=False, free_runs=False,
        progress=False,
    )  # fmt: skip
    seconds = time.perf_counter() - started
    effects = study.effects[study.effects["probability"] > LIKELY]
    corrections = study.corrections[study.corrections["probability"] > LIKELY].reset_index()
    left = study.memory[study.memory["probability"] > LIKELY].reset_index()
    return {
        "record": name, "samples": record.data.n_obs, "verdict": study.verdict,
        "effects": _listed(effects["slug"], effects["probability"]),
        "corrections": _listed(corrections["term"], corrections["probability"]),
        "kind of what is left": _listed(left["memory"], left["probability"]),
        "right": record.right, "seconds": f"{seconds:.1f}", "says": study.sentence,
    }  # fmt: skip


def _listed(names, probabilities) -> str:  # noqa: ANN001
    return ", ".join(f"{name} {p:.2f}" for name, p in zip(names, probabilities, strict=True))


def main() -> None:
    """Study the records and print a line for each."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.measured_records")
    parser.add_argument("folder", type=Path, help="where the files are")
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[*READ, []], help="of records; all by default")
    parser.add_argument("-o", "--output", type=Path, default=Path("measured_records"), help="folder for records.csv")
    asked = parser.parse_args()
    asked.output.mkdir(parents=True, exist_ok=True)
    with (asked.output / "records.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        for name, record in records(asked.folder, asked.names):
            row = row_of(name, record)
            writer.writerow(row)
            file.flush()
            print(" | ".join(str(row[column]) for column in COLUMNS), flush=True)


if __name__ == "__main__":
    main()
