"""The results of the benchmarks as tables for a terminal."""

from collections.abc import Iterator

import pandas as pd
from rich.console import Group, RenderableType

from bayes_greybox.report.terminal.tables import frame_table
from benchmarks.confounding.score import Confounding
from benchmarks.hidden_effects.scoring.case_scores import SOLVERS
from benchmarks.hidden_effects.scoring.score import Scores
from benchmarks.sampled_traps.run import counts

_ASSUMPTIONS = {
    "cases": "cases",
    "wrong above 0.9": "wrong > 0.9",
    "wrong": "wrong",
    "right": "right",
    "silent": "silent",
    "unknown": "unknown",
    "instrument found": "instr.",
    "claim denied": "denied",
    "free run before": "before",
    "free run after": "after",
    "stlsq wrong": "STLSQ wrong",
    "stlsq right": "right ",
}

_TRAPS = {
    "verdict": "verdict",
    "likeliest": "likeliest",
    "probability": "P",
    "wrong": "wrong",
    "right": "right",
    "seconds": "s",
}

_SPEED = {
    "theta_rate": "θ/s",
    "eta_rate": "η/s",
    "ratio": "times",
    "ratio_cpu": "CPU",
    "gradients": "grad.",
    "first": "first",
    "seconds": "s",
    "memory": "MB",
    "r_hat": "R̂",
    "off": "off",
    "end": "",
}

_SHOWN = ["cases", *SOLVERS, "right or tied", "closed", "seconds"]


def benchmark_tables(scores: Scores) -> Iterator[RenderableType]:
    """Right answers of the study and of those it is compared with, then what must hold."""
    if len(scores.families):
        title = "Share of right answers; gap closed, of what the true model closes"
        yield Group(frame_table(title, scores.families.loc[:, _SHOWN]), "")
    if len(scores.assumptions):
        shown = scores.assumptions.loc[:, list(_ASSUMPTIONS)].rename(columns=_ASSUMPTIONS)
        yield Group(frame_table("Broken assumptions: shares of cases; error of the held-out free run", shown), "")
    yield frame_table("What must hold", scores.bars)


def calibration_tables(table: pd.DataFrame) -> Iterator[RenderableType]:
    """Verdict and worst test of each variant."""
    yield frame_table("Simulation-based calibration", table.loc[:, ["passed", "worst", "adjusted", "seconds"]])


def sampled_tables(table: pd.DataFrame) -> Iterator[RenderableType]:
    """Names, coverage and held-out error of each system."""
    title = "Effects found from samples of one state; coverage of 90 % intervals; held-out error over the sensor's"
    yield frame_table(title, table)


def trap_tables(table: pd.DataFrame) -> Iterator[RenderableType]:
    """What the study says of each trap, then counts."""
    # Words, and not slugs: they may be broken to fit the terminal.
    shown = table.loc[:, list(_TRAPS)].replace({"likeliest": "-", "wrong": "-"}, " ", regex=True).rename(columns=_TRAPS)
    yield Group(frame_table("Traps and controls: likeliest effect, wrong names", shown), "")
    yield frame_table("Counts", counts(table))


def map_tables(table: pd.DataFrame) -> Iterator[RenderableType]:
    """Names, controls, coverage and held-out error of each map."""
    title = "Effects found from outputs; coverage of 90 % intervals; held-out error over that of the noise"
    yield frame_table(title, table)


def memory_tables(table: pd.DataFrame) -> Iterator[RenderableType]:
    """Names, wrong names and coverage of each kind of machine."""
    title = "Effects with memory found from samples of a position; counts of cases, coverage of 90 % intervals"
    yield frame_table(title, table)


def pendulum_tables(table: pd.DataFrame) -> Iterator[RenderableType]:
    """What was said of each record, and free runs from two starts; then the names."""
    title = "Errors of the position in free runs, mm: of the record, of another start, of the simulation alone"
    yield frame_table(title, table.reindex(columns=["verdict", "train", "unseen", "before", "covered", "seconds"]))
    yield Group("", frame_table("What is added, with its probability", table.reindex(columns=["names", "wrong"])))


def way_tables(table: pd.DataFrame, against: pd.DataFrame) -> Iterator[RenderableType]:
    """What each way of choosing the next experiment came to, then what the information is better by."""
    yield Group(frame_table("Ties after one more run: share of right names, probability of the truth", table), "")
    shown = against.reset_index("score").rename(columns={"ours alone": "ours", "other alone": "other"})
    yield frame_table("By how much the expected information is better; 95 % intervals", shown)


def coverage_tables(table: pd.DataFrame) -> Iterator[RenderableType]:
    """Coverage of each coefficient by noise and kind of rows."""
    title = "Share of 90 % intervals that hold the truth, of each coefficient; bias in SDs; SD of the last"
    yield frame_table(title, table)


def confounding_tables(scores: Confounding) -> Iterator[RenderableType]:
    """Bias, coverage and trade-off of each kernel, and how its chains moved; then the coefficients by situation."""
    cells = scores.cells.reset_index().set_index("situation")
    cells = cells.rename(columns={"coverage": "covers", "correlation": "|corr|", "ess_per_second": "ESS/s"})
    title = "Worst bias in SDs, worst coverage of 90 % intervals, |corr(θ, f)|, chains"
    shown = ["kernel", "measure", "bias", "covers", "|corr|", "converged", "ESS/s"]
    yield frame_table(title, cells.loc[:, shown])
    for situation, terms in scores.terms.groupby(level="situation", sort=False):
        table = terms.reset_index().set_index("kernel")
        table = table.rename(
            columns={"projection": "proj.", "coverage": "covers θ", "coverage_projection": "θ + proj."}
        )
        columns = ["measure", "term", "proj.", "bias", "sd", "covers θ", "θ + proj."]
        yield Group("", frame_table(f"Coefficients, {situation}", table.loc[:, columns]))


def speed_tables(table: pd.DataFrame, floor: pd.DataFrame) -> Iterator[RenderableType]:
    """Each problem's contenders, then what is near the machine's own speed."""
    for problem, own in table.groupby(level="problem", sort=False):
        shown = own.droplevel("problem").loc[:, list(_SPEED)].rename(columns=_SPEED)
        yield Group(frame_table(f"{problem}: effective draws a second of θ and η, cold", shown), "")
    yield frame_table("Seconds of the processor, beside those of the machine's own routines", floor)


def weak_tables(table: pd.DataFrame) -> Iterator[RenderableType]:
    """Terms, errors and coverage of each system at each level of noise."""
    title = "Terms from samples of all states; relative error of the coefficients; coverage of 90 % intervals"
    shown = ["exact", "TPR", "error", "published", "efficient", "coverage"]
    named = table.reset_index(level="noise").loc[:, ["noise", *shown]]
    yield frame_table(title, named)


def ode_tables(table: pd.DataFrame) -> Iterator[RenderableType]:
    """Errors of the parameters of each cell beside what others published."""
    title = "Relative error of the parameters; median of an efficient estimator, and published medians"
    yield frame_table(title, table)
