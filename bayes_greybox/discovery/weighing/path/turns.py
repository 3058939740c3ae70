"""Rows taken near what was found, in turns, until it stays, and whether inputs are held between theirs."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.suspects.channels import DELAY, ChannelSuspect
from bayes_greybox.model.estimate.near import near_estimate
from bayes_greybox.model.noise.noise_model import NoiseModel
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.terms import Term

from ..worlds import worlds
from .lags import weigh_lags
from .near import Near, weigh_near

TURNS = 5
"""How often rows are taken anew near what was found."""

FALLS = 3.0
"""Nats by which the evidence may be less on rows near an error of a sensor than it was without: odds of twenty. Beyond,
the error looked likely only near something else."""


BEHIND = 3.0
"""Nats by which held inputs may be behind straight lines before noise and sensors are suspected, and still be followed
to the end: odds of twenty."""


HALF = 0.25
"""Steps within which a delay is half a step."""


class Settled(NamedTuple):
    """The explanation that stays, and how rows are taken near any other one, under the same noise.

    `model` is the model before, its inputs held from each sample to the next where they were found to be.
    """

    model: Program
    near: Near
    nearer: Callable[[Near], Near]


@dataclass(frozen=True)
class Turns:
    """What is weighed in every turn.

    Attributes:
        quantities: What the noise may grow with, of explanations near a model.
        model: The model before.
        train: Samples.
        equation: The learned state.
        effects: Effects bound to columns.
        odds: Prior odds.
        most: Largest number of effects.
        report: Told in words what is being done.
    """

    quantities: Callable[[Near], Mapping[str, np.ndarray]]
    model: Program
    train: Trajectories
    equation: str
    effects: Sequence[BoundEffect]
    odds: Odds
    most: int
    report: Callable[[str], None]

    def settled(self) -> Settled:
        """The likeliest explanation, on rows near itself.

        What inputs do between their samples is weighed too where nobody said it. An input that is held arrives half a
        step late, which beside straight lines looks like an actuator that lags, or like a sensor that is late: so each
        way has the effects and the errors that it may be taken for. That inputs are held has the prior odds of any
        error of a channel.

        Returns:
            The explanation.

        Raises:
            InputError: No path of the model is near the samples.
        """
        begun = self._begun()
        if self.model.rows.interpolation is not None or not self.train.input_names:
            return self._ended(begun)
        self.report("following it with inputs that are held")
        other = replace(self, model=replace(self.model, rows=self.model.rows.held()))
        try:
            held = other._begun()
            # What decides is not known yet: either's noise, and errors of sensors, of which one may be what looks like
            # held inputs, or like inputs that are not. So prior odds do not count here.
            other_end = other._ended(held) if held.log_evidence > begun.log_evidence - BEHIND else None
        except (InputError, np.linalg.LinAlgError):
            other_end = None
        ended = self._ended(begun)
        if other_end is None or not self._likelier(other_end.near, ended.near):
            return ended
        # Half a step late is what holding does: what is held, and half a step off besides, is not held.
        undone = any(abs(each - 0.5) < HALF for each in _delays(other_end.near)) and not _delays(ended.near)
        return ended if undone else other_end

    def _begun(self) -> Near:
        """The likeliest explanation on rows near the one that was likeliest on rows near the model.

        Two turns before noise is weighed: far from the right model a small change of the path goes on otherwise than
        the equations say, which looks like noise that hangs together.
        """
        return self._taken(self._near(_own_terms(self.model, self.train), {}, {}))

    def _ended(self, near: Near) -> Settled:
        """What stays once noise is weighed, then errors of sensors.

        Far from the right model the rows are not quite linear, which looks like a sensor that is a little off: sensors
        are suspected once a path nearer by shows nothing else. What looked like noise may have been such an error.
        """
        nearer, under = self._taken, []
        for suspected in (False, True, True):
            noise = worlds(near.base, self.quantities(near), self.report, near.noise)[0].model
            if under[1:] == [noise.names]:
                break
            under.append(noise.names)
            nearer = partial(self._taken, suspected=suspected, noise=noise)
            near = _stayed(near, nearer)
        return Settled(self.model, weigh_lags(near, nearer, partial(_stayed, taken=nearer)), nearer)

    def _taken(self, before: Near, **settings: Any) -> Near:
        """The likeliest explanation on rows near another one."""
        self.report("following it with what was found")
        return self._near(before.found, before.sensors, before.inner, **settings)

    def _near(
        self, added: Sequence[tuple[Term, float]], sensors: Mapping[ChannelSuspect, float],
        inner: Mapping[str, Mapping[str, float]], suspected: bool = False, noise: NoiseModel | None = None,
        refuted: Collection[str] = (),
    ) -> Near:  # fmt: skip
        return weigh_near(
            self.model, self.train, self.equation, self.effects, self.odds, self.most, added, sensors, inner,
            suspected, noise, refuted,
        )  # fmt: skip

    def _likelier(self, held: Near, near: Near) -> bool:
        """Whether samples say that inputs are held, the prior odds against it included."""
        return held.log_evidence + math.log(self.odds.suspect) > near.log_evidence + math.log1p(-self.odds.suspect)


def _own_terms(model: Program, train: Trajectories) -> tuple[tuple[Term, float], ...]:
    """The model's own terms with their estimate: where all of an equation is learned, nothing else follows a path."""
    if not model.dictionary:
        return ()
    try:
        (equation,) = near_estimate(model, train).assemble(train).values()
    except (InputError, np.linalg.LinAlgError):
        # The study follows the samples all the same, if less surely.
        return ()
    return tuple(equation.ridge())


def _stayed(near: Near, taken: Callable[..., Near]) -> Near:
    """The explanation that stays, rows taken anew near it in turns.

    On rows near one model an error of a sensor may look likely that is no explanation near itself, as a late sensor
    does beside an actuator that lags: its column is a slope along the wrong path. Such an error is left out.

    Args:
        near: The explanation before.
        taken: From an explanation, and the keys of errors that are left out, to the likeliest one on rows near it.
    """
    best, earlier, refuted, turns = None, None, frozenset(), 0
    while turns < TURNS:
        before = near
        near = taken(before, refuted=refuted)
        fresh = _errors(before) - _errors(earlier) if earlier is not None else frozenset()
        if earlier is not None and fresh and near.log_evidence < earlier.log_evidence - FALLS:
            near, best, refuted = earlier, None, refuted | fresh
            earlier = None
            continue
        earlier, turns = before, turns + 1
        best = near if best is None or near.log_evidence > best.log_evidence else best
        if near.stays(before):
            return near
    # Two explanations may lead to each other by turns.
    return best or near


def _delays(near: Near) -> list[float]:
    """Delays that were found, either way, in steps."""
    return [abs(size) / suspect.step for suspect, size in near.sensors.items() if suspect.kind == DELAY]


def _errors(near: Near) -> frozenset[str]:
    """Keys of the errors of sensors that were found."""
    return frozenset(suspect.key for suspect in near.sensors)
