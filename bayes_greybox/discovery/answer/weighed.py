"""Probabilities over all explanations in all worlds: of kinds of answers, of effects, suspects, noises and memories.

A rest that stays beside an effect may be an unknown mechanism that the effect merely imitates: beside a rest that
carries the share s of the gap's square, an effect counts with 1 − √s, √s being the rest's RMS over the gap's, and √s
goes to *unknown*. That is a judgement, not a theorem; it keeps a dominant effect and distrusts a stand-in. Where the
samples contradict each other, an effect no larger than what that does to the rate goes to *unknown* in the same way,
and answers without effects are judged by their own motion (see `doubt`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bayes_greybox.discovery.evidence.ties import likeliest_first, ranked
from bayes_greybox.discovery.suspects.channels import LAG
from bayes_greybox.discovery.weighing.sets import LAWFUL, RECALIBRATED, Explanation, imitated
from bayes_greybox.discovery.weighing.worlds import World, weights

from .doubt import Doubt, artefact, standing

STOPS = ("no gap", "recalibrate", "instrument", "unknown")
"""Explanations without an effect."""

EFFECTS = "effects"
"""Kind of those with effects."""

STACKED = 0.5
"""Probability that three laws of one variable, or two of which one bends, are one law that has no name here."""

FAINT = 1e-4
"""Explanations less likely than this take for their own what a process in time leaves beside the likeliest."""


class Mirror(NamedTuple):
    """A lag of the sensor that does what a lag of an input does.

    Attributes:
        channel: The state that it shows.
        share: Probability that it is this, of the two.
        instead: The input that would lag.
        time: Of the lag, as it was weighed.
        step: From sample to sample.
    """

    channel: str
    share: float
    instead: str = ""
    time: float = math.nan
    step: float = 1.0

    @property
    def name(self) -> str:
        """Of the fault, for tables."""
        return f"{LAG} of {self.channel}"


class Weighed:
    """All explanations of all worlds, with their probabilities.

    Args:
        worlds: Likeliest first.
        doubts: Contradictions among the samples.
        mirrors: What else effects may be, by their bindings.
    """

    def __init__(
        self, worlds: Sequence[World], doubts: Sequence[Doubt] = (), mirrors: Mapping[str, Mirror] | None = None
    ) -> None:  # fmt: skip
        self.worlds, self.doubts, self.mirrors = worlds, doubts, mirrors or {}
        # That nothing explains the motion but effects speaks for them, not against.
        self._against_effects = [doubt for doubt in doubts if doubt.denies in ("", EFFECTS)]
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
                    in_time = usual if world.model.process_share else 0.0
                    share = e.share_left if e.leaves_rest else in_time
                self.items.append((world, e, probability, share))
        with np.errstate(divide="ignore"):
            self.items = ranked(self.items, lambda item: float(np.log(item[2])))
        # Probability of each effect of an explanation to be what an error of the measurement does.
        self._artefacts: dict[tuple[int, Explanation], dict[int, float]] = {}
        for world, e, p, _ in self.items if self._against_effects else ():
            if e.effects and p > FAINT:
                sizes = world.sizes(e)
                self._artefacts[id(world), e] = {i: artefact(self._against_effects, sizes[i]) for i in e.effects}

    def names(self, world: World, e: Explanation) -> tuple[str, ...]:
        """Bindings of an explanation's effects, sorted."""
        return tuple(sorted(world.evaluations.binding(i) for i in e.effects))

    def kind(self, world: World, e: Explanation) -> str:
        """What an explanation without effects says."""
        if world.leaves_rest(e):
            return "unknown"
        # Who is told of the sensors alone leaves the coefficient that is wrong besides.
        if e.kind == RECALIBRATED:
            return "recalibrate"
        return "instrument" if e.suspects else "no gap"

    def counted(self, world: World, e: Explanation, p: float, share: float) -> float:
        """Probability p of an explanation, less what of it counts as unknown."""
        if not e.effects:
            return p * self._stands[self.kind(world, e)]
        return self._of_effects(world, e, p, share) * (1 - self.mirrored(world, e))

    def _of_effects(self, world: World, e: Explanation, p: float, share: float) -> float:
        """The same of effects, or of what else does the same."""
        return p * (1 - imitated(share)) * self._alone(world, e) * (1 - min(self.artefacts(world, e).values()))

    def _alone(self, world: World, e: Explanation) -> float:
        """Probability that the effects of an explanation are not all one law without a name."""
        return 1 - STACKED if set(stacked(world, e)) == set(e.effects) else 1.0

    def mirrored(self, world: World, e: Explanation) -> float:
        """Probability that all effects of an explanation are faults of the sensor that do the same."""
        return math.prod(map(self._instead, self.names(world, e)))

    def _instead(self, binding: str) -> float:
        """Probability that an effect on its columns is a fault of the sensor."""
        return self.mirrors[binding].share if binding in self.mirrors else 0.0

    def artefacts(self, world: World, e: Explanation) -> dict[int, float]:
        """Probability that each effect of an explanation is what an error of the measurement does."""
        return self._artefacts.get((id(world), e), dict.fromkeys(e.effects, artefact(self._against_effects, 0.0)))

    @cached_property
    def by_kind(self) -> dict[str, float]:
        """Probabilities of no gap, recalibration, instrument, unknown, and effects; they sum to one."""
        found: dict[str, float] = dict.fromkeys((*STOPS, EFFECTS), 0.0)
        for world, e, p, share in self.items:
            real = self.counted(world, e, p, share)
            found[EFFECTS if e.effects else self.kind(world, e)] += real
            instead = self._of_effects(world, e, p, share) - real if e.effects else 0.0
            found["instrument"] += instead
            found["unknown"] += p - real - instead
        return found

    @property
    def likeliest_kind(self) -> str:
        """First whether something is missing, with a name or without, then the likeliest of these kinds of `by_kind`.

        What may be a fault of the sensor as well counts for the effect: it has no other model.

        So does what may be one law without a name for the likeliest effects, if these are what it is the sum of.
        """
        instead, one, likeliest = 0.0, 0.0, next(iter(self.by_set), ())
        for world, e, p, share in self.items:
            if e.effects:
                real = self._of_effects(world, e, p, share)
                instead += real * self.mirrored(world, e)
                if self.names(world, e) == likeliest:
                    one += real / self._alone(world, e) - real
        found = {**self.by_kind, EFFECTS: self.by_kind[EFFECTS] + instead + one}
        found["instrument"] -= instead
        found["unknown"] -= one
        missing = found[EFFECTS] + found["unknown"]
        among = (EFFECTS, "unknown") if missing > sum(found.values()) - missing else STOPS[:-1]
        return max(among, key=lambda kind: found[kind])

    @cached_property
    def _stands(self) -> dict[str, float]:
        """Factors of the probabilities of answers without effects, in the light of their own motion."""
        found: dict[str, float] = dict.fromkeys(STOPS, 0.0)
        for world, e, p, _ in self.items:
            if not e.effects:
                found[self.kind(world, e)] += p
        parametric = {kind: p for kind, p in found.items() if kind != "unknown"}
        after = standing(parametric, self.doubts, self.worlds[0].evaluations.odds.suspect)
        return {kind: after[kind] / p if p and kind in after else 1.0 for kind, p in found.items()}

    @cached_property
    def by_effect(self) -> dict[str, float]:
        """Probability that an effect is missing, wherever it acts, by slug, largest first."""
        # In the catalogue's order, which ties stay in.
        found = {w.evaluations.name(i): 0.0 for w in self.worlds for i in w.evaluations.statistics.of_kind("effect")}
        for world, e, p, share in self.items:
            doubtful, artefacts = {world.evaluations.name(i) for i in stacked(world, e)}, self.artefacts(world, e)
            own: dict[str, float] = {}
            instead: dict[str, float] = {}
            for i in e.effects:
                slug = world.evaluations.name(i)
                own[slug] = min(own.get(slug, 1.0), artefacts[i])
                # On two columns it is missing if one of them is no fault.
                instead[slug] = instead.get(slug, 1.0) * self._instead(world.evaluations.binding(i))
            for slug, wrong in own.items():
                real = p * (1 - imitated(share)) * (1 - STACKED if slug in doubtful else 1.0)
                found[slug] += real * (1 - wrong) * (1 - instead[slug])
        return likeliest_first(found)

    @cached_property
    def by_place(self) -> dict[str, float]:
        """Probability that an effect is missing on its own columns, and no fault of the sensor, by its binding."""
        return {binding: p * (1 - self._instead(binding)) for binding, p in self._on_columns.items()}

    @cached_property
    def by_mirror(self) -> dict[str, float]:
        """Probability of each fault of the sensor that does what an effect does, by that effect's binding."""
        return {binding: self._on_columns.get(binding, 0.0) * self._instead(binding) for binding in self.mirrors}

    @cached_property
    def _on_columns(self) -> dict[str, float]:
        """Probability of each effect on its own columns, or of the fault that does the same, by its binding."""
        found: dict[str, float] = {}
        for world, e, p, share in self.items:
            doubtful, artefacts = stacked(world, e), self.artefacts(world, e)
            for i in e.effects:
                binding = world.evaluations.binding(i)
                real = p * (1 - imitated(share)) * (1 - STACKED if i in doubtful else 1.0)
                found[binding] = found.get(binding, 0.0) + real * (1 - artefacts[i])
        return found

    @cached_property
    def by_suspect(self) -> dict[str, float]:
        """Probability of each suspect about a channel, by its key; beside a rest it may be an imitation as well."""
        found: dict[str, float] = {}
        for world, e, p, share in self.items:
            for i in e.suspects:
                suspect = world.evaluations.statistics.columns[i].suspect
                assert suspect is not None
                real = 1.0
                if i not in world.always:
                    real = 1 - imitated(share) if world.leaves_rest(e) else real
                    real *= 1.0 if e.effects else self._stands[self.kind(world, e)]
                found[suspect.key] = found.get(suspect.key, 0.0) + p * real
        return likeliest_first(found)

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
        """Probability that what remains remembers, by what it remembers, in words; largest first.

        What may be a force that nobody measured as well has the less of it.
        """
        found: dict[str, float] = {}
        for world, e, p, _ in self.items:
            if e.memory:
                memory = world.evaluations.statistics.columns[e.memory[0]].memory
                assert memory is not None
                found[memory.text] = found.get(memory.text, 0.0) + p * e.remembers
        return likeliest_first(found)

    @cached_property
    def by_quantity(self) -> dict[tuple[str, ...], float]:
        """Probability that a law of some columns alone is missing, of one name, of several or of none; largest first.

        A quantity is surer than its laws' names: which of three frictions it is matters less than that it is a force
        of the velocity. What remembers is no law of columns alone.
        """
        found: dict[tuple[str, ...], float] = {}
        for world, e, p, share in self.items:
            artefacts = self.artefacts(world, e)
            # Probability that none of the effects of a quantity is there.
            none: dict[tuple[str, ...], float] = {}
            for i in e.effects:
                if not world.evaluations.statistics.columns[i].formula.states:
                    key = quantity(world, i)
                    fault = self._instead(world.evaluations.binding(i))
                    none[key] = min(none.get(key, 1.0), 1 - (1 - imitated(share)) * (1 - artefacts[i]) * (1 - fault))
            if e.kind == LAWFUL:
                none[quantity(world, e.memory[0])] = 0.0
            for key, absent in none.items():
                found[key] = found.get(key, 0.0) + p * (1 - absent)
        return likeliest_first(found)

    @cached_property
    def by_set(self) -> dict[tuple[str, ...], float]:
        """Probability of each set of effects, whatever remains beside it, by bindings."""
        found: dict[tuple[str, ...], float] = {}
        for world, e, p, _ in self.items:
            if e.effects:
                key = self.names(world, e)
                found[key] = found.get(key, 0.0) + p
        return likeliest_first(found)


def stacked(world: World, e: Explanation) -> tuple[int, ...]:
    """Effects of the same columns that may well be one law that the catalogue does not have, and not several.

    Two plain laws of one variable are common (Coulomb friction and drag, y² and y³); three, or two of which one has an
    inner parameter to bend, fit whatever one law looks like.
    """
    columns = world.evaluations.statistics.columns
    groups: dict[tuple[str, ...], list[int]] = {}
    for i in e.effects:
        groups.setdefault(quantity(world, i), []).append(i)
    many = [g for g in groups.values() if len(g) > 2 or (len(g) == 2 and any(columns[i].inner for i in g))]
    return tuple(i for group in many for i in group)


def quantity(world: World, index: int) -> tuple[str, ...]:
    """Columns of the data that an effect, or a law without a name, is a function of."""
    column = world.evaluations.statistics.columns[index]
    names = column.formula.symbols if column.effect is None else column.effect.names.values()
    return tuple(sorted(set(names)))
