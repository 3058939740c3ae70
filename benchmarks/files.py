"""Files of benchmarks: whole or absent."""

import json
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.whole_files import write_text


def write_tables(folder: Path, tables: Mapping[str, pd.DataFrame], about: Mapping[str, Any]) -> None:
    """Write tables as CSV, and what they are of to summary.json.

    Args:
        folder: Where all go.
        tables: By the name of their file, without its ending; with named indices.
        about: Size, seed and whatever else belongs beside them.
    """
    for name, table in tables.items():
        write_text(folder / f"{name}.csv", table.reset_index().to_csv(index=False))
    summary = {"version": version("bayes-greybox"), **about}
    write_text(folder / "summary.json", json.dumps(summary, indent=2) + "\n")


def opened(file: Path) -> dict[str, dict[str, Any]]:
    """Finished rows of a file of JSON lines by their key; of several lines with one key the last counts.

    The folder is made where it is missing, and the file left with whole lines only: without those that were cut off,
    and those of another version of the package.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    rows = {}
    for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        if row.get("version") == version("bayes-greybox"):
            rows[row["key"]] = row
    write_text(file, "".join(json.dumps(row) + "\n" for row in rows.values()))
    return rows


def unwritable(folder: Path, error: OSError) -> InputError:
    """What to say of a folder that cannot be written to."""
    return InputError(f'Cannot write to the folder "{folder}" ({error.strerror or error}); choose another one.')
