"""Simulation-based calibration of every prior with every kernel on one small problem.

The problem has 40 rows of one state, with a gap in the middle of its range, and three terms of which two are nearly
collinear on half of the rows.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.criticism.calibration.calibrate import FEWEST_REPLICATES, Calibration, calibrate
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.priors import Laplace, Normal, RegularisedHorseshoe, SpikeAndSlab
from bayes_greybox.model.program import Program
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.plain_values import plain_values
from bayes_greybox.running.whole_files import write_text
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables

PRIORS = {
    "spike-and-slab": SpikeAndSlab(),
    "spike-and-slab-gibbs": SpikeAndSlab(enumerate_up_to=0),
    "laplace": Laplace(),
    "regularised-horseshoe": RegularisedHorseshoe(),
    "normal": Normal(),
}
DISCREPANCIES = {
    "projected": OrthogonalGP(features=12),
    "conditioned": OrthogonalGP(features=12, variant="conditioned"),
    "none": OrthogonalGP(features=12, variant="none"),
}


def problem() -> Trajectories:
    """Return the rows: 24 in [−1, 0] and 16 in [0.5, 1]; the rates only fix the scale of the target, to one."""
    rng = np.random.default_rng(0)
    x = np.sort(np.concatenate([rng.uniform(-1, 0, 24), rng.uniform(0.5, 1, 16)]))
    rate = rng.standard_normal(40)
    rate /= np.sqrt(np.mean(rate**2))
    return Trajectories.from_arrays(np.arange(40.0), states={"x": x}, derivatives={"x": rate})


def variants() -> dict[str, Program]:
    """Return every prior with every kernel, the defaults first; then the box measure and Matérn for them.

    The printed kernel is no covariance, so nothing can be drawn from it. The exact path takes a hundred times as long;
    `calibrate` takes it too.
    """
    terms = {"x": ["x", "x**2", "x**3"]}
    others = {
        "box": OrthogonalGP(features=12, measure="box"),
        "matern52": OrthogonalGP(features=12, kernel="matern52"),
    }
    return {
        **{
            f"{prior}_{kernel}": Program(terms, prior=PRIORS[prior], discrepancy=DISCREPANCIES[kernel])
            for kernel in DISCREPANCIES
            for prior in PRIORS
        },
        **{f"spike-and-slab_{name}": Program(terms, discrepancy=gp) for name, gp in others.items()},
    }


def cases(asked: Asked) -> list[Case]:
    """Return the first variants.

    Raises:
        InputError: There are fewer; so few replicates say nothing.
    """
    known = variants()
    if asked.cases is not None and asked.cases > len(known):
        raise InputError(f"There are {len(known)} variants to calibrate, not {asked.cases}.")
    if asked.replicates < FEWEST_REPLICATES:
        few = f"calibration with replicates={asked.replicates} says nothing"
        raise InputError(f"{few}: give {FEWEST_REPLICATES} at least.")
    return [
        Case(
            f"{name}/{asked.replicates}/{asked.seed}",
            (name, asked.replicates, asked.seed, Path(asked.folder), asked.progress),
            {"variant": name},
        )
        for name in list(known)[: asked.cases]
    ]


def calibrated(name: str, replicates: int, seed: int, folder: Path, progress: bool) -> dict[str, Any]:
    """Calibrate a variant, write its ranks on (0, 1) and its figure, and return tests, inclusion and coverage."""
    from bayes_greybox.report.plots import calibration, save_figures

    found = calibrate(variants()[name], problem(), replicates=replicates, seed=seed, progress=progress)
    save_figures({name: calibration(found)}, folder / "figures")
    write_text(folder / f"{name}.csv", found.pit.to_csv(index=False))
    return plain_values(record(found))


def record(found: Calibration) -> dict[str, Any]:
    """Return a calibration as plain tables."""
    return {
        "passed": found.verdict.ok,
        "reasons": found.verdict.reasons,
        "level": found.level,
        "tests": found.tests.reset_index().to_dict("records"),
        "ess": found.ess.to_dict(),
        "coverage": found.coverage.reset_index().to_dict("records"),
        "inclusion": {
            name: {
                "ece": part.ece,
                "expected_ece": part.expected_ece,
                "p": part.p,
                "bins": part.bins.to_dict("records"),
                "terms": part.terms.reset_index().to_dict("records"),
            }
            for name, part in found.inclusion.items()
        },
        "diverged": int(np.sum(found.divergences > 0)),
        "seconds": found.seconds,
    }


def score(records: list[Record]) -> Tables:
    """Return a row for each variant.

    Its columns are passed, worst quantity, its adjusted p, ece and expected_ece (spike-and-slab), coverage of 90 %
    bands of f by region, diverged (replicates with divergences) and seconds.
    """
    return {"calibration": pd.DataFrame([_row(record) for record in records]).set_index("variant")}


def _row(record: Record) -> Record:
    worst = min(record["tests"], key=lambda test: test["adjusted"])
    inclusion = record["inclusion"].get("x", {})
    coverage = {f"coverage_{row['region']}": row["coverage"] for row in record["coverage"] if row["level"] == 0.9}
    return {
        "variant": record["variant"],
        "passed": record["passed"],
        "worst": worst["quantity"],
        "adjusted": worst["adjusted"],
        "ece": inclusion.get("ece"),
        "expected_ece": inclusion.get("expected_ece"),
        **coverage,
        "diverged": record["diverged"],
        "seconds": record["seconds"],
    }


CALIBRATION = Benchmark(
    "calibration",
    "draws truths from every prior with every kernel and tests whether they lie among the posterior draws as they "
    "should.",
    {"cases": None, "replicates": 500, "seed": 0},
    cases,
    calibrated,
    score,
    lambda tables: {
        "Simulation-based calibration": tables["calibration"].loc[:, ["passed", "worst", "adjusted", "seconds"]]
    },
)
