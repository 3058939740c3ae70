"""Rows of measured rates, or of an output, near what was found: delays are undone in the data, all else is linear."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.noise.weighted import correlation_and_sd
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.grid.noise.latent_force import ForcedRates, KnownNoise, LatentForce, rough_noise
from bayes_greybox.discovery.linearise.sensor_rows import at_end, beyond, earlier, mended, usable
from bayes_greybox.discovery.regressors.build import regressors_of
from bayes_greybox.discovery.sensor_errors.channels import (
    DELAY,
    ChannelSuspect,
    Rate,
    calibrated,
    suspect_columns,
    undone,
)
from bayes_greybox.discovery.sensor_errors.drift import drift_columns
from bayes_greybox.discovery.sensor_errors.late import Late, in_step, late_states
from bayes_greybox.discovery.sensor_errors.memory import memory_columns
from bayes_greybox.discovery.sensor_errors.samples import SampleNoise, Smoother, known_rates
from bayes_greybox.model.assemble import with_rounding
from bayes_greybox.model.program import AnyProgram, Program
from bayes_greybox.model.rows.row_kind import RowKind
from bayes_greybox.physics.catalogue.effects import BoundEffect

from .modelled_rate import modelled_rate
from .near import Point, Rows
from .period import period_of

JITTER = "change of {}"
"""What noise grows with where the time stamps jitter: that of the rate, or of an output."""


@dataclass(eq=False)
class RateRows:
    """Makes rows of one equation whose rates, or whose output, were measured.

    Attributes:
        model: The model before.
        train: Measurements as they came.
        equation: The studied state or output.
        effects: Effects bound to columns.
        smooth: Frees states of the noise on their samples.
        clipped: Rows at which a channel's sensor was at its end, by channel.
        misread: Rows at which a state's or an input's sensor slipped, by channel.
        late: States that were late against the state that is their rate, which is undone first.
        in_step: Standard deviations of the delay between a state and its rate whose samples agree, for both by name.
        bare: Modelled rate of the simulation, before anything was found.
    """

    model: Program
    train: Trajectories
    equation: str
    effects: Sequence[BoundEffect]
    smooth: Smoother = field(init=False)
    clipped: dict[str, Bool[np.ndarray, " n_obs"]] = field(init=False)
    misread: dict[str, Bool[np.ndarray, " n_obs"]] = field(init=False)
    late: dict[str, Late] = field(init=False)
    in_step: dict[str, float] = field(init=False)
    bare: Rate = field(init=False)

    def __post_init__(self) -> None:
        model, train = self.model, self.train
        self.smooth = Smoother(train, known_rates(model.simulator(train), train))
        self.bare = modelled_rate(model, train, self.equation, ())
        self.clipped = at_end(train, self.equation)
        better, self.misread = mended(train, self.equation, self.bare)
        measured = self.smooth(better)
        left = {name: noise.left for name, noise in self.smooth.noise.items()}
        simulation = model.simulator(train)
        self.late = late_states(measured, simulation, left)
        self.in_step = in_step(measured, simulation, left)
        self._measured = earlier(measured, self.late)
        self._out = (*self.clipped.values(), *self.misread.values(), *beyond(train, self.late))

    def near(self, point: Point) -> Rows:
        """Return rows near a point."""
        delays = delays_of(point.sensors)
        whole = undone(self._measured, self.equation, delays)
        used = usable(self._measured, self.equation, delays, self._out)
        data = whole.keep(used)
        rate = modelled_rate(self.model, whole, self.equation, point.added)
        effects = [effect for effect in self.effects if point.weighs(effect.label)]
        found = regressors_of(self.model, data, self.equation, effects, point.values)
        columns = [
            (self._known(suspect), column[used])
            for suspect, column in suspect_columns(whole, self.equation, rate)
            if point.weighs(suspect.key) and (suspect.channel not in self.late or suspect.kind != DELAY)
        ]
        found.suspect(columns, [s.key for s in point.sensors])
        # Delays were undone, and each is added again as its size times its column.
        late = {s.key: size for s, size in point.sensors.items() if s.kind == DELAY}
        for k, column in enumerate(found.columns):
            if column.suspect is not None and column.suspect.key in late:
                size = late[column.suspect.key] * column.scale / found.target_scale
                found.shown = found.shown + size * found.values[:, k]
        # What was there at rows that are out is remembered too.
        elements = chain(memory_columns(whole, point.weighs), drift_columns(whole, point.weighs))
        found.remember((memory, table[used]) for memory, table in elements)
        own = found.rows
        period = period_of(data, self.equation)
        floor = with_rounding(own.measured / found.target_scale, self.model.noise_floor) ** 2
        force: LatentForce = ForcedRates(
            own.time, own.run, period, correlation_and_sd(own.noise)[1], rough_noise(found.target)
        )
        if not own.noise.independent:
            white = own.whiten(found.target[:, None])[:, 0]
            noise = rough_noise(white) * float(np.sqrt(np.mean(white**2) / np.mean(found.target**2)))
            force = KnownNoise(own.noise, period, force.step, noise)
        place, unit = np.flatnonzero(used), math.log(found.target_scale)
        return Rows(point, self.model, data, found, force, rate, place, self.train.n_obs, floor, unit)

    def _known(self, suspect: ChannelSuspect) -> ChannelSuspect:
        """Return a suspect with what the samples of states and of their rates say of its delay."""
        if suspect.kind != DELAY:
            return suspect
        return replace(suspect, sd=min(suspect.sd, self.in_step.get(suspect.channel, np.inf)))

    @property
    def sample_noise(self) -> dict[str, SampleNoise]:
        """See `Source.sample_noise`."""
        return self.smooth.noise

    @property
    def n_sensor(self) -> int:
        """See `Source.n_sensor`."""
        return 1

    def quantities(self, rows: Rows) -> dict[str, Float[np.ndarray, " n_row"]]:
        """See `Source.quantities`: all columns, the modelled rate, and its change, which jitter turns into noise."""
        data = rows.data
        simulated = self.model.simulator(data).on(data, self.equation)
        found = {**data.columns, f"simulated {rows.regressors.rows.label}": simulated}
        values, runs = rows.rate(data), [data.run == r for r in dict.fromkeys(data.run.tolist())]
        if all(np.sum(own) > 1 for own in runs):
            what = JITTER.format(data.target_in_words(self.equation, article="the "))
            found[what] = np.concatenate([np.gradient(values[own], data.time[own]) for own in runs])
        operator = rows.regressors.rows.operator
        return found if operator is None else {name: column[operator.sample] for name, column in found.items()}

    def put_right(
        self, data: Trajectories, point: Point, sensors: Mapping[ChannelSuspect, float], clock: Trajectories
    ) -> Trajectories:
        """See `Source.put_right`."""
        delays = delays_of(point.sensors)
        out: tuple[np.ndarray, ...] = ()
        if self.equation in data.derivatives:
            data, slips = mended(data, self.equation, self.bare) if self.misread else (data, {})
            out = (*at_end(data, self.equation).values(), *slips.values())
        moved = undone(earlier(self.smooth(data), self.late), self.equation, delays)
        kept = moved.keep(usable(data, self.equation, delays, (*out, *beyond(data, self.late))))
        return calibrated(kept, self.equation, sensors, clock)

    def row_kind(self, point: Point) -> RowKind | None:
        """See `Source.row_kind`."""
        return None

    def with_inputs(self, program: AnyProgram) -> AnyProgram:
        """See `Source.with_inputs`: rows of rates do not ask."""
        return program

    def doubts(self, rows: Rows) -> list[str]:
        """See `Source.doubts`: noise on states, which terms are evaluated at, is a spurious force."""
        return []


def delays_of(sensors: Mapping[ChannelSuspect, float]) -> dict[str, float]:
    """Return the delays among sensor errors, by channel."""
    return {suspect.channel: size for suspect, size in sensors.items() if suspect.kind == DELAY}
