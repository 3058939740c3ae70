"""What the weighed explanations come to for one equation: one object that sentence, tables and page are made of."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from bayes_greybox.discovery.evidence.ties import likeliest_first
from bayes_greybox.discovery.weighing.sets import Explanation, imitated
from bayes_greybox.discovery.weighing.worlds import World

from .doubt import Doubt
from .weighed import EFFECTS, FAINT, STOPS, Mirror, Weighed, stacked

VERDICTS = ("no gap", "instrument", "recalibrate", "named", "one of", "partly named", "unknown")
"""From what asks least of the user's physics to what asks most; of several equations the last one speaks."""

SURE = 0.9
"""Probability from which on an effect is named."""

TIED = 0.05
"""An effect in the place of another is tied with it from this share of its probability on."""

SAME = 0.1
"""Effects whose curves in each other's place differ by less, n RMS²/σ², are one curve on these data."""

ONE_LAW = "several effects of the same quantity may be one that the catalogue does not have"
"""What speaks against effects that together may be one law."""

AND_MORE = f"{ONE_LAW}, and something is left besides"
"""The same where they leave something."""

NEGLIGIBLE, SUBSTANTIAL = 0.01, 0.25
"""Share of the gap left over up to which effects name it, and from which on even "partly named" is too much."""


@dataclass(frozen=True)
class Place:
    """One effect of the answer.

    Attributes:
        index: Its column in the best world.
        slug: Its name.
        probability: That it is missing on its columns.
        tied: What could stand in its place, likeliest first: effects by their slugs, itself on other columns by its
            binding ("cube(r=u)"), and faults of sensors by their keys ("lag of y").
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
        weighed: All explanations with their probabilities.
        against: What speaks against the verdict, in words.
    """

    worlds: Sequence[World]
    verdict: str
    places: tuple[Place, ...]
    explanation: Explanation
    world: World
    remainder: float
    share_left: float
    weighed: Weighed = field(repr=False)
    against: tuple[str, ...] = ()

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
    def kind(self) -> str:
        """What the explanation behind the answer is: one of `STOPS`, or `EFFECTS`."""
        return EFFECTS if self.explanation.effects else self.weighed.kind(self.world, self.explanation)

    @property
    def open_ended(self) -> bool:
        """Whether something is left that has no name: not where all that is open is which of the same curves it is."""
        if self.verdict == "one of":
            return bool(self.against) or not all(p.together >= SURE and set(p.tied) <= set(p.same) for p in self.places)
        return self.verdict in ("partly named", "unknown")


def decide(
    found: Sequence[World], doubts: Sequence[Doubt] = (), mirrors: Mapping[str, Mirror] | None = None
) -> Finding:  # fmt: skip
    """The answer, before its checks and its free runs.

    1. Whether something is missing: effects and the unknown together against no gap, recalibration and the instrument.
       Then which of these is likeliest.
    2. Of effects, the likeliest set. *Named* needs each of them with probability `SURE`, and nothing substantial left
       over, as f or as a process in time; below that it is *one of*, though all of them be one curve on these data: a
       sensor's offset is one with a force that stays, and another law is another one beyond these data.
    3. What remains beside a dominant set makes it *partly named*; effects that leave more are stand-ins: *unknown*.
    4. Effects that are as likely as not an error of the measurement are no part of the answer.

    Args:
        found: Worlds, likeliest first.
        doubts: Contradictions among the samples.
        mirrors: Faults of the sensor that effects may be as well, by their bindings.
    """
    weighed = Weighed(found, doubts, mirrors)
    # As the tables have it, so that verdict and tables cannot contradict each other, but for what looks the same.
    top = weighed.likeliest_kind
    if top == EFFECTS:
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
    return answer_of(weighed, top)


def answer_of(weighed: Weighed, kind: str) -> Finding:
    """The likeliest answer of a kind without effects.

    Raises:
        StopIteration: There is none.
    """
    world, e, share = next((w, e, s) for w, e, _, s in weighed.items if not e.effects and weighed.kind(w, e) == kind)
    # What only imitates the unknown is not added to anybody's model; the tables show that it was weighed.
    e = weighed.without_imitations(world, e)
    left = 1.0 if kind == "unknown" else share
    return Finding(weighed.worlds, kind, (), e, world, weighed.by_kind["unknown"], left, weighed)


def rivals(finding: Finding) -> list[Finding]:
    """Other answers without effects that are not unlikely beside one; none beside effects, and none beside unknown."""
    weighed, own = finding.weighed, finding.kind
    if own not in STOPS[:-1]:
        return []
    kinds = {weighed.kind(w, e) for w, e, *_ in weighed.items if not e.effects}
    return [answer_of(weighed, k) for k in STOPS[:-1] if k in kinds - {own} and weighed.by_kind[k] >= TIED]


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
    against, more = (), remainder >= 0.5 and share >= NEGLIGIBLE
    if stacked(world, e):
        against = (AND_MORE if more else ONE_LAW,)
    places = tuple(_place(weighed, world, e, chosen, i) for i in e.effects)
    if more:
        verdict = "partly named" if share < SUBSTANTIAL else "unknown"
    elif against:
        verdict = "partly named"
    elif all(p.probability >= SURE for p in places):
        verdict = "named"
    else:
        # Unsure of a name for the rest's or a doubt's sake, with no other that could stand in its place: that there is
        # nothing at all, or another set, is no rest.
        rest = remainder >= 0.5 or all(_lost(weighed, world, p) for p in places if p.probability < SURE)
        verdict = "partly named" if rest and not any(p.tied for p in places) else "one of"
    return Finding(weighed.worlds, verdict, places, e, world, remainder, remainder * share, weighed, against)


def _place(weighed: Weighed, world: World, e: Explanation, chosen: tuple[str, ...], index: int) -> Place:
    """One effect, with those that could stand in its place given the others."""
    known = world.evaluations
    own, slug = known.binding(index), known.name(index)

    def told(w: World, i: int) -> str:
        """What tells an effect from this one: its name, or of the same name its columns."""
        return w.evaluations.binding(i) if w.evaluations.name(i) == slug else w.evaluations.name(i)

    others = tuple(sorted(b for b in chosen if b != own))
    beside = _suspected(world, e)
    rivals: dict[str, float] = {}
    mirrored: dict[tuple[str, str], float] = {}
    places: dict[str, dict[str, float]] = {}
    columns: dict[str, int] = {}
    for w, x, p, share in weighed.items:
        names = weighed.names(w, x)
        if len(names) == len(chosen) and set(others) <= set(names):
            (binding,) = set(names) - set(others) or {own}
            column = next(i for i in x.effects if w.evaluations.binding(i) == binding)
            name = told(w, column)
        elif names == others and not w.leaves_rest(x) and len(_suspected(w, x) - beside) == 1:
            # A sensor's error may stand in an effect's place too: an offset in that of a constant force.
            (binding,) = (name,) = _suspected(w, x) - beside
            column = next(i for i in x.suspects if _key(w, i) == name)
        else:
            continue
        artefacts = weighed.artefacts(w, x)
        wrong = max((q for i, q in artefacts.items() if w.evaluations.binding(i) == binding), default=0.0)
        counted = p * (1 - imitated(share)) * (1 - wrong)
        rivals[name] = rivals.get(name, 0.0) + counted
        there = places.setdefault(name, {})
        there[binding] = there.get(binding, 0.0) + counted
        if w is world:
            # The likeliest comes first.
            columns.setdefault(binding, column)
        if binding in weighed.mirrors:
            mirror = weighed.mirrors[binding]
            mirrored[name, mirror.name] = mirrored.get((name, mirror.name), 0.0) + counted * mirror.share
    mass = rivals[own]
    for (name, fault), p in mirrored.items():
        rivals[name] -= p
        rivals[fault] = rivals.get(fault, 0.0) + p
    tied = tuple(
        name for name, p in likeliest_first(rivals).items()
        if name != own and p >= TIED * mass
    )  # fmt: skip
    beside_it = [i for i in e.columns if i != index]

    def one_curve(name: str) -> bool:
        # Where only the place is open the name is no answer: whoever adds the effect must know where.
        if elsewhere(name, slug) or name not in places:
            return False
        least = min(TIED * mass, max(places[name].values()))
        likely = [binding for binding, p in places[name].items() if p >= least]
        return all(b in columns and known.apart(beside_it, index, columns[b]) < SAME for b in likely)

    same = tuple(filter(one_curve, tied))
    probability = weighed.by_place[own]
    together = min(1.0, probability + sum(rivals[name] for name in tied))
    return Place(index, slug, probability, tied, together, same)


def _lost(weighed: Weighed, world: World, place: Place) -> bool:
    """Whether most of what a name lacks is what counts as unknown of the explanations that have it."""
    binding = world.evaluations.binding(place.index)
    held = sum(p for w, e, p, _ in weighed.items if binding in weighed.names(w, e))
    return held - place.probability > 0.5 * (1 - place.probability)


def elsewhere(name: str, slug: str) -> bool:
    """Whether what could stand in an effect's place is the same effect on other columns.

    Args:
        name: What could.
        slug: Of the effect.
    """
    return name.startswith(f"{slug}(")


def _suspected(world: World, e: Explanation) -> frozenset[str]:
    """Keys of the suspects of an explanation."""
    return frozenset(_key(world, i) for i in e.suspects)


def _key(world: World, index: int) -> str:
    suspect = world.evaluations.statistics.columns[index].suspect
    assert suspect is not None
    return suspect.key
