"""The results of the benchmarks as tables for a terminal."""

from collections.abc import Iterator

import pandas as pd
from rich.console import Group, RenderableType

from bayes_greybox.benchmarks.confounding.score import Confounding
from bayes_greybox.benchmarks.hidden_effects.marks import SOLVERS
from bayes_greybox.benchmarks.hidden_effects.score import Scores

from .terminal import frame_table

_SHOWN = ["cases", *SOLVERS, "right or tied", "closed", "seconds"]


def benchmark_tables(scores: Scores) -> Iterator[RenderableType]:
    """Right answers of the study and of those it is compared with, then what must hold."""
    title = "Share of right answers; gap closed, of what the true model closes"
    yield frame_table(title, scores.families.loc[:, _SHOWN])
    yield Group("", frame_table("What must hold", scores.bars))


def calibration_tables(table: pd.DataFrame) -> Iterator[RenderableType]:
    """Verdict and worst test of each variant."""
    yield frame_table("Simulation-based calibration", table.loc[:, ["passed", "worst", "adjusted", "seconds"]])


def confounding_tables(scores: Confounding) -> Iterator[RenderableType]:
    """Bias, coverage and trade-off of each kernel, and how its chains moved; then the coefficients one by one."""
    yield frame_table(
        "Bias in posterior SDs, coverage of 90 % intervals, |corr(θ, f)|, chains", _by_situation(scores.cells)
    )
    yield Group("", frame_table("Coefficients", _by_situation(scores.terms)))


def _by_situation(table: pd.DataFrame) -> pd.DataFrame:
    return table.reset_index().set_index("situation")
