"""Studies of the pendulum on a spring: names, and free runs from two starts."""

import functools
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.trajectories import Trajectories
from benchmarks.answers import Answer, studied
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables, replicated

from .plant import NAMES, plant
from .truth import PENDULUM_STEP, path, truth, without_friction

TRAIN, UNSEEN = ((0.5, 0.0), 5.0), ((1.0, -1.5), 4.0)
"""Start and last time of the record that is learned from and of the other one, of the demonstration's two examples."""

FREE_RUN_STEPS = 5
"""Steps of a free run between two samples."""

LIKELY = 0.05
"""Probability from which an effect that was not added is written down."""

DEFAULT, ALL = 3, 4
"""Most effects that a study adds by default, and as many as the simulation lacks."""


@dataclass(frozen=True)
class Pendulum:
    """A study.

    Attributes:
        name: Name of the study.
        noise: Noise of the position, in m.
        effects: Most effects that are added.
        lacks: True if the simulation lacks anything; of a control, the data are its own.
        placed: True if the simulation knows where the wall is, so that it lacks friction alone.
    """

    name: str
    noise: float
    effects: int
    lacks: bool = True
    placed: bool = False

    def path(self, start: tuple[float, float], end: float) -> tuple[np.ndarray, np.ndarray]:
        """Return times, and positions and speeds, as `truth.path` does."""
        return (path if self.lacks else without_friction)(start, end)

    @property
    def truth(self) -> dict[str, float]:
        """Coefficients of the effects that the simulation lacks."""
        known = {"constant-force"} if self.placed else set()
        return {slug: value for slug, value in truth().items() if slug not in known} if self.lacks else {}


def pendulums() -> dict[str, Pendulum]:
    """Return all studies by name."""
    every = []
    for noise in (1e-3, 5e-3):
        level = f"{1000 * noise:g}-mm"
        every += [Pendulum(f"{level}-{effects}-effects", noise, effects) for effects in (ALL, DEFAULT)]
        every.append(Pendulum(f"{level}-wall-known", noise, DEFAULT, placed=True))
        every.append(Pendulum(f"{level}-nothing", noise, DEFAULT, lacks=False))
    return {each.name: each for each in every}


def cases(asked: Asked) -> list[Case]:
    """Return the replicates of the chosen studies.

    Raises:
        InputError: FMPy or a C compiler is missing.
    """
    names = asked.names(pendulums(), "case")
    _plant()
    # A stopped run has some of all.
    return sorted(replicated("case", names, asked), key=lambda case: case.arguments[1])


def study(name: str, replicate: int, seed: int) -> dict[str, Any]:
    """Return the answer of the study of a replicate, and how far its free runs are off."""
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.physics.simulation.fmu.given import FMU

    case = pendulums()[name]
    simulation = FMU(_plant()[1], {"fixed.s0": 0.0} if case.placed else {}, NAMES)
    found, seconds = studied(
        GreyBox(simulation=simulation),
        sampled(case, TRAIN, (seed, replicate, 0)),
        test=sampled(case, UNSEEN, (seed, replicate, 1)),
        effects_at_most=case.effects,
        free_runs=False,
    )
    probabilities = dict(zip(found.effects["slug"], map(float, found.effects["probability"]), strict=True))
    laws: dict[Any, float] = found.quantities["probability"].to_dict()
    answer, extended = Answer.of(found, case.truth), found.to_callable()
    places = [extended.states.index(name) for name in NAMES]

    def rates(x: np.ndarray) -> np.ndarray:
        return extended(0.0, x[np.argsort(places)])[places]

    def lacking(x: np.ndarray) -> np.ndarray:
        return found.model.simulator(found.train).rates(np.zeros(()), x[np.argsort(places)], np.zeros(0))[places]

    return {
        "verdict": found.verdict,
        "sentence": found.sentence,
        "against": list(found.against),
        "added": answer.added,
        "likely": {slug: p for slug, p in probabilities.items() if p >= LIKELY and slug not in answer.names},
        "tied": sorted(answer.tied - answer.names),
        "laws": {quantity: p for (_, quantity), p in laws.items() if p >= LIKELY},
        "missed": sorted(set(case.truth) - answer.names),
        "wrong": answer.wrong,
        "right": found.verdict == ("named" if case.lacks else "no gap") and answer.names == set(case.truth),
        "coefficients": {slug: float(row["mean"]) for slug, row in answer.table.to_dict("index").items()},
        "covered": answer.covered,
        "rmse": [off(rates, case, *record) for record in (TRAIN, UNSEEN)],
        "rmse_before": [off(lacking, case, *record) for record in (TRAIN, UNSEEN)],
        "seconds": seconds,
    }


def sampled(case: Pendulum, record: tuple[tuple[float, float], float], seed: Sequence[int]) -> Trajectories:
    """Sample positions with noise, from a start to a last time."""
    t, x = case.path(*record)
    shown = x[0] + case.noise * np.random.default_rng(seed).standard_normal(len(t))
    return Trajectories.from_arrays(t, states={"s": shown}, units={"t": "s", "s": "m"})


def off(rates: Callable[[np.ndarray], np.ndarray], case: Pendulum, start: tuple[float, float], end: float) -> float:
    """Return the RMS error of the position of a free run from the true start, in m, by Runge and Kutta's method."""
    t, true = case.path(start, end)
    x, found, h = np.array(start), [start[0]], PENDULUM_STEP / FREE_RUN_STEPS
    for _ in t[1:]:
        for _ in range(FREE_RUN_STEPS):
            a = rates(x)
            b = rates(x + h / 2 * a)
            c = rates(x + h / 2 * b)
            x = x + h / 6 * (a + 2 * b + 2 * c + rates(x + h * c))
        found.append(x[0])
    return float(np.sqrt(np.mean((np.array(found) - true[0]) ** 2)))


def score(records: list[Record]) -> Tables:
    """Return a row for each replicate.

    Its columns are verdict ("refused" where there was none), names (slugs with their probabilities), likely (of those
    that were not added and have one of `LIKELY`), laws (quantities that a law is missing of, with probabilities; that
    of nothing is a constant), missed, wrong (as in `Answer.wrong`), covered (90 % intervals that hold their
    coefficient, of those of right names), train and unseen (errors of the position in free runs, mm), before (of the
    simulation alone, on both), seconds.
    """
    return {"cases": pd.DataFrame([_row(record) for record in records]).set_index("case")}


def _row(record: Record) -> Record:
    about = {"case": record["case"], "replicate": record["replicate"], "verdict": record.get("verdict", "refused")}
    if "refused" in record:
        return about
    held = record["covered"].values()
    return {
        **about,
        "names": _listed(record["added"]),
        "likely": _listed(record["likely"]),
        "laws": _listed({f"of {name or 'nothing'}": p for name, p in record["laws"].items()}),
        "missed": ", ".join(record["missed"]),
        "wrong": ", ".join(record["wrong"]),
        "covered": f"{sum(held)} of {len(held)}",
        "train": 1000 * record["rmse"][0],
        "unseen": 1000 * record["rmse"][1],
        "before": ", ".join(f"{1000 * each:.0f}" for each in record["rmse_before"]),
        "seconds": record["seconds"],
    }


def show(tables: Tables) -> dict[str, pd.DataFrame]:
    """Return the verdict on each record and free runs from two starts, then the names."""
    table, title = tables["cases"], "Errors of the position in free runs, mm: of the record, of another start, of the "
    return {
        f"{title}simulation alone": table.reindex(
            columns=["verdict", "train", "unseen", "before", "covered", "seconds"]
        ),
        "Effects that are added, with their probabilities": table.reindex(columns=["names", "wrong"]),
    }


@functools.cache
def _plant() -> tuple[Any, Path]:
    """Compile the FMU, once in each process, into a folder that lasts as long as the process."""
    folder = tempfile.TemporaryDirectory()
    return folder, plant(Path(folder.name))


def _listed(probabilities: dict[str, float]) -> str:
    return ", ".join(f"{slug} {p:.3f}" for slug, p in probabilities.items())


SPRING_PENDULUM = Benchmark(
    "spring-pendulum",
    "studies the public demonstration of neural FMUs (extra [fmu], a C compiler): friction that an FMU lacks.",
    {"cases": None, "only": None, "replicates": 3, "workers": 1, "seed": 0},
    cases,
    study,
    score,
    show,
    refusals=True,
)
