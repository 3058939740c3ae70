"""Candidates ranked by their expected information about the explanation, several at once, and when to stop."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.discovery.answer.explained import Explained, joined
from bayes_greybox.discovery.refusals import check_candidate, check_ranking, check_runs
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.physics.experiments.candidate import Candidate
from bayes_greybox.running.errors import InputError

from .candidates import usual_candidates
from .information import Information, information, together
from .predicted import Predictor, Responses

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
        sentence: The answer in words.
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
    """Return the noise of the sensors in a study: of rates by equation, or of the sampled states.

    Raises:
        InputError: Samples that show no noise.
    """
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
    study: StudyResult, candidates: Sequence[Candidate] | None = None, *, batch: int = 1,
    threshold: float = WORTH_DOING, outcomes: int = 64, seed: int = 0, **usual: Any,
) -> NextExperiment:  # fmt: skip
    """Rank candidates by their expected information about the explanation; one whose runs fail is not chosen.

    Explanations without a prediction (unknown, an error of these sensors) are left out, as the sentence says. The
    arguments are those of `Study.next_experiment`.

    Raises:
        InputError: See `check_ranking`, `check_runs` and `check_candidate`.
    """
    usual = {name: value for name, value in usual.items() if name != "sensors" or value}
    check_ranking(study.train, study.explanations, (batch, outcomes, threshold), () if candidates is None else usual)
    every = joined(study.explanations)
    predicting = [e for e in every if e.components]
    rows = [(e.name, e.probability, bool(e.components)) for e in every]
    about = pd.DataFrame(rows, columns=["name", "probability", "predicts"])
    if len(predicting) < 2:
        return NextExperiment(pd.DataFrame(), (), Information(0.0), 0.0, about, _alone(every))
    # As the study weighed it: coefficients are differences from stated means.
    simulation = study.base.centred().simulator(study.train).rounded(study.train.columns)
    check_runs(simulation, study.train, study.explanations)
    if candidates is None:
        candidates = usual_candidates(study.train, usual.pop("sensors", None) or usual_sensors(study), **usual)
    if not candidates:
        raise InputError("Ranking needs at least one candidate: give some, or a start.")
    for each in candidates:
        check_candidate(each, simulation)
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
    text = "Under every candidate some runs fail: give smaller amplitudes or other starts."
    if able:
        text = _sentence(chosen, names, bits, worth, threshold)
    mind = "; ".join(dict.fromkeys(remarks[i] for i in picked if remarks[i] and chosen))
    left = ", ".join(f"{e.name} (probability {e.probability:.2f})" for e in every if not e.components)
    text += f" Mind: {mind}." if mind else ""
    text += f" Nothing is predicted under {left}, which is left out." if left else ""
    return NextExperiment(table, chosen, Information(bits), total, about, text, tuple(responses[i] for i in picked))


def _bits_of(each: Sequence[Responses], p: np.ndarray) -> float:
    """Return the information of experiments together."""
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
