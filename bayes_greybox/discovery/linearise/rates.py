"""Rows of measured rates, or of an output: delays are undone in the data, all else is linear."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.noise.weighted import correlation_and_sd
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.grid.noise.latent_force import ForcedRates, KnownNoise, LatentForce, rough_noise
from bayes_greybox.discovery.regressors.build import regressors_of
from bayes_greybox.discovery.regressors.regressors import Regressors
from bayes_greybox.discovery.sensor_errors.channels import (
    DELAY,
    ChannelSuspect,
    calibrated,
    delays_of,
    run_slices,
    suspect_columns,
    undone,
)
from bayes_greybox.discovery.sensor_errors.drift import drift_columns
from bayes_greybox.discovery.sensor_errors.late import in_step, late_states
from bayes_greybox.discovery.sensor_errors.memory import memory_columns
from bayes_greybox.discovery.sensor_errors.samples import Smoother, known_rates
from bayes_greybox.model.assemble import with_rounding
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effects import BoundEffect

from .near import Point, Rows
from .period import period_of
from .sensor_rows import at_end, beyond, earlier, mended, usable
from .source import Source, modelled_rate

CHANGE_OF = "change of {}"
"""Name of the change of the rate, or of an output, with which noise grows where the time stamps jitter."""


class RateRows(Source):
    """Rows of one equation whose rates, or whose output, were measured; see `Source`."""

    def __init__(self, model: Program, train: Trajectories, equation: str, effects: Sequence[BoundEffect]) -> None:
        super().__init__(model, train, equation, effects)
        simulation = model.simulator(train)
        self._smooth = Smoother(train, known_rates(simulation, train))
        self.sample_noise = self._smooth.noise
        self._bare = modelled_rate(model, train, equation, ())
        self.clipped = at_end(train, equation)
        better, self.misread = mended(train, equation, self._bare)
        smooth = self._smooth(better)
        noise = {name: each.left for name, each in self.sample_noise.items()}
        self.late = late_states(smooth, simulation, noise)
        self._in_step = in_step(smooth, simulation, noise)
        self._measured = earlier(smooth, self.late)
        self._out = (*self.clipped.values(), *self.misread.values(), *beyond(train, self.late))

    def near(self, point: Point) -> Rows:
        """See `Source.near`."""
        delays = delays_of(point.sensors)
        whole = undone(self._measured, self.equation, delays)
        used = usable(self._measured, self.equation, delays, self._out)
        data = whole.keep(used)
        rate = modelled_rate(self.model, whole, self.equation, point.added)
        effects = [effect for effect in self.effects if point.weighs(effect.label)]
        regressors = regressors_of(self.model, data, self.equation, effects, point.values)
        columns = [
            (self._in_time(error), column[used])
            for error, column in suspect_columns(whole, self.equation, rate)
            if point.weighs(error.key) and (error.channel not in self.late or error.kind != DELAY)
        ]
        regressors.suspect(columns, [error.key for error in point.sensors])
        # Delays were undone, and each is added again as its size times its column.
        late = {error.key: size for error, size in point.sensors.items() if error.kind == DELAY}
        for k, column in enumerate(regressors.columns):
            if column.suspect is not None and column.suspect.key in late:
                size = late[column.suspect.key] * column.scale / regressors.target_scale
                regressors.shown = regressors.shown + size * regressors.values[:, k]
        # A memory reaches back to rows that are out, too.
        elements = chain(memory_columns(whole, point.weighs), drift_columns(whole, point.weighs))
        regressors.remember((memory, table[used]) for memory, table in elements)
        scale = regressors.target_scale
        floor = with_rounding(regressors.rows.measured / scale, self.model.noise_floor) ** 2
        return Rows(
            point, self.model, data, regressors, _force(regressors, data), rate, np.flatnonzero(used),
            self.train.n_obs, floor, math.log(scale),
        )  # fmt: skip

    def _in_time(self, error: ChannelSuspect) -> ChannelSuspect:
        """Return an error with the limit that the samples of states and of their rates set to its delay."""
        limit = self._in_step.get(error.channel, np.inf) if error.kind == DELAY else np.inf
        return replace(error, sd=min(error.sd, limit))

    def quantities(self, rows: Rows) -> dict[str, Float[np.ndarray, " n_row"]]:
        """Return all columns, the modelled rate, and its change, which jitter turns into noise."""
        data = rows.data
        simulated = self.model.simulator(data).on(data, self.equation)
        quantities = {**data.columns, f"simulated {rows.regressors.rows.label}": simulated}
        values, runs = rows.rate(data), run_slices(data.run)
        if all(each.stop - each.start > 1 for each in runs):
            name = CHANGE_OF.format(data.target_in_words(self.equation, article="the "))
            quantities[name] = np.concatenate([np.gradient(values[each], data.time[each]) for each in runs])
        operator = rows.regressors.rows.operator
        return quantities if operator is None else {k: column[operator.sample] for k, column in quantities.items()}

    def put_right(
        self, data: Trajectories, point: Point, sensors: Mapping[ChannelSuspect, float], clock: Trajectories
    ) -> Trajectories:
        """See `Source.put_right`."""
        delays = delays_of(point.sensors)
        out: tuple[np.ndarray, ...] = ()
        if self.equation in data.derivatives:
            data, slips = mended(data, self.equation, self._bare) if self.misread else (data, {})
            out = (*at_end(data, self.equation).values(), *slips.values())
        moved = undone(earlier(self._smooth(data), self.late), self.equation, delays)
        kept = moved.keep(usable(data, self.equation, delays, (*out, *beyond(data, self.late))))
        return calibrated(kept, self.equation, sensors, clock)


def _force(regressors: Regressors, data: Trajectories) -> LatentForce:
    """Return the latent force and the noise on rows of rates; none beside a filter's noise."""
    rows, target = regressors.rows, regressors.target
    period = period_of(data, rows.equation)
    force = ForcedRates(rows.time, rows.run, period, correlation_and_sd(rows.noise)[1], rough_noise(target))
    if rows.noise.independent:
        return force
    white = rows.whiten(target[:, None])[:, 0]
    noise = rough_noise(white) * float(np.sqrt(np.mean(white**2) / np.mean(target**2)))
    return KnownNoise(rows.noise, period, force.step, noise)
