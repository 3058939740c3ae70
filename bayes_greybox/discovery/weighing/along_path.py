"""What is missing along the path of a system: its rows are linear near a model, and that model is what was found.

Every explanation is weighed on the rows near one model, the likeliest explanation of the turn before, until it stays
the same. An explanation far from that model fits badly in any case; one that fits as well is near it, since both follow
the same samples. Where what was found remembers, its hidden states are states of the model; those of the others are
followed along its path.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.samples.clipping import clipped_states
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.suspects.channels import DELAY, ChannelSuspect, as_shown
from bayes_greybox.model.estimate.near import near_estimate
from bayes_greybox.model.noise.noise_model import NoiseModel
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.terms import Term

from .aligned import Aligned
from .alignment import modelled_rate
from .lags import weigh_lags
from .laws import weigh_laws
from .near import Near, hidden_states, remembering, weigh_near
from .sensors_along_path import put_right
from .worlds import worlds

TURNS = 5
"""How often rows are taken anew near what was found."""

FALLS = 3.0
"""Nats by which the evidence may be less on rows near an error of a sensor than it was without: odds of twenty. Beyond,
the error looked likely only near something else."""


@dataclass(frozen=True)
class Followed(Aligned):
    """Data along the path, and the sets weighed on them.

    Attributes:
        model: The model with rows near what was found before.
        after: The model with rows near what was found.
        sensors: Errors of sensors and inputs that the path is without.
        clock: Data that drifts were found on.
    """

    model: Program = field(kw_only=True)
    after: Program = field(kw_only=True)
    sensors: Mapping[ChannelSuspect, float] = field(default_factory=dict)
    clock: Trajectories = field(kw_only=True)

    @property
    def n_sensor(self) -> int:
        """As many as states were sampled."""
        assert self.data.samples is not None
        return len(self.data.samples.state_names)

    @property
    def spurious(self) -> float:
        """Nothing: the noise of samples is the rows' own."""
        return 0.0

    @property
    def rates_measured(self) -> bool:
        """No: rates are those of the path."""
        return False

    def shown(self, name: str) -> Float[np.ndarray, " n_obs"]:
        """The path with the errors of its sensor."""
        # The path of an only sensor that is late has its clock already.
        errors = {s: size for s, size in self.sensors.items() if s.kind != DELAY or self.n_sensor > 1}
        return as_shown(self.data.column(name)[None], name, self.data, errors, self.clock)[0]

    def corrected(self, data: Trajectories) -> Trajectories:
        """Any samples of the same sensors with the path through them."""
        return self.model.rows.complete(data, self._equation, self.model.simulator(data))

    def moved(self, data: Trajectories) -> Trajectories:
        """Such data."""
        return self.corrected(data)

    def put_right(
        self, data: Trajectories, sensors: Mapping[ChannelSuspect, float], clock: Trajectories
    ) -> Trajectories:
        """Samples freed of errors of their sensors, with the path through them that right inputs drive."""
        samples = put_right(data.samples or data, self._equation, sensors, clock)
        return self.after.rows.complete(samples, self._equation, self.after.simulator(samples))


def follow(
    quantities: Callable[[Near], Mapping[str, np.ndarray]], model: Program, train: Trajectories, equation: str,
    effects: Sequence[BoundEffect], odds: Odds, most: int, report: Callable[[str], None] = lambda text: None,
) -> Followed:  # fmt: skip
    """Find what is missing, the rows taken near it in turns.

    Args:
        quantities: What the noise may grow with, of explanations near a model.
        model: The model before.
        train: Samples.
        equation: The learned state.
        effects: Effects bound to columns.
        odds: Prior odds.
        most: Largest number of effects.
        report: Told in words what is being done.
    """

    def taken(
        before: Near, suspected: bool = False, noise: NoiseModel | None = None, refuted: frozenset[str] = frozenset()
    ) -> Near:
        report("following it with what was found")
        found = before.found, before.sensors, before.inner
        return weigh_near(model, train, equation, effects, odds, most, *found, suspected, noise, refuted)

    report("following the path of the samples")
    # Twice before noise is weighed: far from the right model a small change of the path goes on otherwise than the
    # equations say, which looks like noise that hangs together.
    near = weigh_near(model, train, equation, effects, odds, most, _own_terms(model, train), {}, {}, False, None)
    near = taken(near)
    for suspected in (False, True):
        # Far from the right model the rows are not quite linear, which looks like a sensor that is a little off:
        # sensors are suspected once a path nearer by shows nothing else.
        noise = worlds(near.base, quantities(near), report, near.noise)[0].model
        nearer = partial(taken, suspected=suspected, noise=noise)
        near = _settled(near, nearer)
    near = weigh_lags(near, nearer, partial(_settled, taken=nearer))
    weigh_laws(near, nearer)
    used = np.ones(near.data.n_obs, bool)
    bare = modelled_rate(near.model, near.data, equation, ())
    samples, hidden = near.data.samples or near.data, hidden_states(near.found)
    after = remembering(model, hidden, train)
    after = replace(after, rows=after.rows.around(near.found))
    try:
        after.rows.complete(samples, equation, after.simulator(samples))
    except InputError:
        # What is likeliest leads away from the samples: they are compared with rows where it was found.
        after, hidden = near.model, near.hidden
    return Followed(
        near.data, near.base, clipped=clipped_states(train.samples or train), rate=near.rate, bare=bare, used=used,
        rows=after.rows, noise=near.noise, hidden=hidden, model=near.model, after=after, sensors=near.sensors,
        clock=train,
    )  # fmt: skip


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


def _settled(near: Near, taken: Callable[..., Near]) -> Near:
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


def _errors(near: Near) -> frozenset[str]:
    """Keys of the errors of sensors that were found."""
    return frozenset(suspect.key for suspect in near.sensors)
