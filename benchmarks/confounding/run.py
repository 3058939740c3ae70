"""The study from cells to tables: one line of JSON for each finished cell, so that a stopped run goes on."""

import os
from collections.abc import Sequence
from itertools import product
from pathlib import Path

from threadpoolctl import threadpool_limits

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.plain_values import plain_rows
from benchmarks.files import unwritable, write_tables
from benchmarks.resumed import resumed

from .cells import KERNELS, Cell, measure_cell
from .score import Confounding, score
from .situations import SITUATIONS

REPLICATES, DRAWS, TUNE = 40, 400, 300
"""Of the full size."""


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
        # Threads inside BLAS fight those of the chains over the cores, for matrices too small to share.
        with threadpool_limits(1):
            rows = resumed(
                folder,
                chosen,
                key=lambda cell: cell.key,
                measure=measure_cell,
                what="Confounding",
                progress=progress,
            )
        scores = score(rows)
        tables = {"terms": scores.terms, "cells": scores.cells}
        write_tables(folder, tables, {name: plain_rows(table) for name, table in tables.items()})
    except OSError as error:
        raise unwritable(folder, error) from error
    return scores
