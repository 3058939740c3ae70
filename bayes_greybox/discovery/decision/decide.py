"""The verdict for one equation, from the probabilities of its hypotheses, the checks, and the criteria."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayes_greybox.discovery.grid.hypotheses import Hypothesis
from bayes_greybox.discovery.grid.regressors import EFFECT, SENSOR

from . import reasons as codes
from .probabilities import EFFECTS, NO_GAP, STOPS, UNKNOWN, Probabilities, Share
from .reasons import Reason

VERDICTS = ("no gap", "instrument", "recalibrate", "named", "one of", "partly named", "unknown")
"""From what asks least of the user's physics to what asks most; of several equations the last one speaks."""

ONE_LAW = "several effects of the same quantity may be one that the catalogue does not have"
"""Reason against effects that together may be one law."""

AND_MORE = f"{ONE_LAW}, and something is left besides"
"""Reason against them where they leave something, too."""


@dataclass(frozen=True)
class Place:
    """One effect of the answer.

    Attributes:
        label: The effect on its columns.
        slug: Its name.
        share: Its probability there, with the agreement of the data.
        tied: What could stand in its place, likeliest first: effects by their slugs, itself on other columns by its
            label, and sensor errors by their keys.
        together: Probability of it or one of these.
        family: Its family, and the family's share.
        of_family: Probability of the family, with agreement.
    """

    label: str
    slug: str
    share: Share
    tied: tuple[str, ...]
    together: float
    family: str
    of_family: Share


@dataclass(frozen=True)
class Verdict:
    """The verdict for one equation.

    Attributes:
        code: One of `VERDICTS`.
        places: Effects of the answer; none where it names none.
        hypothesis: The likeliest hypothesis behind it.
        sensors: Sensor errors of the answer, by their names.
        remains: Probability that something remains beside the answer.
        share_left: Share of the gap's square that it carries.
        left: RMS of what remains, scaled.
        negligible: Whether simulation and measurement agree in practice, though something remains.
        reasons: Reasons against the verdict.
    """

    code: str
    places: tuple[Place, ...]
    hypothesis: Hypothesis
    sensors: tuple[str, ...]
    remains: float
    share_left: float
    left: float
    negligible: bool = False
    reasons: tuple[Reason, ...] = ()
    probabilities: Probabilities = field(kw_only=True, repr=False)

    @property
    def open_ended(self) -> bool:
        """Return whether something is left that has no name."""
        return self.code in ("partly named", UNKNOWN) or (self.code == "one of" and bool(self.reasons))

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the effects of the answer, on their columns."""
        return tuple(place.label for place in self.places)

    def against(self, reasons: Sequence[Reason]) -> "Verdict":
        """Return the verdict with what speaks against it: nothing is *named* against its own checks.

        Args:
            reasons: Further reasons against it.
        """
        if not reasons:
            return self
        code = "partly named" if self.code == "named" else self.code
        return replace(self, code=code, reasons=(*self.reasons, *reasons))


def decide(probabilities: Probabilities, rate_size: float, late: bool = False) -> Verdict:
    """Return the verdict before its checks.

    1. Whether something is missing: effects and the unknown together against no gap, recalibration and the instrument.
    2. Of effects, the likeliest set; of sets of its size that are tied with it, the one whose effects are likeliest in
       sum. *Named* needs each of them with the probability and the agreement that `Criteria` ask for; what remains
       beside them makes it *partly named*.
    3. *No gap* is practical: what remains without a name below a share of the modelled rate is none.

    Args:
        probabilities: Of the hypotheses.
        rate_size: RMS of the modelled rate, over that of the target.
        late: Whether a sensor's error was undone before hypotheses were weighed.
    """
    criteria, by_kind = probabilities.criteria, probabilities.by_kind
    missing = by_kind[EFFECTS] + by_kind[UNKNOWN]
    if missing <= criteria.missing:
        code = max(STOPS[:-1], key=lambda kind: by_kind[kind])
        if code == NO_GAP and late:
            code = "instrument"
        return _without_effects(probabilities, code)
    if by_kind[EFFECTS] > by_kind[UNKNOWN]:
        found = _with_effects(probabilities, _chosen(probabilities))
        if found.code != UNKNOWN:
            return found
    found = _without_effects(probabilities, UNKNOWN)
    # What is unknown for the sake of names that are not to be trusted is as large as these.
    nameless = sum(
        h.probability * probabilities.remains(h)
        for h in probabilities.weighed.hypotheses
        if not probabilities.effects(h)
    )
    small = found.left < criteria.negligible * rate_size and 2 * nameless > by_kind[UNKNOWN]
    sure = max((share.probability for share in probabilities.by_effect.values()), default=0.0) > criteria.missing
    corrected = max((share.probability for share in probabilities.by_correction.values()), default=0.0)
    if small and not sure:
        code = "recalibrate" if corrected > criteria.missing else NO_GAP
        return replace(_without_effects(probabilities, code, anything=True), left=found.left, negligible=True)
    return found


def _chosen(probabilities: Probabilities) -> tuple[str, ...]:
    """Return the set of effects to answer with.

    Of the sets that are tied with the likeliest and have its size, it is the one whose effects are likeliest in sum: an
    effect may be likelier than its rival although its likeliest set is not.
    """
    by_set, by_place = probabilities.by_set, probabilities.by_place
    first = next(iter(by_set))
    least = probabilities.criteria.tied * by_set[first].probability
    alike = [names for names, share in by_set.items() if len(names) == len(first) and share.probability >= least]
    return max(alike, key=lambda names: round(sum(by_place[name].probability for name in names), 6))


def _sensors(probabilities: Probabilities, hypothesis: Hypothesis) -> tuple[str, ...]:
    """Return the sensor errors of a hypothesis that are likelier than not."""
    regressors, by_sensor = probabilities.weighed.table.regressors, probabilities.by_sensor
    own = [regressors[i].name for i in hypothesis.members if regressors[i].kind == SENSOR]
    return tuple(name for name in own if by_sensor[name].probability >= probabilities.criteria.missing)


def _without_effects(probabilities: Probabilities, code: str, anything: bool = False) -> Verdict:
    """Return the likeliest answer of a kind without effects."""
    every = probabilities.weighed.hypotheses

    def weight(h: Hypothesis) -> float:
        remains = probabilities.remains(h)
        if code == UNKNOWN:
            return h.log_weight + float(np.log(max(remains, 1e-300)))
        if probabilities.says(h) != code:
            return -np.inf
        return h.log_weight + (0.0 if anything else float(np.log(max(1 - remains, 1e-300))))

    plain = [h for h in every if not probabilities.effects(h)] or list(every)
    best = max(plain, key=weight)
    kept = _sensors(probabilities, best) if code == UNKNOWN else tuple(
        probabilities.weighed.table.regressors[i].name for i in best.members
        if probabilities.weighed.table.regressors[i].kind == SENSOR
    )  # fmt: skip
    left = 1.0 if code == UNKNOWN else 0.0
    return Verdict(
        code, (), best, kept, probabilities.by_kind[UNKNOWN], left, best.left, probabilities=probabilities
    )  # fmt: skip


def _with_effects(probabilities: Probabilities, chosen: tuple[str, ...]) -> Verdict:
    """Return the answer with a set of effects."""
    criteria, every = probabilities.criteria, probabilities.weighed.hypotheses
    own = [h for h in every if probabilities.effects(h) == chosen]
    mass = sum(h.probability for h in own)
    remains = sum(h.probability * probabilities.remains(h) for h in own) / mass
    gap = probabilities.weighed.gap_square
    share_left = sum(h.probability * h.left**2 for h in own) / mass / gap
    best = max(own, key=lambda h: h.log_weight)
    places = tuple(_place(probabilities, best, chosen, label) for label in chosen)
    places = tuple(sorted(places, key=lambda place: -round(place.share.probability, 6)))
    sensors = _sensors(probabilities, best)
    more = remains >= criteria.missing and share_left >= criteria.remainder
    stacked = _stacked(probabilities, best)
    law = Reason(codes.ONE_LAW_AND_MORE, AND_MORE) if more else Reason(codes.ONE_LAW, ONE_LAW)
    reasons = (law,) if stacked else ()
    sure = all(min(place.share) >= criteria.named for place in places)
    if more or stacked:
        code = "partly named"
    elif sure:
        code = "named"
    else:
        code = "one of"
    if more and max(place.share.probability for place in places) <= criteria.missing:
        code = UNKNOWN
    return Verdict(
        code, places, best, sensors, remains, share_left, best.left, reasons=reasons, probabilities=probabilities
    )  # fmt: skip


def _stacked(probabilities: Probabilities, best: Hypothesis) -> bool:
    """Return whether the effects of a hypothesis may all be one law."""
    counted = probabilities.members(best, EFFECT)
    plain = [trust for *_, trust in probabilities.alone(best, EFFECT)]
    return bool(counted) and all(trust < own for (*_, trust), own in zip(counted, plain, strict=True))


def _place(probabilities: Probabilities, best: Hypothesis, chosen: tuple[str, ...], label: str) -> Place:
    """Return one effect with what could stand in its place, given the others."""
    regressors, criteria = probabilities.weighed.table.regressors, probabilities.criteria
    own = next(each for each in regressors if each.group == label)
    others = tuple(sorted(other for other in chosen if other != label))
    beside = {regressors[i].name for i in best.members if regressors[i].kind == SENSOR}
    rivals: dict[str, float] = {}
    for h in probabilities.weighed.hypotheses:
        names = probabilities.effects(h)
        if len(names) == len(chosen) and set(others) <= set(names):
            (there,) = set(names) - set(others) or {label}
            found = [(each, trust) for _, each, trust in probabilities.members(h, EFFECT) if each.group == there]
            each, trust = max(found, key=lambda item: item[1])
            name = there if each.name == own.name and there != label else each.name
        elif names == others:
            # A sensor's error may stand in an effect's place too: an offset in that of a constant force.
            errors = [(e, trust) for _, e, trust in probabilities.members(h, SENSOR) if e.name not in beside]
            if len(errors) != 1:
                continue
            ((each, trust),) = errors
            name, trust = each.name, trust * (1 - probabilities.remains(h))
        else:
            continue
        rivals[name] = rivals.get(name, 0.0) + trust * h.probability
    mass = rivals.get(own.name, 0.0)
    tied = tuple(
        name for name, p in sorted(rivals.items(), key=lambda item: -round(item[1], 6))
        if name != own.name and p >= criteria.tied * mass
    )  # fmt: skip
    share = probabilities.by_place[label]
    together = min(1.0, share.probability + sum(rivals[name] for name in tied))
    return Place(label, own.name, share, tied, together, own.family, probabilities.by_family[own.family])
