"""Tables of the confounding study: coefficients against the truth, and how well the chains moved."""

from collections.abc import Iterable, Mapping
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.runner import Asked, Benchmark, Case, Tables

from .cells import KERNELS, Cell, converged, measure_cell
from .situations import SITUATIONS

CELL = ["situation", "kernel", "measure"]


def cases(asked: Asked, draws: int = 400, tune: int = 300) -> list[Case]:
    """Return every situation under every kernel, with draws kept of each of the two chains and warm-up iterations."""
    cells = [
        Cell(situation.name, variant, measure, asked.replicates, draws, tune, asked.seed)
        for situation, (variant, measure) in product(SITUATIONS, KERNELS)
    ]
    return [Case(cell.key, (cell,)) for cell in cells]


def score(records: Iterable[Mapping[str, Any]]) -> Tables:
    """Return the coefficients and the cells.

    Terms are indexed by (situation, kernel, measure, term): theta (true), projection (addition of the missing part to
    it by least squares under the measure), bias (mean posterior mean less theta), bias_se, sd (mean posterior standard
    deviation), coverage (share of 90 % intervals that hold theta) and coverage_projection (that hold theta +
    projection).

    Cells are indexed by (situation, kernel, measure): replicates, bias (largest |bias| over terms, in mean posterior
    standard deviations), coverage (of the term where it is farthest from 90 %), correlation (median of the largest
    |corr(θ, f-projection)|), r_hat (median of the worst), r_hat_90 (its 90 % quantile), converged (share that passes
    R̂, effective sample size and divergences), ess_per_second (median of the smallest; compilation left out), overlap
    (share of the missing part that the dictionary can copy).
    """
    terms, cells = [], []
    names = {situation.name: tuple(situation.theta) for situation in SITUATIONS}
    for row in records:
        measure = "–" if row["variant"] == "none" else row["measure"]
        key = {"situation": row["situation"], "kernel": row["variant"], "measure": measure}
        truth, added = np.array(row["theta"]), np.array(row["projected"])
        mean, sd, lower, upper = (np.array(row[name]) for name in ("mean", "sd", "lower", "upper"))
        found = pd.DataFrame(
            {
                **key,
                "term": names[row["situation"]],
                "theta": truth,
                "projection": added,
                "bias": mean.mean(axis=0) - truth,
                "bias_se": mean.std(axis=0, ddof=1) / np.sqrt(len(mean)) if len(mean) > 1 else np.nan,
                "sd": sd.mean(axis=0),
                "coverage": np.mean((lower <= truth) & (truth <= upper), axis=0),
                "coverage_projection": np.mean((lower <= truth + added) & (truth + added <= upper), axis=0),
            }
        )
        terms.append(found)
        passed = [converged(*each) for each in zip(row["r_hat"], row["ess"], row["divergences"], strict=True)]
        farthest = int(np.argmax(np.abs(found["coverage"] - 0.9)))
        cells.append(
            {
                **key,
                "replicates": len(mean),
                "bias": float(np.max(np.abs(found["bias"] / found["sd"]))),
                "coverage": float(found["coverage"].iloc[farthest]),
                "correlation": float(np.median(row["correlation"])),
                "r_hat": float(np.median(row["r_hat"])),
                "r_hat_90": float(np.quantile(row["r_hat"], 0.9)),
                "converged": float(np.mean(passed)),
                "ess_per_second": float(np.median(row["ess"])) / row["seconds"] if row["seconds"] > 0 else np.nan,
                "overlap": row["overlap"],
            }
        )
    return {"terms": pd.concat(terms).set_index([*CELL, "term"]), "cells": pd.DataFrame(cells).set_index(CELL)}


def show(tables: Tables) -> dict[str, pd.DataFrame]:
    """Return bias, coverage and trade-off of each kernel, and how its chains moved; then coefficients by situation."""
    renamed = {"coverage": "covers", "correlation": "|corr|", "ess_per_second": "ESS/s"}
    cells = tables["cells"].reset_index().set_index("situation").rename(columns=renamed)
    title = "Worst bias in SDs, worst coverage of 90 % intervals, |corr(θ, f)|, chains"
    shown = {title: cells.loc[:, ["kernel", "measure", "bias", "covers", "|corr|", "converged", "ESS/s"]]}
    renamed = {"projection": "proj.", "coverage": "covers θ", "coverage_projection": "θ + proj."}
    for situation, terms in tables["terms"].groupby(level="situation", sort=False):
        table = terms.reset_index().set_index("kernel").rename(columns=renamed)
        columns = ["measure", "term", "proj.", "bias", "sd", "covers θ", "θ + proj."]
        shown[f"Coefficients, {situation}"] = table.loc[:, columns]
    return shown


def figure(folder: Path, tables: Tables) -> None:
    """Draw the coefficients."""
    from bayes_greybox.report.plots import plot_confounding, save_figures

    save_figures({"confounding": plot_confounding(tables["terms"])}, folder)


CONFOUNDING = Benchmark(
    "confounding",
    "fits repeated data under each kernel and says what orthogonality gives and costs.",
    {"replicates": 40, "seed": 0},
    cases,
    measure_cell,
    score,
    show,
    # Threads inside BLAS fight those of the chains over the cores, for matrices too small to share.
    threads=1,
    finish=figure,
)
