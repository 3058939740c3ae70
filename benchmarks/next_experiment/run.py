"""From small gaps to tied studies, and from these to an experiment by each way of choosing it."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError
from benchmarks.answers import Answer, studied
from benchmarks.hidden_effects.cases import HiddenCase
from benchmarks.hidden_effects.generate import CaseData, generate
from benchmarks.hidden_effects.solvers.study import all_roles
from benchmarks.hidden_effects.systems.trajectories import Runs
from benchmarks.runner import Asked, Benchmark, Case

from .machines import Driven, again, exact, joined, noise_of, record_of, small_gaps
from .scores import LEAST_PROBABILITY, score, show

if TYPE_CHECKING:
    from bayes_greybox.missing_effects import Study
    from bayes_greybox.physics.experiments.candidate import Candidate

TIED = ("one of", "unknown")
"""Verdicts of a tie, where at least two explanations say what a further run would show."""


def cases(asked: Asked) -> list[Case]:
    """Return the first of the small gaps."""
    return [Case(case.key, (case,)) for case in small_gaps(asked.seed)[: asked.cases]]


def measure(case: HiddenCase) -> dict[str, Any]:
    """Return the study of a case, and where that is a tie, what became of it by each way of choosing an experiment."""
    from .optimal import encompassing

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
    explanations = study.explanations[data.equation]
    known = [e for e in explanations if e.components]
    if study.verdict in TIED and len(known) > 1 and encompassing(known).terms:
        row |= {"likely": {e.name: e.probability for e in explanations}, **_told_apart(data, study)}
    return {**row, "seconds": time.perf_counter() - start}


def orders(data: CaseData, study: "Study", candidates: "Sequence[Candidate]") -> dict[str, list[int]]:
    """Return candidates in the order in which each way prefers them; those that may fail come last in each."""
    from bayes_greybox.discovery.next_experiment.ranked import FAILS

    from .optimal import log_determinants

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


def possible(study: "Study", data: CaseData) -> "tuple[Candidate, ...]":
    """Return the usual candidates of the record, each also in half the time, with as many rows as the record."""
    from bayes_greybox.discovery.next_experiment.ranked import usual_candidates, usual_sensors

    rows, sensors, found = data.host.samples, usual_sensors(study), []
    for factor in (0.5, 1.0):
        usual = usual_candidates(study.train, sensors, duration=factor * data.host.stop, rows=rows)
        found += [replace(each, name=f"{each.name}; for {each.duration:g}") for each in usual]
    return tuple(found)


def _told_apart(data: CaseData, study: "Study") -> dict[str, Any]:
    candidates = possible(study, data)
    done: dict[int, Runs | None] = {}

    def of(place: int) -> Runs | None:
        if place not in done:
            each = candidates[place]
            inputs = {name: signal.value for name, signal in each.inputs.items()}
            done[place] = exact(data, Driven(each.start, inputs, each.duration, each.rows))
        return done[place]

    ways: dict[str, Any] = {}
    answers: dict[int, dict[str, Any]] = {}
    for way, order in orders(data, study, candidates).items():
        # What the machine cannot do is passed over, whoever asks for it.
        place = next((i for i in order if of(i) is not None), None)
        if place is None:
            return {"ways": {}}
        if place not in answers:
            answers[place] = _after(data, done[place])
        ways[way] = {"candidate": candidates[place].name, "passed over": order.index(place), **answers[place]}
    ways["the same again"] = {"candidate": "the same again", "passed over": 0, **_after(data, exact(data, again(data)))}
    return {"ways": ways, "candidates": len(candidates)}


def _after(data: CaseData, runs: Runs | None) -> dict[str, Any]:
    """Return the answer to the record and a further run."""
    assert runs is not None
    noise = {name: [values] for name, values in noise_of(data, len(runs.known)).items()}
    return _answer(_studied(data, joined(data, [runs], noise)), data)


def _studied(data: CaseData, measured: Trajectories) -> "Study":
    from bayes_greybox.greybox import GreyBox

    model = GreyBox(simulation=dict(data.simulation), dictionary={data.equation: []})
    about: dict[str, Any] = {"test": data.test, "catalogue": data.host.domain, "roles": all_roles(data)}
    return studied(model, measured, free_runs=False, **about)[0]


def _answer(study: "Study", data: CaseData) -> dict[str, Any]:
    """Return whether the study names the hidden effect and nothing else, and its probability for that."""
    truth = {each.slug: each.coefficient for each in data.effects}
    answer = Answer.of(study, truth)
    table: Mapping[Any, Any] = study.hypotheses.loc[data.equation]["probability"].to_dict()
    probability = float(table.get(" + ".join(sorted(truth)), 0.0))
    return {
        "verdict": study.verdict,
        "names": sorted(answer.names),
        "right": study.verdict == "named" and answer.names == set(truth),
        "wrong": answer.wrong,
        "probability": probability,
        "log": float(np.log(max(probability, LEAST_PROBABILITY))),
    }


NEXT_EXPERIMENT = Benchmark(
    "next-experiment",
    "has ties told apart by the experiment that the study asks for, by the D-optimal one and by one at random.",
    {"cases": None, "workers": 1, "seed": 0},
    cases,
    measure,
    score,
    show,
    threads=1,
)
