"""The verdict for one equation, from the probabilities of its hypotheses, the checks, and the criteria."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayes_greybox.discovery.grid.table import EFFECT, SENSOR
from bayes_greybox.discovery.grid.weigh import Hypothesis
from bayes_greybox.discovery.ties import likeliest_first

from . import reasons as codes
from .probabilities import EFFECTS, INSTRUMENT, NO_GAP, RECALIBRATE, STOPS, UNKNOWN_KIND, Probabilities, Share
from .reasons import Reason

Part = Callable[[Probabilities, Hypothesis], float]
"""Function that returns the part of a hypothesis's probability that counts for a kind of answer."""

VERDICTS = (NO_GAP, INSTRUMENT, RECALIBRATE, "named", "one of", "partly named", UNKNOWN_KIND)
"""Verdicts from the smallest change of the user's physics to the largest; of several equations the last one counts."""

ONE_LAW_IN_WORDS = "several effects of the same quantity may be one that the catalogue does not have"
"""Reason against effects that together may be one law."""

AND_MORE_IN_WORDS = f"{ONE_LAW_IN_WORDS}, and something is left besides"
"""Reason against them where a discrepancy remains, too."""


@dataclass(frozen=True)
class Place:
    """One effect of the answer, with its share on these columns.

    Rivals in `tied`, likeliest first, are effects by slugs, the same on other columns by its label, sensor errors by
    keys.
    """

    label: str
    slug: str
    share: Share
    tied: tuple[str, ...]


@dataclass(frozen=True)
class Verdict:
    """The verdict for one equation.

    Attributes:
        code: One of `VERDICTS`.
        hypothesis: Likeliest hypothesis behind the verdict.
        remains, left: Probability of a discrepancy beside the answer, and its RMS, scaled.
        negligible: True if a discrepancy remains that is too small to matter in practice.
    """

    code: str
    places: tuple[Place, ...]
    hypothesis: Hypothesis
    sensors: tuple[str, ...]
    remains: float
    left: float
    negligible: bool = False
    reasons: tuple[Reason, ...] = ()
    probabilities: Probabilities = field(kw_only=True, repr=False)

    @property
    def open_ended(self) -> bool:
        """Return whether a discrepancy without a name belongs to the answer."""
        return self.code in ("partly named", UNKNOWN_KIND) or (self.code == "one of" and bool(self.reasons))

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the labels of the answer's effects."""
        return tuple(place.label for place in self.places)

    def against(self, reasons: Sequence[Reason]) -> "Verdict":
        """Return the verdict with more reasons against it: nothing is *named* against its own checks."""
        if not reasons:
            return self
        code = "partly named" if self.code == "named" else self.code
        return replace(self, code=code, reasons=(*self.reasons, *reasons))


def decide(probabilities: Probabilities, rate_size: float, put_right: bool = False) -> Verdict:
    """Return the verdict before its checks.

    1. Something is missing if effects and the unknown together are likelier than no gap, recalibration and instrument.
    2. Of effects, the likeliest set; of sets of its size that are tied with it, the one whose effects are likeliest in
       sum. *Named* needs each of them with the probability and the agreement that `Criteria` ask for; a discrepancy
       beside them makes it *partly named*.
    3. *No gap* is practical: a discrepancy without a name below a share of the modelled rate is none; `rate_size` is
       the RMS of that rate over that of the target. Beside it a wrong coefficient and a wrong sensor are said as ever.

    Where `put_right`, a sensor's error was undone before hypotheses were weighed.
    """
    verdict = _of_hypotheses(probabilities, rate_size)
    return replace(verdict, code=INSTRUMENT) if put_right and verdict.code == NO_GAP else verdict


def _of_hypotheses(probabilities: Probabilities, rate_size: float) -> Verdict:
    criteria, by_kind = probabilities.criteria, probabilities.by_kind
    if by_kind[EFFECTS] + by_kind[UNKNOWN_KIND] <= criteria.missing:
        code = max(STOPS[:-1], key=lambda kind: by_kind[kind])
        return _without_effects(probabilities, code, lambda p, h: 1 - p.remains(h))
    if by_kind[EFFECTS] > by_kind[UNKNOWN_KIND]:
        verdict = _with_effects(probabilities, _answering_set(probabilities))
        if verdict.code != UNKNOWN_KIND:
            return verdict
    unknown = _without_effects(probabilities, UNKNOWN_KIND, Probabilities.remains)
    if unknown.left < criteria.negligible * rate_size and _nothing_stands_out(probabilities):
        corrected, misread = (
            max((share.probability for share in shares.values()), default=0.0) > criteria.missing
            for shares in (probabilities.by_correction, probabilities.by_sensor)
        )
        code = RECALIBRATE if corrected else INSTRUMENT if misread else NO_GAP
        answer = _without_effects(probabilities, code, lambda p, h: 1.0)
        return replace(answer, left=unknown.left, negligible=True)
    return unknown


def _nothing_stands_out(probabilities: Probabilities) -> bool:
    """Return whether no effect is likely, and the unknown does not stand for effects that were discounted."""
    p, criteria = probabilities, probabilities.criteria
    nameless = sum(h.probability * p.remains(h) for h in p.weighed.hypotheses if not p.effects(h))
    likeliest_effect = max((share.probability for share in p.by_effect.values()), default=0.0)
    return nameless > criteria.nameless * p.by_kind[UNKNOWN_KIND] and likeliest_effect <= criteria.missing


def _answering_set(probabilities: Probabilities) -> tuple[str, ...]:
    """Return, of the sets tied with the likeliest and of its size, the one whose effects are likeliest in sum.

    An effect may be likelier than its rival although its likeliest set is not.
    """
    by_set, by_place = probabilities.by_set, probabilities.by_place
    first = next(iter(by_set))
    least = probabilities.criteria.tied * by_set[first].probability
    alike = [names for names, share in by_set.items() if len(names) == len(first) and share.probability >= least]
    return max(alike, key=lambda names: round(sum(by_place[name].probability for name in names), 6))


def _sensor_names(probabilities: Probabilities, hypothesis: Hypothesis) -> list[str]:
    regressors = probabilities.weighed.table.regressors
    return [regressors[i].name for i in hypothesis.members if regressors[i].kind == SENSOR]


def _likely_sensors(probabilities: Probabilities, hypothesis: Hypothesis) -> tuple[str, ...]:
    by_sensor, names = probabilities.by_sensor, _sensor_names(probabilities, hypothesis)
    return tuple(name for name in names if by_sensor[name].probability >= probabilities.criteria.missing)


def _without_effects(probabilities: Probabilities, code: str, part: Part) -> Verdict:

    def log_weight(h: Hypothesis) -> float:
        if code not in (UNKNOWN_KIND, probabilities.kind_of(h)):
            return -np.inf
        return h.log_weight + float(np.log(max(part(probabilities, h), 1e-300)))

    every = probabilities.weighed.hypotheses
    best = max([h for h in every if not probabilities.effects(h)] or every, key=log_weight)
    unknown = code == UNKNOWN_KIND
    sensors = _likely_sensors(probabilities, best) if unknown else tuple(_sensor_names(probabilities, best))
    remains = probabilities.by_kind[UNKNOWN_KIND]
    return Verdict(code, (), best, sensors, remains, best.left, probabilities=probabilities)


def _with_effects(probabilities: Probabilities, chosen: tuple[str, ...]) -> Verdict:
    criteria, gap = probabilities.criteria, probabilities.weighed.gap_square
    with_set = [h for h in probabilities.weighed.hypotheses if probabilities.effects(h) == chosen]
    mass = sum(h.probability for h in with_set)
    remains = sum(h.probability * probabilities.remains(h) for h in with_set) / mass
    share_left = sum(h.probability * h.left**2 for h in with_set) / mass / gap
    best = max(with_set, key=lambda h: h.log_weight)
    discounted, plain = (probabilities.members(best, EFFECT, stacking) for stacking in (True, False))
    stacked = bool(plain) and all(less < trust for (_, less), (_, trust) in zip(discounted, plain, strict=True))
    places = [_place(probabilities, best, chosen, label) for label in chosen]
    places = likeliest_first(places, lambda place: place.share.probability)
    more = remains >= criteria.missing and share_left >= criteria.remainder
    if more and max(place.share.probability for place in places) <= criteria.missing:
        code = UNKNOWN_KIND
    elif more or stacked:
        code = "partly named"
    else:
        code = "named" if all(min(place.share) >= criteria.named for place in places) else "one of"
    law = Reason(codes.ONE_LAW_AND_MORE, AND_MORE_IN_WORDS) if more else Reason(codes.ONE_LAW, ONE_LAW_IN_WORDS)
    reasons = (law,) if stacked else ()
    sensors = _likely_sensors(probabilities, best)
    return Verdict(code, tuple(places), best, sensors, remains, best.left, False, reasons, probabilities=probabilities)


def _place(probabilities: Probabilities, best: Hypothesis, chosen: tuple[str, ...], label: str) -> Place:
    """Return one effect of a set with its rivals, given the other effects."""
    effect = next(each for each in probabilities.weighed.table.regressors if each.group == label)
    others = tuple(sorted(other for other in chosen if other != label))
    beside = _sensor_names(probabilities, best)
    rivals: dict[str, float] = {}
    for h in probabilities.weighed.hypotheses:
        names = probabilities.effects(h)
        if len(names) == len(chosen) and set(others) <= set(names):
            (there,) = set(names) - set(others) or {label}
            in_place = [each for each in probabilities.members(h, EFFECT) if each[0].group == there]
            rival, trust = max(in_place, key=lambda item: item[1])
            name = there if rival.name == effect.name and there != label else rival.name
        elif names == others:
            # A sensor's error may stand in an effect's place too: an offset in that of a constant force.
            errors = [each for each in probabilities.members(h, SENSOR) if each[0].name not in beside]
            if len(errors) != 1:
                continue
            ((rival, trust),) = errors
            name, trust = rival.name, trust * (1 - probabilities.remains(h))
        else:
            continue
        rivals[name] = rivals.get(name, 0.0) + trust * h.probability
    least = probabilities.criteria.tied * rivals.get(effect.name, 0.0)
    ordered = likeliest_first(rivals, rivals.__getitem__)
    tied = tuple(name for name in ordered if name != effect.name and rivals[name] >= least)
    return Place(label, effect.name, probabilities.by_place[label], tied)
