"""Candidates ranked by what they are expected to tell of the explanation, several at once, and when to stop."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.discovery.study import StudyResult

from .candidates import Candidate, usual_candidates
from .explained import Explained, joined
from .information import Information, Products, entropy, expected_information, of_explanations
from .predicted import Predicted, predict
from .question import Question
from .responses import Responses, responses

THRESHOLD = 0.05
"""Bits below which an experiment is not worth doing."""

SURE = 2.0
"""Monte Carlo standard errors that the information must exceed."""

FINALISTS = 8
"""Candidates among which one is chosen by more outcomes: the best of many noisy figures is often not the best."""

FINER = 4
"""Times as many outcomes."""

LEAST = 1e-9
"""Bits that rounding alone may give: an experiment worth less is worth nothing, whatever the threshold."""

ALONE = 0.99
"""Probability from which on an explanation without a rival needs no experiment."""

BEYOND, FAILS = 1.1, 0.01
"""Reach over the data's range that is said to be extrapolation, and share of failing runs that rules one out."""


@dataclass(frozen=True)
class NextExperiment:
    """What to measure next.

    Attributes:
        table: Candidates, best first: information and its Monte Carlo error (bits), reach (95 % quantile, of the data's
            range), fails (largest share of runs that fail under an explanation), said.
        chosen: Experiments to do together, chosen one after another (greedy); none where none is worth it.
        information: Of all chosen together, by outcomes that they were not chosen by.
        entropy: Bits that tell all explanations with a prediction apart.
        explanations: Name, probability in the study, and whether it predicts anything.
        sentence: The answer in words.
        responses: What is expected of each experiment that was chosen, or, where none is worth it, of the best.
    """

    table: pd.DataFrame
    chosen: tuple[Candidate, ...]
    information: Information
    entropy: float
    explanations: pd.DataFrame
    sentence: str
    responses: tuple[Responses, ...] = field(default=(), repr=False)

    def __repr__(self) -> str:
        """The answer in words."""
        return f"NextExperiment: {self.sentence}"


def usual_sensors(study: StudyResult) -> dict[str, float]:
    """Noise of the sensors as a study found it: of rates by equation, or of the sampled states.

    Args:
        study: The study.

    Raises:
        InputError: Samples that show no noise.
    """
    if study.base.rows.rates_measured:
        known = [e for e in joined(study.explanations) if e.components]
        return dict(known[0].sigma) if known else {}
    samples = study.train.samples or study.train
    noise = sample_noise(samples.time, samples.matrix(samples.state_names), samples.run_lengths)
    if unseen := [name for name, sd in zip(samples.state_names, noise, strict=True) if not sd > 0]:
        raise InputError(
            f"The samples of {unseen[0]!r} show no noise of their own: state its standard deviation, "
            f"next_experiment(sensors={{{unseen[0]!r}: ...}})."
        )
    return {name: float(sd) for name, sd in zip(samples.state_names, noise, strict=True)}


def rank(
    study: StudyResult, candidates: Sequence[Candidate] | None = None, *, sensors: Mapping[str, float] | None = None,
    batch: int = 1, threshold: float = THRESHOLD, outcomes: int = 64, seed: int = 0, **usual: Any,
) -> NextExperiment:  # fmt: skip
    """Rank candidates by their expected information about the explanation.

    Explanations without a prediction (an error of these sensors, what remembers) are left out, and said. A candidate
    some of whose runs fail is not chosen. Of the `FINALISTS` best one is chosen by other outcomes, four times as many,
    and the information of what was chosen is found again with as many.

    Args:
        study: The study.
        candidates: What could be done; by default `usual_candidates` of the training data.
        sensors: Noise by channel of the default candidates; by default as in the data.
        batch: Experiments to do together.
        threshold: Bits below which none is worth it.
        outcomes: Simulated for each explanation.
        seed: Of the simulation.
        **usual: Signals, amplitudes, starts, duration and rows of `usual_candidates`.

    Raises:
        InputError: No candidates, or one that does not fit the model; settings of default candidates beside given ones;
            a study of outputs, or one read from an older file.
    """
    if not study.explanations:
        raise InputError("The study holds no explanations, as in files of before: run find_missing_effects again.")
    if any(study.train.is_output(name) for name in study.explanations):
        raise InputError("What to measure next is found by simulating runs, and an output has none: study a rate.")
    if batch < 1 or outcomes < 2 or not threshold >= 0:
        raise InputError("Ranking needs a batch of at least 1, at least 2 outcomes and a threshold of at least 0.")
    if candidates is not None and (sensors or usual):
        raise InputError(f"{', '.join([*usual] or ['sensors'])} describes default candidates: leave candidates out.")
    every = joined(study.explanations)
    known = [e for e in every if e.components]
    about = pd.DataFrame(
        [{"name": e.name, "probability": e.probability, "predicts": bool(e.components)} for e in every],
        columns=["name", "probability", "predicts"],
    )
    if len(known) < 2:
        text = "Fewer than two likely explanations predict anything: no experiment can be chosen to tell them apart."
        if len(every) == 1 and every[0].probability >= ALONE:
            text = f"One explanation is left ({every[0].name}): nothing needs to be told apart."
        elif len(every) == 1:
            text = (
                f"Besides {every[0].name} (probability {every[0].probability:.2f}) no explanation is likely enough to "
                "be told apart from it by an experiment."
            )
        return NextExperiment(pd.DataFrame(), (), Information(0.0, 0.0), 0.0, about, text)
    p = np.array([e.probability for e in known])
    p = p / np.sum(p)
    asked = _question(study, known, outcomes, seed)
    if candidates is None:
        candidates = usual_candidates(study.train, sensors or usual_sensors(study), **usual)
    if not candidates:
        raise InputError("Ranking needs at least one candidate: give some, or a start.")
    for each in candidates:
        _check(asked, each)
    found = predict(asked, candidates)
    alone = [_information(asked, [each], p) for each in found]
    # The largest share that was seen, of whichever outcomes.
    fails = [float(np.max(each.failed)) for each in found]
    closer, again = (_question(study, known, FINER * outcomes, seed + k) for k in (1, 2))
    while True:
        picked, finer = _picked(asked, closer, found, alone, p, fails, batch)
        after = predict(again, [candidates[i] for i in picked]) if picked else []
        if _able(fails, picked, after):
            break
    chosen = tuple(candidates[i] for i in picked)
    information = _information(again, after, p) if picked else Information(0.0, 0.0)
    shown = tuple(responses(again, each, known) for each in after)
    if information.bits < max(threshold, SURE * information.error, LEAST):
        chosen = ()
    rows = [
        {
            "candidate": each.candidate.name, "information": value.bits, "error": value.error,
            "reach": max(_far(x) for x in each.reach.values()), "fails": fails[i], "said": _said(each, fails[i]),
        }
        for i, each in enumerate(found)
        for value in (finer.get(i, alone[i]),)
    ]  # fmt: skip
    table = pd.DataFrame(rows)
    # Finalists first: the figures of the others are of fewer outcomes, and the largest of many is too large.
    order = sorted(range(len(rows)), key=lambda i: (i not in finer, -rows[i]["information"]))
    table = table.iloc[order].reset_index(drop=True)
    # What is seen of more outcomes counts: a failure among them too.
    mind = [said for i, each in zip(picked, after, strict=True) if (said := _said(each, fails[i]))]
    text = _sentence(known, every, chosen, information, entropy(p), mind, bool(picked), threshold)
    return NextExperiment(table, chosen, information, entropy(p), about, text, shown)


def _picked(
    asked: Question, closer: Question, found: Sequence[Predicted], alone: Sequence[Information], p: np.ndarray,
    fails: list[float], batch: int,
) -> tuple[list[int], dict[int, Information]]:  # fmt: skip
    """Candidates that are chosen one after another, and what the finalists of the first choice tell."""
    picked: list[int] = []
    finer: dict[int, Information] = {}
    while len(picked) < batch:
        left = [i for i, share in enumerate(fails) if share <= FAILS and i not in picked]
        if not left:
            break
        beside = {i: _information(asked, [found[j] for j in (*picked, i)], p) if picked else alone[i] for i in left}
        finalists = sorted(left, key=lambda i, now=beside: -now[i].bits)[:FINALISTS]
        # In one go: the noise of experiments that are done together is their own.
        near = predict(closer, [found[i].candidate for i in (*picked, *finalists)])
        if not _able(fails, (*picked, *finalists), near):
            picked = [i for i in picked if fails[i] <= FAILS]
            continue
        done, last = near[: len(picked)], near[len(picked) :]
        values = {i: _information(closer, [*done, each], p) for i, each in zip(finalists, last, strict=True)}
        if not picked:
            finer = values
        picked.append(max(finalists, key=lambda i, now=values: now[i].bits))
    return picked, finer


def _able(fails: list[float], each: Sequence[int], seen: Sequence[Predicted]) -> bool:
    """Whether more outcomes of candidates say that none of them fails too often; what was seen is noted."""
    for i, predicted in zip(each, seen, strict=True):
        fails[i] = max(fails[i], float(np.max(predicted.failed)))
    return all(fails[i] <= FAILS for i in each)


def _question(study: StudyResult, known: Sequence[Explained], outcomes: int, seed: int) -> Question:
    # As the study weighed it: coefficients are what is left beside means that are stated.
    simulation = study.base.centred().simulator(study.train).rounded(study.train.columns)
    if still := [s for s in simulation.states if s not in (*simulation.equations, *study.explanations)]:
        raise InputError(f"The state {still[0]!r} has no equation to integrate: add it to the simulation.")
    return Question(simulation, study.train, known, study.base.rows.rates_measured, outcomes, seed)


def _check(asked: Question, candidate: Candidate) -> None:
    """Refuse a candidate that the model cannot be simulated for."""
    states, inputs = asked.simulation.states, asked.simulation.inputs
    if lacking := [name for name in states if name not in asked.data.states]:
        raise InputError(f"The data lack the state {lacking[0]!r}: what runs reach is compared with its range.")
    for what, given, needed in (("start", candidate.start, states), ("inputs", candidate.inputs, inputs)):
        if lacking := [name for name in needed if name not in given]:
            raise InputError(f"{what} of candidate {candidate.name!r}: {lacking[0]!r} is missing; give it a value.")
        if unknown := [name for name in given if name not in needed]:
            raise InputError(f"{what} of candidate {candidate.name!r}: there is no {unknown[0]!r} in the model.")
    if unknown := [name for name in candidate.sensors if name not in states]:
        raise InputError(
            f"sensors of candidate {candidate.name!r}: there is no state {unknown[0]!r}; there are {', '.join(states)}."
        )


def _information(asked: Question, each: Sequence[Predicted], p: np.ndarray) -> Information:
    together = [reduce(Products.beside, own) for own in zip(*(e.products for e in each), strict=True)]
    weights = np.array([component.weight for component in asked.components])
    logs = of_explanations(np.stack([own.log_density() for own in together], axis=1), asked.of, weights)
    return expected_information(logs, each[0].truth, p)


def _said(each: Predicted, fails: float) -> str:
    said = [
        f"{name} reaches {far:.2g} times the data's range: extrapolation"
        if np.isfinite(far)
        else f"{name} is elsewhere than in the data, where it never moved: extrapolation"
        for name, x in each.reach.items()
        if (far := _far(x)) > BEYOND
    ]
    if fails > 0:
        share = f"{fails:.1%}" if fails >= 0.001 else "under 0.1%"
        said.append(f"{share} of the runs fail under an explanation: unsafe")
    if not each.resolved:
        said.append("the steps do not follow its path")
    return "; ".join(said)


def _far(reach: np.ndarray) -> float:
    """The 95 % quantile, which may be infinite, so that no two values are averaged."""
    return float(np.nanquantile(reach, 0.95, method="higher"))


def _sentence(
    known: Sequence[Explained], every: Sequence[Explained], chosen: Sequence[Candidate], found: Information,
    total: float, mind: Sequence[str], able: bool, threshold: float,
) -> str:  # fmt: skip
    names = ", ".join(e.name for e in known)
    left = [f"{e.name} (probability {e.probability:.2f})" for e in every if not e.components]
    more = f" Nothing is predicted under {', '.join(left)}, which is left out." if left else ""
    worth = f"{max(found.bits, 0.0):.2f} ± {found.error:.2f} of {total:.2f} bits"
    if chosen:
        what = " and ".join(f"({each.name})" for each in chosen)
        how = "Together, chosen one after another (greedy), they are" if len(chosen) > 1 else "It is"
        warned = f" Mind: {'; '.join(dict.fromkeys(mind))}." if mind else ""
        return f"Measure next: {what}. {how} expected to tell {worth} between {names}.{warned}{more}"
    if not able:
        return f"Under every candidate some runs fail: give smaller amplitudes or other starts.{more}"
    if found.bits >= max(SURE * found.error, LEAST):
        least = f"the threshold of {threshold:.3g} bits"
        return f"No candidate is worth {least} ({names}): the best is expected to tell {worth}.{more}"
    how = "would" if found.bits < LEAST else "is sure to"
    return f"No candidate {how} tell them apart ({names}): the best is expected to tell {worth}.{more}"
