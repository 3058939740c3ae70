"""Studies of the pendulum on a spring, and what came of them: names, and free runs from two starts."""

import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError
from benchmarks.answers import Answer
from benchmarks.resumed import picked, tabled

from .plant import NAMES, plant
from .truth import STEP, path, truth, without_friction

TRAIN, UNSEEN = ((0.5, 0.0), 5.0), ((1.0, -1.5), 4.0)
"""Start and last time of the record that is learned from and of the other one, of the demonstration's two examples."""

FINE = 5
"""Steps of a free run between two samples."""

REPLICATES = 3
"""Of each case, by default."""

LIKELY = 0.05
"""Probability from which an effect that was not added is written down."""

DEFAULT, ALL = 3, 4
"""Effects that a study adds at most by default, and as many as the simulation lacks."""


@dataclass(frozen=True)
class Case:
    """A study.

    Attributes:
        name: Of the case.
        noise: Of the position, in m.
        effects: Effects that are added at most.
        lacks: Whether the simulation lacks anything: of a control, the data are its own.
        placed: Whether the simulation is told where the wall is, so that it lacks friction alone.
    """

    name: str
    noise: float
    effects: int
    lacks: bool = True
    placed: bool = False

    def path(self, start: tuple[float, float], end: float) -> tuple[np.ndarray, np.ndarray]:
        """Times, and positions and speeds; as of `truth.path`."""
        return (path if self.lacks else without_friction)(start, end)

    @property
    def truth(self) -> dict[str, float]:
        """Coefficients of what is lacking."""
        known = {"constant-force"} if self.placed else set()
        return {slug: value for slug, value in truth().items() if slug not in known} if self.lacks else {}


def cases() -> dict[str, Case]:
    """All cases by name."""
    every = []
    for noise in (1e-3, 5e-3):
        level = f"{1000 * noise:g}-mm"
        every += [Case(f"{level}-{effects}-effects", noise, effects) for effects in (ALL, DEFAULT)]
        every.append(Case(f"{level}-wall-known", noise, DEFAULT, placed=True))
        every.append(Case(f"{level}-nothing", noise, DEFAULT, lacks=False))
    return {case.name: case for case in every}


def run(
    output: str | os.PathLike[str],
    names: Sequence[str] | None = None,
    *,
    replicates: int = REPLICATES,
    seed: int = 1,
    progress: bool = True,
) -> pd.DataFrame:
    """Study every replicate, or those that are left, and write the results.

    Args:
        output: Folder for results.jsonl, and for cases.csv and summary.json.
        names: Of the cases; all by default.
        replicates: Of each case.
        seed: Of the noise.
        progress: Whether to show a progress bar.

    Returns:
        The table of `score`.

    Raises:
        InputError: A folder that cannot be written to; an unknown case; FMPy or a C compiler that is not there.
    """
    chosen = picked(cases(), names, "case")
    with tempfile.TemporaryDirectory() as folder:
        file = plant(Path(folder))
        return tabled(
            output,
            [(case, replicate) for replicate in range(replicates) for case in chosen],
            key=lambda case: f"{case[0].name}/{seed}/{case[1]}",
            measure=lambda case: _answer(file, *case, seed),
            what="Spring pendulum",
            progress=progress,
            score=score,
            name="cases",
            about={"replicates": replicates, "seed": seed},
        )


def study(file: Path, case: Case, replicate: int, seed: int) -> dict[str, Any]:
    """One replicate: what the study says, and how far its free runs are off.

    Args:
        file: The FMU.
        case: The case.
        replicate: Of its noise.
        seed: Of all noise.
    """
    # Imported here: these bring JAX, which the module that makes the data does without.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.missing_effects import find_missing_effects
    from bayes_greybox.physics.simulation.fmu.given import FMU

    simulation = FMU(file, {"fixed.s0": 0.0} if case.placed else {}, NAMES)
    start = time.perf_counter()
    found = find_missing_effects(
        GreyBox(simulation=simulation),
        sampled(case, TRAIN, (seed, replicate, 0)),
        test=sampled(case, UNSEEN, (seed, replicate, 1)),
        effects_at_most=case.effects,
        settle=False,
        free_runs=False,
        progress=False,
    )
    seconds = time.perf_counter() - start
    probabilities = dict(zip(found.effects["slug"], map(float, found.effects["probability"]), strict=True))
    laws: dict[Any, float] = found.quantities["probability"].to_dict()
    answer = Answer(case.truth, found.verdict, found.effects, found.instrument)
    amended = found.to_callable()
    places = [amended.states.index(name) for name in NAMES]

    def rates(x: np.ndarray) -> np.ndarray:
        return amended(0.0, x[np.argsort(places)])[places]

    def lacking(x: np.ndarray) -> np.ndarray:
        return found.model.simulator(found.train).rates(np.zeros(()), x[np.argsort(places)], np.zeros(0))[places]

    return {
        "case": case.name,
        "replicate": replicate,
        "verdict": found.verdict,
        "sentence": found.sentence,
        "against": list(found.against),
        "added": answer.added,
        "likely": {slug: p for slug, p in probabilities.items() if p >= LIKELY and slug not in answer.names},
        "tied": sorted(answer.tied - answer.names),
        "laws": {name: p for (_, name), p in laws.items() if p >= LIKELY},
        "missed": sorted(set(case.truth) - answer.names),
        "wrong": answer.wrong,
        "right": found.verdict == ("named" if case.lacks else "no gap") and answer.names == set(case.truth),
        "coefficients": {slug: float(row["mean"]) for slug, row in answer.table.to_dict("index").items()},
        "covered": answer.covered,
        "rmse": [off(rates, case, *record) for record in (TRAIN, UNSEEN)],
        "rmse_before": [off(lacking, case, *record) for record in (TRAIN, UNSEEN)],
        "seconds": seconds,
    }


def sampled(case: Case, record: tuple[tuple[float, float], float], seed: Sequence[int]) -> Trajectories:
    """Positions with noise.

    Args:
        case: Says how much, and of what.
        record: Start and last time.
        seed: Of the noise.
    """
    t, x = case.path(*record)
    shown = x[0] + case.noise * np.random.default_rng(seed).standard_normal(len(t))
    return Trajectories.from_arrays(t, states={"s": shown}, units={"t": "s", "s": "m"})


def off(rates: Callable[[np.ndarray], np.ndarray], case: Case, start: tuple[float, float], end: float) -> float:
    """Root mean square error of the position of a run from the true start, in m, by Runge and Kutta's method.

    Args:
        rates: Of position and speed.
        case: Whose path is the true one.
        start: Both at time 0.
        end: Last time.
    """
    t, true = case.path(start, end)
    x, found, h = np.array(start), [start[0]], STEP / FINE
    for _ in t[1:]:
        for _ in range(FINE):
            a = rates(x)
            b = rates(x + h / 2 * a)
            c = rates(x + h / 2 * b)
            x = x + h / 6 * (a + 2 * b + 2 * c + rates(x + h * c))
        found.append(x[0])
    return float(np.sqrt(np.mean((np.array(found) - true[0]) ** 2)))


def score(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """One row a replicate.

    Args:
        rows: Of `study`, or of what it refused.

    Returns:
        verdict ("refused" where there was none), names (slugs with their probabilities), likely (of those that were
        not added and have one of `LIKELY`), laws (quantities that a law is missing of, with probabilities; that of
        nothing is a constant), missed, wrong (as `Answer.wrong` says), covered (90 % intervals that hold their
        coefficient, of those of right names), train and unseen (errors of the position in free runs, mm), before (of
        the simulation alone, on both), seconds.
    """
    table = []
    for row in rows:
        one: dict[str, Any] = {
            "case": row["case"],
            "replicate": row["replicate"],
            "verdict": row.get("verdict", "refused"),
        }
        if "refused" not in row:
            held = row["covered"].values()
            one |= {
                "names": _listed(row["added"]),
                "likely": _listed(row["likely"]),
                "laws": _listed({f"of {name or 'nothing'}": p for name, p in row["laws"].items()}),
                "missed": ", ".join(row["missed"]),
                "wrong": ", ".join(row["wrong"]),
                "covered": f"{sum(held)} of {len(held)}",
                "train": 1000 * row["rmse"][0],
                "unseen": 1000 * row["rmse"][1],
                "before": ", ".join(f"{1000 * each:.0f}" for each in row["rmse_before"]),
                "seconds": row["seconds"],
            }
        table.append(one)
    return pd.DataFrame(table).set_index("case")


def _listed(probabilities: dict[str, float]) -> str:
    return ", ".join(f"{slug} {p:.3f}" for slug, p in probabilities.items())


def _answer(file: Path, case: Case, replicate: int, seed: int) -> dict[str, Any]:
    try:
        return study(file, case, replicate, seed)
    except InputError as error:
        # No answer is an answer, and not a right one.
        return {"case": case.name, "replicate": replicate, "refused": str(error)}
