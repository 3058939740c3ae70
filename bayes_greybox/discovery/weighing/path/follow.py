"""What is missing along the path of a system: its rows are linear near a model, and that model is what was found.

Every explanation is weighed on the rows near one model, the likeliest explanation of the turn before, until it stays
the same. An explanation far from that model fits badly in any case; one that fits as well is near it, since both follow
the same samples. Where what was found remembers, its hidden states are states of the model; those of the others are
followed along its path.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.samples.clipping import clipped_states
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.suspects.channels import DELAY, ChannelSuspect, as_shown
from bayes_greybox.model.program import AnyProgram, Program
from bayes_greybox.physics.catalogue.effects import BoundEffect

from ..aligned import Aligned
from ..alignment import modelled_rate
from .laws import weigh_laws
from .near import Near, hidden_states, remembering
from .sensors import put_right
from .turns import Turns


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

    def with_inputs(self, program: AnyProgram) -> AnyProgram:
        """That model, its inputs held where they were found to be."""
        if program.rows.interpolation == self.model.rows.interpolation:
            return program
        return replace(program, rows=program.rows.held())

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
    report("following the path of the samples")
    model, near, nearer = Turns(quantities, model, train, equation, effects, odds, most, report).settled()
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
