"""Simulation-based calibration of every prior with every kernel on one small problem.

The problem has 40 rows of one state, with a gap in the middle of its range, and three terms of which two are nearly
collinear on half of the rows. A variant is finished when its file is there, so a stopped run goes on.
"""

import json
import os
from collections.abc import Callable, Mapping
from importlib.metadata import version
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
from bayes_greybox.running.plain_values import plain_rows, plain_values
from bayes_greybox.running.whole_files import write_text

from .files import unwritable, write_tables

PRIORS = {
    "spike-and-slab": SpikeAndSlab(),
    "spike-and-slab-gibbs": SpikeAndSlab(enumerate_up_to=0),
    "laplace": Laplace(),
    "regularised-horseshoe": RegularisedHorseshoe(),
    "normal": Normal(),
}
KERNELS = {
    "projected": OrthogonalGP(features=12),
    "conditioned": OrthogonalGP(features=12, variant="conditioned"),
    "none": OrthogonalGP(features=12, variant="none"),
}
TERMS = ("x", "x**2", "x**3")
ROWS = 40


def problem() -> Trajectories:
    """The rows: 24 in [−1, 0] and 16 in [0.5, 1]; the rates only fix the scale of the target, to one."""
    rng = np.random.default_rng(0)
    x = np.sort(np.concatenate([rng.uniform(-1, 0, 24), rng.uniform(0.5, 1, 16)]))
    rate = rng.standard_normal(ROWS)
    rate /= np.sqrt(np.mean(rate**2))
    return Trajectories.from_arrays(np.arange(float(ROWS)), states={"x": x}, derivatives={"x": rate})


def variants() -> dict[str, Program]:
    """Every prior with every kernel, the defaults first; then the box measure and Matérn for them.

    The printed kernel is no covariance, so nothing can be drawn from it. The exact path takes a hundred times as long;
    `calibrate` takes it too.
    """
    named = {
        f"{prior}_{kernel}": Program({"x": list(TERMS)}, prior=PRIORS[prior], discrepancy=KERNELS[kernel])
        for kernel in KERNELS
        for prior in PRIORS
    }
    others = {
        "box": OrthogonalGP(features=12, measure="box"),
        "matern52": OrthogonalGP(features=12, kernel="matern52"),
    }
    named |= {f"spike-and-slab_{name}": Program({"x": list(TERMS)}, discrepancy=gp) for name, gp in others.items()}
    return named


def run(
    output: str | os.PathLike[str],
    chosen: Mapping[str, Program] | None = None,
    *,
    replicates: int = 500,
    seed: int = 0,
    progress: bool = True,
    finished: Callable[[str, Calibration], None] = lambda name, found: None,
) -> pd.DataFrame:
    """Calibrate the variants, or what is left of them, and write their results.

    Args:
        output: Folder for NAME.json (settings, tests, inclusion, coverage) and NAME.csv (ranks on (0, 1)) of each
            variant, and for calibration.csv and summary.json with one row each.
        chosen: Variants by name; all of `variants()` by default.
        replicates: Replicates of each.
        seed: Seed.
        progress: Whether to show a progress bar.
        finished: Called with each calibration as soon as it is there (not for variants of an earlier run).

    Returns:
        A table by variant: passed, worst quantity, its adjusted p, ece and expected_ece (spike-and-slab), coverage of
        90 % bands of f by region, diverged (replicates with divergences) and seconds.

    Raises:
        InputError: A folder that cannot be written to; what `calibrate` refuses.
    """
    if replicates < FEWEST_REPLICATES:
        raise InputError(f"calibration with replicates={replicates} says nothing: give {FEWEST_REPLICATES} at least.")
    chosen = variants() if chosen is None else chosen
    settings = {"version": version("bayes-greybox"), "replicates": replicates, "seed": seed}
    folder = Path(output)
    records = {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, model in chosen.items():
            records[name] = _finished(folder / f"{name}.json", settings)
            if records[name] is None:
                found = calibrate(model, problem(), replicates=replicates, seed=seed, progress=progress)
                finished(name, found)
                records[name] = plain_values({**settings, **record(found)})
                write_text(folder / f"{name}.csv", found.pit.to_csv(index=False))
                write_text(folder / f"{name}.json", json.dumps(records[name], indent=2, allow_nan=False) + "\n")
        table = pd.DataFrame.from_dict({name: _row(part) for name, part in records.items()}, orient="index")
        table.index.name = "variant"
        write_tables(folder, {"calibration": table}, {**settings, "variants": plain_rows(table)})
    except OSError as error:
        raise unwritable(folder, error) from error
    return table


def subset(count: int | None) -> dict[str, Program]:
    """The first variants.

    Raises:
        InputError: There are fewer.
    """
    known = variants()
    if count is not None and count > len(known):
        raise InputError(f"There are {len(known)} variants to calibrate, not {count}.")
    return dict(list(known.items())[:count])


def record(found: Calibration) -> dict[str, Any]:
    """A calibration as plain tables."""
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


def _row(part: Mapping[str, Any]) -> dict[str, Any]:
    worst = min(part["tests"], key=lambda test: test["adjusted"])
    inclusion = part["inclusion"].get("x", {})
    coverage = {f"coverage_{row['region']}": row["coverage"] for row in part["coverage"] if row["level"] == 0.9}
    return {
        "passed": part["passed"],
        "worst": worst["quantity"],
        "adjusted": worst["adjusted"],
        "ece": inclusion.get("ece"),
        "expected_ece": inclusion.get("expected_ece"),
        **coverage,
        "diverged": part["diverged"],
        "seconds": part["seconds"],
    }


def _finished(file: Path, settings: Mapping[str, Any]) -> dict[str, Any] | None:
    """What an earlier run with the same settings left."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (FileNotFoundError, json.JSONDecodeError):
        return None
    return found if all(found.get(key) == value for key, value in settings.items()) else None
