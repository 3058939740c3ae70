"""The same hidden effects from a noisy displacement alone, without rate and speed, as of a user with one sensor."""

import zlib
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.trajectories import Trajectories
from benchmarks.answers import studied
from benchmarks.hidden_effects.cases import HiddenCase, all_cases
from benchmarks.hidden_effects.generate import CaseData

from .study import all_roles, record


def displacement_cases(seed: int = 1) -> tuple[HiddenCase, ...]:
    """Return cases of mechanical hosts of one degree of freedom, with one effect of the catalogue or none."""
    return tuple(
        case
        for case in all_cases(seed)
        if case.family in ("catalogue", "null") and case.system.domain == "mechanical" and len(case.system.states) == 2
    )


def displacement(data: CaseData, noise: float) -> tuple[Trajectories, Trajectories]:
    """Sample the position of both data sets with noise over its spread in the training data, beside the exact force."""
    rng = np.random.default_rng(zlib.crc32(f"{data.case.key} {noise}".encode()))
    place = data.host.roles["position"]
    sd = noise * float(np.std(data.train.states[place]))
    return _shown(data.train, place, sd, rng), _shown(data.test, place, sd, rng)


def study_displacement(data: CaseData, noise: float, seed: int = 0) -> dict[str, Any]:
    """Study the displacement alone, with noise over the spread of the position, and record the answer; see `study`."""
    # Imported here: these bring JAX, which the modules that make the data do without.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows

    train, test = displacement(data, noise)
    model = GreyBox(simulation=dict(data.simulation), dictionary={data.equation: []}, rows=TrajectoryRows())
    about: dict[str, Any] = {"test": test, "catalogue": data.host.domain, "roles": all_roles(data), "seed": seed}
    study, seconds = studied(model, train, free_runs=False, **about)
    return {**record(study, data), "closable": _closable(study.gap, data, test), "seconds": seconds}


def _closable(gap: pd.DataFrame, data: CaseData, test: Trajectories) -> float:
    """Return the share of the held-out mean square error of the samples that the true model closes, all but noise."""
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
