"""From small gaps to tied studies, and from these to what each way of choosing the next experiment makes of them."""

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.next_experiment.candidates import usual_candidates
from bayes_greybox.discovery.next_experiment.ranked import FAILS, usual_sensors
from bayes_greybox.greybox import GreyBox
from bayes_greybox.missing_effects import Study, find_missing_effects
from bayes_greybox.physics.experiments.candidate import Candidate
from bayes_greybox.running.errors import InputError
from benchmarks.answers import Answer
from benchmarks.files import unwritable, write_tables
from benchmarks.hidden_effects.cases import Case
from benchmarks.hidden_effects.generate import CaseData, generate
from benchmarks.hidden_effects.solvers.study import all_roles
from benchmarks.hidden_effects.systems.trajectories import Runs
from benchmarks.resumed import resumed

from .machines import Driven, again, exact, joined, noise_of, record_of, small_gaps
from .optimal import encompassing, log_determinants
from .scores import LEAST, differences, score

TIED = ("one of", "unknown")
"""Verdicts of a tie, where at least two explanations say what a further run would show."""


def run(
    output: str | os.PathLike[str], cases: int | None = None, *, seed: int = 0, progress: bool = True
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Study every case, or those that are left, have the ties told apart in each way, and write the results.

    Args:
        output: Folder for results.jsonl, ways.csv and differences.csv, and summary.json.
        cases: How many of `small_gaps`; all by default.
        seed: Of the cases, of their noise, and of the candidates that are chosen at random.
        progress: Whether to show a progress bar.

    Returns:
        The tables of `scores.score` and `scores.differences`.

    Raises:
        InputError: A folder that cannot be written to.
    """
    folder, chosen = Path(output), small_gaps(seed)[:cases]
    try:
        with threadpool_limits(1):
            rows = resumed(
                folder, chosen, key=lambda case: case.key, measure=measure, what="Next experiments", progress=progress
            )
        tables = score(rows), differences(rows)
        about = {"seed": seed, "cases": len(rows), "ties": sum(bool(row["ways"]) for row in rows)}
        write_tables(folder, {"ways": tables[0], "differences": tables[1]}, about)
    except OSError as error:
        raise unwritable(folder, error) from error
    return tables


def measure(case: Case) -> dict[str, Any]:
    """One case: its study, and where that is a tie, what became of it by each way of choosing an experiment.

    Args:
        case: The case.
    """
    start = time.perf_counter()
    row: dict[str, Any] = {
        "host": case.host, "effect": case.effects[0], "noise": case.noise, "ratio": case.ratios[0], "verdict": None,
        "ways": {},
    }  # fmt: skip
    try:
        data = generate(case)
    except InputError:
        # The host cannot show it at any size.
        return row
    study = _studied(data, record_of(data))
    row |= {"verdict": study.verdict, "before": _answer(study, data)}
    known = [e for e in study.explanations[data.equation] if e.components]
    if study.verdict in TIED and len(known) > 1 and encompassing(known).terms:
        row |= {
            "likely": {e.name: e.probability for e in study.explanations[data.equation]},
            **_told_apart(data, study),
        }
    return {**row, "seconds": time.perf_counter() - start}


def orders(data: CaseData, study: Study, candidates: Sequence[Candidate]) -> dict[str, list[int]]:
    """Candidates in the order in which each way prefers them; what may fail by the study's word comes last in each.

    Args:
        data: The case.
        study: Of its record.
        candidates: What could be done, with names that tell them apart.
    """
    places = {each.name: i for i, each in enumerate(candidates)}
    table = study.next_experiment(candidates, threshold=0.0).table
    fails = {places[name]: share > FAILS for name, share in zip(table["candidate"], table["fails"], strict=True)}
    determinants = log_determinants(data, study.train, study.explanations[data.equation], candidates)
    preferred = {
        "information": [places[name] for name in table["candidate"]],
        "random": np.random.default_rng([data.case.seed, 2]).permutation(len(candidates)).tolist(),
        "D-optimal": np.argsort(-determinants, kind="stable").tolist(),
    }
    return {way: sorted(order, key=lambda place: fails[place]) for way, order in preferred.items()}


def possible(study: Study, data: CaseData) -> tuple[Candidate, ...]:
    """What could be done: the usual candidates of the record, each also in half the time.

    All have as many rows as the record.

    Args:
        study: Of the record.
        data: The case.
    """
    rows, sensors, found = data.host.samples, usual_sensors(study), []
    for factor in (0.5, 1.0):
        usual = usual_candidates(study.train, sensors, duration=factor * data.host.stop, rows=rows)
        found += [replace(each, name=f"{each.name}; for {each.duration:g}") for each in usual]
    return tuple(found)


def _told_apart(data: CaseData, study: Study) -> dict[str, Any]:
    candidates = possible(study, data)
    done: dict[int, Runs | None] = {}

    def of(place: int) -> Runs | None:
        if place not in done:
            each = candidates[place]
            inputs = {name: signal.value for name, signal in each.inputs.items()}
            done[place] = exact(data, Driven(each.start, inputs, each.duration, each.rows))
        return done[place]

    ways: dict[str, Any] = {}
    studied: dict[int, dict[str, Any]] = {}
    for way, order in orders(data, study, candidates).items():
        # What the machine cannot do is passed over, whoever asks for it.
        place = next((i for i in order if of(i) is not None), None)
        if place is None:
            return {"ways": {}}
        if place not in studied:
            studied[place] = _after(data, done[place])
        ways[way] = {"candidate": candidates[place].name, "passed over": order.index(place), **studied[place]}
    ways["the same again"] = {"candidate": "the same again", "passed over": 0, **_after(data, exact(data, again(data)))}
    return {"ways": ways, "candidates": len(candidates)}


def _after(data: CaseData, runs: Runs | None) -> dict[str, Any]:
    """What a study says of the record and a further run."""
    assert runs is not None
    noise = {name: [values] for name, values in noise_of(data, len(runs.known)).items()}
    return _answer(_studied(data, joined(data, [runs], noise)), data)


def _studied(data: CaseData, measured: Trajectories) -> Study:
    return find_missing_effects(
        GreyBox(simulation=dict(data.simulation), dictionary={data.equation: []}),
        measured,
        test=data.test,
        catalogue=data.host.domain,
        roles=all_roles(data),
        settle=False,
        free_runs=False,
        progress=False,
    )


def _answer(study: Study, data: CaseData) -> dict[str, Any]:
    """Whether it names what is hidden and nothing else, and how probable it says that this is."""
    truth = {each.slug: each.coefficient for each in data.effects}
    answer = Answer(truth, study.verdict, study.effects, study.instrument)
    table: Mapping[Any, Any] = study.hypotheses.loc[data.equation]["probability"].to_dict()
    probability = float(table.get(" + ".join(sorted(truth)), 0.0))
    return {
        "verdict": study.verdict,
        "names": sorted(answer.names),
        "right": study.verdict == "named" and answer.names == set(truth),
        "wrong": answer.wrong,
        "probability": probability,
        "log": float(np.log(max(probability, LEAST))),
    }
