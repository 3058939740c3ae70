"""The same hidden effects from a noisy displacement alone: no rate, no speed, what a user with one sensor has."""

import time
import zlib
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.trajectories import Trajectories
from benchmarks.hidden_effects.cases import HiddenCase, all_cases
from benchmarks.hidden_effects.generate import CaseData

from .study import all_roles, record

FAMILIES = ("catalogue", "null")
"""Families that are made of one effect of the catalogue, or of none."""


def displacement_cases(seed: int = 1) -> tuple[HiddenCase, ...]:
    """Cases of mechanical hosts of one degree of freedom, whose position a sensor could show.

    Args:
        seed: Of the cases.
    """
    known = (case for case in all_cases(seed) if case.family in FAMILIES and case.system.domain == "mechanical")
    return tuple(case for case in known if len(case.system.states) == 2)


def displacement(data: CaseData, noise: float) -> tuple[Trajectories, Trajectories]:
    """Training and held-out samples of the position with white noise, and the exact force.

    Args:
        data: The case's data; of its states the position alone is used, of its rates none.
        noise: Standard deviation over that of the position in the training data.
    """
    rng = np.random.default_rng(zlib.crc32(f"{data.case.key} {noise}".encode()))
    place = data.host.roles["position"]
    sd = noise * float(np.std(data.train.states[place]))
    return _shown(data.train, place, sd, rng), _shown(data.test, place, sd, rng)


def study_displacement(data: CaseData, noise: float, seed: int = 0) -> dict[str, Any]:
    """Run `find_missing_effects` on the displacement alone, and record what came out; see `study.Solve`.

    Args:
        data: The case's data.
        noise: Of the sensor, over the spread of the position.
        seed: Of the study.
    """
    # Imported here: these bring JAX, which the modules that make the data do without.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.missing_effects import find_missing_effects
    from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows

    start = time.perf_counter()
    train, test = displacement(data, noise)
    study = find_missing_effects(
        GreyBox(simulation=dict(data.simulation), dictionary={data.equation: []}, rows=TrajectoryRows()),
        train,
        test=test,
        catalogue=data.host.domain,
        roles=all_roles(data),
        seed=seed,
        settle=False,
        free_runs=False,
        progress=False,
    )
    seconds = time.perf_counter() - start
    return {**record(study, data), "closable": _closable(study.gap, data, test), "seconds": seconds}


def _closable(gap: pd.DataFrame, data: CaseData, test: Trajectories) -> float:
    """Share of the held-out mean square error of the samples that the true model closes; what it leaves is noise."""
    place = data.host.roles["position"]
    noise = float(np.mean((test.states[place] - data.test.states[place]) ** 2) / np.var(test.states[place]))
    return 1.0 - noise / float(gap.loc[("test", "sample NMSE", data.equation), "before"])


def _shown(data: Trajectories, place: str, sd: float, rng: np.random.Generator) -> Trajectories:
    y = data.states[place] + sd * rng.standard_normal(data.n_obs)
    runs = [data.run == r for r in range(data.n_run)]

    def parted(columns: Iterable[tuple[str, np.ndarray]]) -> dict[str, list[np.ndarray]]:
        return {name: [values[own] for own in runs] for name, values in columns}

    names = ("t", place, *data.input_names)
    return Trajectories.from_arrays(
        [data.time[own] for own in runs],
        states=parted([(place, y)]),
        inputs=parted(data.inputs.items()),
        units={name: unit for name, unit in data.units.items() if name in names},
        constant="keep",
    )
