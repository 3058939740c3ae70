"""A real study, as small as it can be: a forced oscillator whose cubic spring was not in the simulation."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.criticism.convergence import Verdict, convergence
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.greybox import Fit, GreyBox
from bayes_greybox.missing_effects import Study, find_missing_effects
from bayes_greybox.model.gp.discrepancy import OrthogonalGP

SIMULATION = {"y": "ydot", "ydot": "F - y - 0.1*ydot"}


def oscillator(n: int = 60, seed: int = 0) -> Trajectories:
    """Two forced runs of y'' = F − y − 0.1 y' − 0.8 y³, by Euler's method; a row every 20 steps."""
    rng = np.random.default_rng(seed)
    times, columns = [], {"y": [], "ydot": [], "a": [], "F": []}
    step = 0.01
    for run in range(2):
        y, v, path = 0.2, 0.0, []
        for s in step * np.arange(20 * (n // 2)):
            force = 0.9 * np.cos((0.9 + 0.25 * run) * s + seed) + 0.3 * np.sin(0.31 * s)
            a = force - y - 0.1 * v - 0.8 * y**3
            path.append((y, v, a, force))
            y, v = y + step * v, v + step * a
        rows = np.array(path)[::20]
        rows[:, 2] += 0.02 * rng.standard_normal(len(rows))
        times.append(20 * step * np.arange(len(rows)))
        for name, column in zip(columns, rows.T, strict=True):
            columns[name].append(column)
    return Trajectories.from_arrays(
        times,
        states={"y": columns["y"], "ydot": columns["ydot"]},
        derivatives={"ydot": columns["a"]},
        inputs={"F": columns["F"]},
        units={"t": "s", "y": "m", "ydot": "m/s", "F": "m/s**2"},
        run_names=["slow sweep", "fast sweep"],
    )


@cache
def tiny_study() -> Study:
    """The study; made once, and varied by `dataclasses.replace`."""
    model = GreyBox(simulation=SIMULATION, discrepancy=OrthogonalGP(variables=("y", "ydot"), features=4))
    study = find_missing_effects(
        model, oscillator(), oscillator(seed=1), draws=60, tune=60, chains=2, seed=0, progress=False
    )
    # A hundred draws cannot have converged; whether they have is not what is tested here.
    return replace(study, fit=judged(study.fit, True))


def judged(fit: Fit, ok: bool, short: bool = False) -> Fit:
    """The fit as if its chains had, or had not, passed the convergence checks, or all but that of the tail."""
    reasons = () if ok else ("R̂ is 1.04 for ydot_sigma: sample longer (draws=2000).", "12 divergences; raise tune.")
    if short:
        reasons = ("The tail effective sample size is 398 for ydot_sigma, below 400: raise draws to about 700.",)
    again = replace(fit)
    again.memory[f"{convergence.__module__}.{convergence.__qualname__}"] = Verdict(ok, reasons, short)
    return again


DELAYED: dict[str, Any] = {
    "equation": "ydot", "suspect": "delay", "channel": "d(ydot)/dt", "probability": 0.99, "mean": 0.1, "sd": 0.01,
    "lower": 0.084, "upper": 0.116, "unit": "s", "samples": 0.5, "lower_samples": 0.42, "upper_samples": 0.58,
    "status": "in the model", "text": "d(ydot)/dt is 0.1 s late (0.5 samples)",
}  # fmt: skip
"""A row of `study.instrument`: the measured rate is half a sample late."""


def varied(
    study: Study,
    instrument: Mapping[str, Any] | None = None,
    checks: Mapping[str, tuple[float, str]] | None = None,
    **changes: Any,
) -> Study:
    """The study as if a delay had been found, or checks had failed.

    Args:
        study: The study.
        instrument: What the delay has beyond `DELAYED`; None for no delay.
        checks: p-value and text of each failed check, which the verdict heeds.
        changes: Further attributes.
    """
    if instrument is not None:
        changes["instrument"] = pd.DataFrame([{**DELAYED, **instrument}])
    if checks:
        table = study.checks.copy()
        for name, (p, text) in checks.items():
            table.loc[("ydot", name), ["p", "ok", "text"]] = (p, False, text)
        changes = {"verdict": "partly named", "against": tuple(text for _, text in checks.values()), **changes}
        changes["checks"] = table
    return replace(study, **changes)
