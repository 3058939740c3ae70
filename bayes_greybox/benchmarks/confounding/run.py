"""The study from cells to tables: one line of JSON for each finished cell, so that a stopped run goes on."""

import json
import os
from collections.abc import Sequence
from importlib.metadata import version
from itertools import product
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from threadpoolctl import threadpool_limits

from bayes_greybox.data.errors import InputError

from .cells import KERNELS, Cell, measure_cell
from .score import Confounding, score
from .situations import SITUATIONS

REPLICATES, DRAWS, TUNE = 40, 400, 300
"""Of the full size."""

RESULTS = "results.jsonl"


def all_cells(replicates: int = REPLICATES, seed: int = 0, draws: int = DRAWS, tune: int = TUNE) -> tuple[Cell, ...]:
    """Every situation under every kernel.

    Args:
        replicates: Data sets of each cell.
        seed: Seed of data and sampler.
        draws: Draws kept of each of the two chains.
        tune: Warm-up iterations.
    """
    return tuple(
        Cell(situation.name, variant, measure, replicates, draws, tune, seed)
        for situation, (variant, measure) in product(SITUATIONS, KERNELS)
    )


def run(output: str | os.PathLike[str], cells: Sequence[Cell] | None = None, *, progress: bool = True) -> Confounding:
    """Run the study, or what is left of it, and write its tables.

    Args:
        output: Folder for results.jsonl, terms.csv, cells.csv and summary.json. Cells that results.jsonl has are not
            run again, unless another version of the package ran them.
        cells: The cells; those of `all_cells()` by default.
        progress: Whether to show a progress bar.

    Returns:
        The scores of the given cells.

    Raises:
        InputError: No cells; a folder that cannot be written to.
    """
    chosen = tuple(all_cells() if cells is None else cells)
    if not chosen:
        raise InputError("The confounding study needs at least one cell.")
    folder = Path(output)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = folder / RESULTS
        rows = _finished(file)
        columns = (TextColumn("Confounding"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        bar = Progress(*columns, console=Console(stderr=True), disable=not progress)
        # Threads inside BLAS fight those of the chains over the cores, for matrices too small to share.
        with bar, threadpool_limits(1):
            for cell in bar.track(chosen, description="cells"):
                if cell.key not in rows:
                    rows[cell.key] = {"version": version("bayes-greybox"), **measure_cell(cell)}
                    with file.open("a", encoding="utf-8") as lines:
                        lines.write(json.dumps(rows[cell.key], allow_nan=False) + "\n")
        scores = score(rows[cell.key] for cell in chosen)
        tables = {"terms": scores.terms.reset_index(), "cells": scores.cells.reset_index()}
        for name, table in tables.items():
            table.to_csv(folder / f"{name}.csv", index=False)
        summary = {name: json.loads(table.to_json(orient="records") or "[]") for name, table in tables.items()}
        text = json.dumps({"version": version("bayes-greybox"), **summary}, indent=2)
        (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(
            f'Cannot write to the folder "{folder}" ({error.strerror or error}); choose another.'
        ) from error
    return scores


def _finished(file: Path) -> dict[str, dict]:
    """Cells by key; lines that were cut off, and those of another version, are left out."""
    rows: dict[str, dict] = {}
    if not file.exists():
        return rows
    text = file.read_text(encoding="utf-8")
    if text and not text.endswith("\n"):
        # What a stopped run began to write must not swallow the next line.
        file.write_text(text[: text.rfind("\n") + 1], encoding="utf-8")
    for line in text.splitlines():
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        if row.get("version") == version("bayes-greybox"):
            rows[row["key"]] = row
    return rows
