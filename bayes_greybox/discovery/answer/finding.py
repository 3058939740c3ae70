"""What the weighed explanations come to for one equation: one object that sentence, tables and page are made of.

Probabilities are sums over explanations in all worlds. A rest that stays beside an effect may be an unknown mechanism
that the effect merely imitates: beside a rest that carries the share s of the gap's square, an effect counts with
1 − √s, √s being the rest's RMS over the gap's, and √s goes to *unknown*. That is a judgement, not a theorem; it keeps a
dominant effect and distrusts a stand-in. Where the samples contradict each other, an effect no larger than what that
does to the rate goes to *unknown* in the same way (see `doubt`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from bayes_greybox.discovery.weighing.sets import MEMORY, PLAIN, RECALIBRATED, Explanation, imitated
from bayes_greybox.discovery.weighing.worlds import World, weights

from .doubt import Doubt, artefact, unexplained

VERDICTS = ("no gap", "instrument", "recalibrate", "named", "one of", "partly named", "unknown")
"""From what asks least of the user's physics to what asks most; of several equations the last one speaks."""

STOPS = ("no gap", "recalibrate", "instrument", "unknown")
"""Explanations without an effect."""

SURE = 0.9
"""Probability from which on an effect, or effects that the data cannot tell apart, are named."""

TIED = 0.05
"""An effect in the place of another is tied with it from this share of its probability on."""

SAME = 0.1
"""Effects whose log evidences in each other's place differ by less are one curve on these data."""

NEGLIGIBLE, SUBSTANTIAL = 0.01, 0.25
"""Share of the gap left over up to which effects name it, and from which on even "partly named" is too much."""

STACKED = 0.5
"""Probability that three laws of one variable, or two of which one bends, are one law that has no name here."""

FAINT = 1e-4
"""Explanations less likely than this take the likeliest one's share of the gap for their own."""


@dataclass(frozen=True)
class Place:
    """One effect of the answer.

    Attributes:
        index: Its column in the best world.
        slug: Its name.
        probability: That it is missing.
        tied: Slugs that could stand in its place, likeliest first.
        together: Probability of it or one of these.
        same: Those of them that are the same curve on these data.
    """

    index: int
    slug: str
    probability: float
    tied: tuple[str, ...]
    together: float
    same: tuple[str, ...]


@dataclass(frozen=True)
class Finding:
    """The answer for one equation.

    Attributes:
        worlds: Likeliest first.
        verdict: One of `VERDICTS`.
        places: Effects of the answer; none where it names none.
        explanation: The likeliest explanation with these effects, in the best world that has it.
        world: That world.
        remainder: Probability that something remains beside them.
        share_left: Share of the gap that it carries.
        against: What speaks against the verdict, in words.
    """

    worlds: Sequence[World]
    verdict: str
    places: tuple[Place, ...]
    explanation: Explanation
    world: World
    remainder: float
    share_left: float
    against: tuple[str, ...] = ()
    weighed: "Weighed" = field(default=None, repr=False)  # type: ignore[assignment]

    @property
    def base(self) -> tuple[int, ...]:
        """Columns of the effects of the answer."""
        return tuple(place.index for place in self.places)

    def capped(self, against: Sequence[str]) -> "Finding":
        """The finding with what speaks against it: nothing is *named* against the evidence of its own checks."""
        if not against:
            return self
        verdict = "partly named" if self.verdict == "named" else self.verdict
        return replace(self, verdict=verdict, against=(*self.against, *against))

    @property
    def open_ended(self) -> bool:
        """Whether something is left that has no name."""
        return self.verdict in ("one of", "partly named", "unknown")


class Weighed:
    """All explanations of all worlds, with their probabilities.

    Args:
        worlds: Likeliest first.
        doubts: Contradictions among the samples.
    """

    def __init__(self, worlds: Sequence[World], doubts: Sequence[Doubt] = ()) -> None:
        self.worlds, self.doubts = worlds, doubts
        self.items: list[tuple[World, Explanation, float, float]] = []
        for world, p in zip(worlds, weights(worlds), strict=True):
            total = world.total - world.offset
            usual = None
            for e in world.explanations:
                probability = float(p * np.exp(e.log_weight - total))
                if probability > FAINT or usual is None:
                    share = world.share_left(e)
                    usual = share if usual is None else usual
                else:
                    share = e.share_left if e.leaves_rest else usual
                self.items.append((world, e, probability, share))
        self.items.sort(key=lambda item: -item[2])
        # Probability of each effect of an explanation to be what an error of the measurement does.
        self._artefacts: dict[tuple[int, Explanation], dict[int, float]] = {}
        for world, e, p, _ in self.items if doubts else ():
            if e.effects and p > FAINT:
                sizes = world.sizes(e)
                self._artefacts[id(world), e] = {i: artefact(doubts, sizes[i]) for i in e.effects}

    def names(self, world: World, e: Explanation) -> tuple[str, ...]:
        """Bindings of an explanation's effects, sorted."""
        return tuple(sorted(world.evaluations.binding(i) for i in e.effects))

    def kind(self, world: World, e: Explanation) -> str:
        """What an explanation without effects says."""
        if world.leaves_rest(e):
            return "unknown"
        if e.suspects:
            return "instrument"
        return {PLAIN: "no gap", RECALIBRATED: "recalibrate"}[e.kind]

    def counted(self, world: World, e: Explanation, p: float, share: float) -> float:
        """Probability p of an explanation with effects, less what of it counts as unknown."""
        real = p * (1 - imitated(share)) * (1 - STACKED if set(stacked(world, e)) == set(e.effects) else 1.0)
        return real * (1 - min(self.artefacts(world, e).values()))

    def artefacts(self, world: World, e: Explanation) -> dict[int, float]:
        """Probability that each effect of an explanation is what an error of the measurement does."""
        return self._artefacts.get((id(world), e), dict.fromkeys(e.effects, artefact(self.doubts, 0.0)))

    @cached_property
    def by_kind(self) -> dict[str, float]:
        """Probabilities of no gap, recalibration, instrument, unknown, and effects; they sum to one."""
        found: dict[str, float] = {name: 0.0 for name in (*STOPS, "effects")}
        for world, e, p, share in self.items:
            if e.effects:
                real = self.counted(world, e, p, share)
                found["effects"] += real
                found["unknown"] += p - real
            else:
                wrong = p * unexplained(self.doubts)
                found[self.kind(world, e)] += p - wrong
                found["unknown"] += wrong
        return found

    @cached_property
    def by_effect(self) -> dict[str, float]:
        """Probability that an effect is missing, by slug, largest first."""
        found: dict[str, float] = {}
        for world, e, p, share in self.items:
            doubtful, artefacts = {world.evaluations.name(i) for i in stacked(world, e)}, self.artefacts(world, e)
            own: dict[str, float] = {}
            for i in e.effects:
                slug = world.evaluations.name(i)
                own[slug] = min(own.get(slug, 1.0), artefacts[i])
            for slug, wrong in own.items():
                real = p * (1 - imitated(share)) * (1 - STACKED if slug in doubtful else 1.0)
                found[slug] = found.get(slug, 0.0) + real * (1 - wrong)
        for world in self.worlds:
            for i in world.evaluations.statistics.of_kind("effect"):
                found.setdefault(world.evaluations.name(i), 0.0)
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    @cached_property
    def by_suspect(self) -> dict[str, float]:
        """Probability of each suspect about a channel, by its key; beside a rest it may be an imitation as well."""
        found: dict[str, float] = {}
        for world, e, p, share in self.items:
            for i in e.suspects:
                suspect = world.evaluations.statistics.columns[i].suspect
                assert suspect is not None
                real = p * (1 - imitated(share)) if world.leaves_rest(e) and i not in world.always else p
                found[suspect.key] = found.get(suspect.key, 0.0) + real
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    def without_imitations(self, world: World, e: Explanation) -> Explanation:
        """An explanation without the suspects that may as well imitate its rest."""
        if not world.leaves_rest(e):
            return e
        columns = world.evaluations.statistics.columns
        found = {i: suspect.key for i in e.suspects if (suspect := columns[i].suspect) is not None}
        kept = tuple(i for i, key in found.items() if i in world.always or self.by_suspect[key] >= 0.5)
        return e if kept == e.suspects else replace(e, suspects=kept)

    @cached_property
    def by_noise(self) -> dict[str, float]:
        """Probability of each suspect about the noise."""
        found: dict[str, float] = {}
        for world, p in zip(self.worlds, weights(self.worlds), strict=True):
            for name in world.model.names:
                found[name] = found.get(name, 0.0) + float(p)
        return found

    @cached_property
    def by_memory(self) -> dict[str, float]:
        """Probability that what remains remembers, by what it remembers, in words; largest first."""
        found: dict[str, float] = {}
        for world, e, p, _ in self.items:
            if e.kind == MEMORY:
                memory = world.evaluations.statistics.columns[e.memory[0]].memory
                assert memory is not None
                found[memory.text] = found.get(memory.text, 0.0) + p
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    @cached_property
    def by_set(self) -> dict[tuple[str, ...], float]:
        """Probability of each set of effects, whatever remains beside it, by bindings."""
        found: dict[tuple[str, ...], float] = {}
        for world, e, p, _ in self.items:
            if e.effects:
                key = self.names(world, e)
                found[key] = found.get(key, 0.0) + p
        return dict(sorted(found.items(), key=lambda item: -item[1]))


def stacked(world: World, e: Explanation) -> tuple[int, ...]:
    """Effects of the same columns that may well be one law that the catalogue does not have, and not several.

    Two plain laws of one variable are common (Coulomb friction and drag, y² and y³); three, or two of which one has an
    inner parameter to bend, fit whatever one law looks like.
    """
    columns = world.evaluations.statistics.columns
    groups: dict[tuple[str, ...], list[int]] = {}
    for i in e.effects:
        effect = columns[i].effect
        assert effect is not None
        groups.setdefault(tuple(sorted(effect.names.values())), []).append(i)
    many = [g for g in groups.values() if len(g) > 2 or (len(g) == 2 and any(columns[i].inner for i in g))]
    return tuple(i for group in many for i in group)


def decide(found: Sequence[World], doubts: Sequence[Doubt] = ()) -> Finding:
    """The answer, before its checks and its free runs.

    1. What is likeliest of: no gap, recalibration, the instrument, unknown, effects together.
    2. Of effects, the likeliest set. *Named* needs each of them, or what is the same curve, with probability `SURE`,
       and nothing substantial left over, as f or as a process in time; below that it is *one of*.
    3. What remains beside a dominant set makes it *partly named*; effects that leave more are stand-ins: *unknown*.

    4. Effects that are as likely as not an error of the measurement are no part of the answer.

    Args:
        found: Worlds, likeliest first.
        doubts: Contradictions among the samples.
    """
    weighed = Weighed(found, doubts)
    # As the tables have it, so that verdict and tables cannot contradict each other; unknown comes before effects.
    top = max(weighed.by_kind, key=lambda kind: weighed.by_kind[kind])
    if top == "effects":
        chosen = next(iter(weighed.by_set))
        finding = _named(weighed, chosen)
        if finding.verdict == "unknown" and len(chosen) > 1:
            # Stacked stand-ins make way for the one effect that carries the gap, if one does.
            # Of one that was not weighed with a rest it is not known what it leaves.
            with_rest = {weighed.names(w, e) for w, e, *_ in weighed.items if w.leaves_rest(e)}
            singles = [key for key in weighed.by_set if len(key) == 1 and key[0] in chosen and key in with_rest]
            finding = max((_named(weighed, key) for key in singles), key=lambda f: -f.share_left, default=finding)
        finding = _without_artefacts(finding)
        if finding.verdict != "unknown":
            return finding
        top = "unknown"
    world, e, share = next((w, e, s) for w, e, _, s in weighed.items if not e.effects and weighed.kind(w, e) == top)
    # What only imitates the unknown is not added to anybody's model; the tables show that it was weighed.
    e = weighed.without_imitations(world, e)
    remainder = weighed.by_kind["unknown"]
    return Finding(found, top, (), e, world, remainder, 1.0 if top == "unknown" else share, (), weighed)


def _without_artefacts(finding: Finding) -> Finding:
    """The answer without the effects that are as likely as not an error of the measurement."""
    artefacts = finding.weighed.artefacts(finding.world, finding.explanation)
    places = tuple(place for place in finding.places if artefacts[place.index] < 0.5)
    if len(places) == len(finding.places):
        return finding
    return replace(finding, verdict="partly named" if places else "unknown", places=places)


def _named(weighed: Weighed, chosen: tuple[str, ...]) -> Finding:
    """The answer with a set of effects."""
    own = [(w, e, p, s) for w, e, p, s in weighed.items if weighed.names(w, e) == chosen]
    mass = sum(p for _, _, p, _ in own)
    world, e, _, _ = own[0]
    left = [(p, w.share_left(x)) for w, x, p, _ in own if w.leaves_rest(x) and p > FAINT * mass]
    remainder = sum(p for p, _ in left) / mass
    share = sum(p * s for p, s in left) / sum(p for p, _ in left) if left else 0.0
    against = ()
    if stacked(world, e):
        against = ("several effects of the same quantity may be one that the catalogue does not have",)
    places = tuple(_place(weighed, world, e, chosen, i) for i in e.effects)
    if remainder >= 0.5 and share >= NEGLIGIBLE:
        verdict = "partly named" if share < SUBSTANTIAL else "unknown"
    elif against:
        verdict = "partly named"
    elif all(p.probability >= SURE or (p.together >= SURE and set(p.tied) <= set(p.same)) for p in places):
        verdict = "named"
    else:
        # Unsure of a name for the rest's or a doubt's sake alone, with no other that could stand in its place
        alone = (remainder > 1 - SURE or bool(weighed.doubts)) and not any(p.tied for p in places)
        verdict = "partly named" if alone else "one of"
    return Finding(weighed.worlds, verdict, places, e, world, remainder, remainder * share, against, weighed)


def _place(weighed: Weighed, world: World, e: Explanation, chosen: tuple[str, ...], index: int) -> Place:
    """One effect, with those that could stand in its place given the others."""
    known = world.evaluations
    own, slug = known.binding(index), known.name(index)
    others = tuple(sorted(b for b in chosen if b != own))
    beside = _suspected(world, e)
    rivals: dict[str, float] = {}
    evidence: dict[str, float] = {}
    for w, x, p, share in weighed.items:
        names = weighed.names(w, x)
        if len(names) == len(chosen) and set(others) <= set(names):
            (instead,) = set(names) - set(others) or {own}
            name = instead.split("(")[0]
        elif names == others and not w.leaves_rest(x) and len(_suspected(w, x) - beside) == 1:
            # A sensor's error may stand in an effect's place too: an offset in that of a constant force.
            (name,) = _suspected(w, x) - beside
        else:
            continue
        wrong = max((q for i, q in weighed.artefacts(w, x).items() if w.evaluations.name(i) == name), default=0.0)
        rivals[name] = rivals.get(name, 0.0) + p * (1 - imitated(share)) * (1 - wrong)
        evidence[name] = float(np.logaddexp(evidence.get(name, -np.inf), x.log_evidence + w.offset))
    tied = tuple(
        name for name, p in sorted(rivals.items(), key=lambda item: -item[1])
        if name != slug and p >= TIED * rivals[slug]
    )  # fmt: skip
    same = tuple(name for name in tied if abs(evidence[name] - evidence[slug]) < SAME)
    probability = weighed.by_effect[slug]
    together = min(1.0, probability + sum(rivals[name] for name in tied))
    return Place(index, slug, probability, tied, together, same)


def _suspected(world: World, e: Explanation) -> frozenset[str]:
    """Keys of the suspects of an explanation."""
    columns = world.evaluations.statistics.columns
    return frozenset(s.key for i in e.suspects if (s := columns[i].suspect) is not None)
