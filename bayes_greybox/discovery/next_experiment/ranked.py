"""Candidates like the data, ranked by their expected information about the explanation, and when to stop."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from numbers import Real
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.explained import Explained, joined
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.physics.experiments.candidate import Candidate
from bayes_greybox.physics.experiments.signals import SIGNALS, USUAL_SIGNALS, Hold, Signal, Usual, band
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.running.errors import InputError

from .predicted import Information, Predictor, Responses, information, together


def usual_candidates(
    data: Trajectories, sensors: Mapping[str, float], *, signals: Iterable[str] | None = None,
    amplitudes: Sequence[float] = (0.5, 1.0), starts: Sequence[Mapping[str, float]] | None = None,
    duration: float | None = None, rows: int | None = None,
) -> tuple[Candidate, ...]:  # fmt: skip
    """Return experiments like those of the data, with other signals, amplitudes and starts.

    One input is driven at a time; the others are held in the middle of their range, and so is one that never moved in
    the data. Frequencies lie between a few periods a run and the band of the states.

    Args:
        data: Training data.
        sensors: Noise by channel.
        signals: Families of signals, keys of `SIGNALS`; all by default.
        amplitudes: Amplitudes over half the range that the input had in the data: above 1 is beyond the data.
        starts: States at the start; by default where the first runs of the data began, and where no input moves
            corners of the states' range, `amplitudes` times as far from its middle.
        duration: Duration of each; that of the longest run by default.
        rows: Samples of each; by default as close as those of the data.

    Raises:
        InputError: An unknown family, an amplitude that is none, or a start of an unknown state.
    """
    families = tuple(SIGNALS if signals is None else signals)
    if unknown := [name for name in families if name not in SIGNALS]:
        raise InputError(f"There are no signals called {unknown[0]!r}; there are {', '.join(SIGNALS)}.")
    if not np.ndim(amplitudes) or not len(amplitudes) or not all(np.isfinite(a) and a > 0 for a in amplitudes):
        raise InputError(f"amplitudes must be numbers above 0, such as (0.5, 1), not {amplitudes}.")
    if duration is not None and not (isinstance(duration, Real) and np.isfinite(duration) and duration > 0):
        raise InputError(f"duration must be a number above 0, not {duration}.")
    if unknown := [name for start in starts or () for name in start if name not in data.states]:
        raise InputError(f"starts: there is no state {unknown[0]!r}; there are {', '.join(data.state_names)}.")
    longest = data.run == max(range(data.n_run), key=lambda r: np.ptp(data.time[data.run == r]))
    time = data.time[longest]
    duration = float(np.ptp(time)) if duration is None else float(duration)
    if rows is None:
        # About as many as the data have in as long a time, whose rows may come in bursts.
        most = np.ceil(len(time) * duration / np.ptp(time))
        rows = max(2, min(round(duration / float(np.median(np.diff(time)))), int(most)) + 1)
    low, high = band({name: x[longest] for name, x in data.states.items()}, time, duration)
    still: dict[str, Signal] = {name: Hold(0.5 * float(np.min(u) + np.max(u))) for name, u in data.inputs.items()}
    driven: list[dict[str, Signal]] = []
    for (name, u), factor in product(data.inputs.items(), amplitudes):
        usual = Usual(factor * 0.5 * float(np.ptp(u)), 0.5 * float(np.min(u) + np.max(u)), low, high, duration)
        driven += [{**still, name: s} for family in families for s in USUAL_SIGNALS[family](usual) if np.ptp(u) > 0]
    firsts = [int(np.flatnonzero(data.run == r)[0]) for r in range(min(2, data.n_run))]
    begun = [{name: float(x[i]) for name, x in data.states.items()} for i in firsts]
    if starts is None:
        starts = begun if driven else _corners(data, amplitudes)
    pairs = product(driven or [still], [{**begun[0], **start} for start in starts])
    return tuple(Candidate(inputs, start, duration, rows, sensors) for inputs, start in pairs)


def _corners(data: Trajectories, amplitudes: Sequence[float]) -> list[dict[str, float]]:
    """Return each state at either end of its range with the others in the middle, and all of them at the same end."""
    middle = {name: 0.5 * float(np.min(x) + np.max(x)) for name, x in data.states.items()}
    starts = []
    for factor in (sign * amplitude for amplitude in amplitudes for sign in (1.0, -1.0)):
        moved = {name: middle[name] + factor * 0.5 * float(np.ptp(x)) for name, x in data.states.items()}
        starts += [{**middle, name: moved[name]} for name in middle] + ([moved] if len(middle) > 1 else [])
    return starts


WORTH_DOING, ROUNDING_BITS = 0.05, 1e-9
"""Bits below which an experiment is not worth doing, and bits that rounding alone may give."""

ALONE, BEYOND = 0.99, 1.1
"""Probability of an explanation that needs no experiment, and reach over the data's range that is extrapolation."""

FAILS, MORE_OUTCOMES = 0.01, 4
"""Share of failing runs that rules a candidate out, and factor on the runs in which it is counted of the chosen."""


@dataclass(frozen=True)
class NextExperiment:
    """The experiment to do next.

    Attributes:
        table: Candidates, best first: information and its error (bits; zero: a closed form), reach (95 % quantile, of
            the data's range), fails (largest share of runs that fail under an explanation), said (remarks).
        chosen: Experiments to do together, chosen one after another (greedy); empty if none is worth doing.
        information: Information of all chosen together.
        entropy: Bits that tell all explanations with a prediction apart.
        explanations: Name and probability of each explanation in the study, and true if it predicts anything.
        responses: Prediction of each chosen experiment, or of the best if none is worth doing.
    """

    table: pd.DataFrame
    chosen: tuple[Candidate, ...]
    information: Information
    entropy: float
    explanations: pd.DataFrame
    sentence: str
    responses: tuple[Responses, ...] = field(default=(), repr=False)

    def __repr__(self) -> str:
        return f"NextExperiment: {self.sentence}"


def usual_sensors(study: StudyResult) -> dict[str, float]:
    """Return the noise of the sensors in a study: of rates by equation, or of sampled states, which must show some."""
    if not study.base.rows.follows_path:
        return next((dict(e.sigma) for e in joined(study.explanations) if e.components), {})
    samples = study.train.samples or study.train
    noise = sample_noise(samples.time, samples.matrix(samples.state_names), samples.run_lengths)
    sensors = {name: float(sd) for name, sd in zip(samples.state_names, noise, strict=True)}
    if unseen := [name for name, sd in sensors.items() if not sd > 0]:
        raise InputError(
            f"The samples of {unseen[0]!r} show no noise of their own: state its standard deviation, "
            f"next_experiment(sensors={{{unseen[0]!r}: ...}})."
        )
    return sensors


def rank(
    study: StudyResult, candidates: Sequence[Candidate] | None, *, batch: int, threshold: float, outcomes: int,
    seed: int, **usual: Any,
) -> NextExperiment:  # fmt: skip
    """Rank candidates by their expected information about the explanation; arguments as of `Study.next_experiment`.

    Raises:
        InputError: A study of outputs, impossible numbers, or what cannot be simulated.
    """
    usual = {name: value for name, value in usual.items() if name != "sensors" or value}
    _check_ranking(study, batch, outcomes, threshold, () if candidates is None else usual)
    every = joined(study.explanations)
    predicting = [e for e in every if e.components]
    rows = [(e.name, e.probability, bool(e.components)) for e in every]
    about = pd.DataFrame(rows, columns=["name", "probability", "predicts"])
    if len(predicting) < 2:
        return NextExperiment(pd.DataFrame(), (), Information(0.0), 0.0, about, _alone(every))
    # As the study weighed it: coefficients are differences from stated means.
    simulation = study.base.centred().simulator(study.train).rounded(study.train.columns)
    if still := [x for x in simulation.states if x not in (*simulation.equations, *study.explanations)]:
        raise InputError(f"The state {still[0]!r} has no equation to integrate: add it to the simulation.")
    if lacking := [name for name in simulation.states if name not in study.train.states]:
        raise InputError(f"The data lack the state {lacking[0]!r}: what runs reach is compared with its range.")
    if candidates is None:
        candidates = usual_candidates(study.train, usual.pop("sensors", None) or usual_sensors(study), **usual)
    if not candidates:
        raise InputError("Ranking needs at least one candidate: give some, or a start.")
    for each in candidates:
        _check_candidate(each, simulation)
    units = {name: study.train.unit(name) for name in ("t", *study.train.columns)}
    candidates = [each.named_in(units) for each in candidates]
    predictor = Predictor(predicting, simulation, study.train, not study.base.rows.follows_path, outcomes, seed)
    responses = predictor.predict(candidates)
    finer = replace(predictor, outcomes=MORE_OUTCOMES * outcomes, seed=seed + 1)
    while True:
        able = [i for i, each in enumerate(responses) if each.fails <= FAILS]
        picked = _picked(responses, able, batch, predictor.probability)
        # Few runs do not show that one in fifty fails.
        for i, each in zip(picked, finer.predict([candidates[i] for i in picked]), strict=True):
            responses[i] = each
        if all(responses[i].fails <= FAILS for i in picked):
            break
    p, remarks = predictor.probability, [_remarks(each) for each in responses]
    bits, alone = _bits_of([responses[i] for i in picked], p), [_bits_of([each], p) for each in responses]
    table = pd.DataFrame({
        "candidate": [each.name for each in candidates], "information": alone, "error": 0.0,
        "reach": [max(r.reach.values()) for r in responses], "fails": [r.fails for r in responses], "said": remarks,
    })  # fmt: skip
    table = table.sort_values("information", ascending=False, kind="stable", ignore_index=True)
    chosen = tuple(candidates[i] for i in picked) if bits >= max(threshold, ROUNDING_BITS) else ()
    total = float(-p @ np.log2(p))
    names, worth = ", ".join(e.name for e in predicting), f"{bits:.2f} of {total:.2f} bits"
    failing = "Under every candidate some runs fail: give smaller amplitudes or other starts."
    text = _sentence(chosen, names, bits, worth, threshold) if able else failing
    mind = "; ".join(dict.fromkeys(remarks[i] for i in picked if remarks[i] and chosen))
    left = ", ".join(f"{e.name} (probability {e.probability:.2f})" for e in every if not e.components)
    text += f" Mind: {mind}." if mind else ""
    text += f" Nothing is predicted under {left}, which is left out." if left else ""
    return NextExperiment(table, chosen, Information(bits), total, about, text, tuple(responses[i] for i in picked))


def _bits_of(each: Sequence[Responses], p: np.ndarray) -> float:
    by_path = zip(*(one.predictions for one in each), strict=True)
    return information([list(map(together, zip(*own, strict=True))) for own in by_path], p) if each else 0.0


def _picked(responses: Sequence[Responses], able: Sequence[int], batch: int, p: np.ndarray) -> list[int]:
    """Return experiments chosen one after another, each the best beside those before it."""
    picked: list[int] = []
    while len(picked) < min(batch, len(able)):
        beside = {i: _bits_of([responses[k] for k in (*picked, i)], p) for i in able if i not in picked}
        picked.append(max(beside, key=lambda i, bits=beside: bits[i]))
    return picked


def _remarks(each: Responses) -> str:
    beyond, still = "{} reaches {:.2g} times the data's range", "{} is elsewhere than in the data, where it never moved"
    far = [(beyond if np.isfinite(far) else still).format(x, far) for x, far in each.reach.items() if far > BEYOND]
    remarks = [f"{text}: extrapolation" for text in far]
    if each.fails > 0:
        remarks.append(f"{each.fails:.1%} of the runs fail under an explanation: unsafe")
    return "; ".join(remarks if each.resolved else [*remarks, "the steps do not follow its path"])


def _alone(every: Sequence[Explained]) -> str:
    if len(every) != 1:
        return "Fewer than two likely explanations predict anything: no experiment can be chosen to tell them apart."
    if every[0].probability >= ALONE:
        return f"One explanation is left ({every[0].name}): nothing needs to be told apart."
    name = f"{every[0].name} (probability {every[0].probability:.2f})"
    return f"Besides {name} no explanation is likely enough to be told apart from it by an experiment."


def _sentence(chosen: Sequence[Candidate], names: str, bits: float, worth: str, threshold: float) -> str:
    if chosen:
        how = "Together, chosen one after another (greedy), they are" if len(chosen) > 1 else "It is"
        what = " and ".join(f"({each.name})" for each in chosen)
        return f"Measure next: {what}. {how} expected to tell {worth} between {names}."
    best = f"({names}): the best is expected to tell {worth}."
    if bits < ROUNDING_BITS:
        return f"No candidate would tell them apart {best}"
    return f"No candidate is worth the threshold of {threshold:.3g} bits {best}"


def _check_ranking(study: StudyResult, batch: int, outcomes: int, threshold: float, described: Collection[str]) -> None:
    if not study.explanations:
        raise InputError("The study holds no explanations, as in files of before: run find_missing_effects again.")
    if any(study.train.is_output(name) for name in study.explanations):
        raise InputError("What to measure next is found by simulating runs, and an output has none: study a rate.")
    if batch < 1 or outcomes < 2 or not threshold >= 0:
        raise InputError("Ranking needs a batch of at least 1, at least 2 outcomes and a threshold of at least 0.")
    if described:
        raise InputError(f"{', '.join(described)} describes default candidates: leave candidates out.")


def _check_candidate(candidate: Candidate, simulation: Simulation) -> None:
    states, inputs, of = simulation.states, simulation.inputs, f"of candidate {candidate.name!r}"
    for what, given, needed in (("start", candidate.start, states), ("inputs", candidate.inputs, inputs)):
        if lacking := [name for name in needed if name not in given]:
            raise InputError(f"{what} {of}: {lacking[0]!r} is missing; give it a value.")
        if unknown := [name for name in given if name not in needed]:
            raise InputError(f"{what} {of}: there is no {unknown[0]!r} in the model.")
    if unknown := [name for name in candidate.sensors if name not in states]:
        raise InputError(f"sensors {of}: there is no state {unknown[0]!r}; there are {', '.join(states)}.")
