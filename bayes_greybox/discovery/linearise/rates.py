"""Rows of measured rates, or of an output: delays and sure gains are undone in the data, all else is linear."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.noise.weighted import correlation_and_sd
from bayes_greybox.data.samples.clipping import clipped
from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.grid.latent_force import ForcedRates, KnownNoise, LatentForce, rough_noise
from bayes_greybox.discovery.grid.points import OUTPUT_SCALES, SENSOR_SCALES
from bayes_greybox.discovery.regressors.regressors import Regressors
from bayes_greybox.discovery.sensor_errors import channels, kinematics
from bayes_greybox.discovery.sensor_errors.channels import ChannelSuspect, ErrorColumns, Rate, Sizes
from bayes_greybox.discovery.sensor_errors.memory import drift_columns, memory_columns
from bayes_greybox.discovery.sensor_errors.noisy_inputs import noise_columns, noisy_inputs, without_noise
from bayes_greybox.discovery.sensor_errors.samples import Smoother, integrated, known_rates, misread
from bayes_greybox.model.assemble import with_rounding
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.hidden_states import HiddenState

from .near import Point, Rows
from .source import Source, modelled_rate, period_of, regressors_of, with_hidden_states

ByChannel = dict[str, Bool[np.ndarray, " n_obs"]]
"""True at some rows, by channel."""


class RateRows(Source):
    """Rows of one equation whose rates, or whose output, were measured; see `Source`."""

    def __init__(self, model: Program, train: Trajectories, equation: str, effects: Sequence[BoundEffect]) -> None:
        super().__init__(model, train, equation, effects)
        simulation = model.simulator(train)
        self._smooth = Smoother(train, known_rates(simulation, train), integrated(simulation, train))
        self.sample_noise = self._smooth.noise
        self._bare = modelled_rate(model, train, equation, ())
        self.clipped = _at_end(train, equation)
        better, self.misread = _mended(train, equation, self._bare)
        smooth = self._smooth(better)
        noise = {name: each.left for name, each in self.sample_noise.items()}
        if train.filter is not None:
            noise = train.filter.noise_of_states(train.row_steps)
        self.known = kinematics.known_errors(smooth, simulation, noise)
        self._measured = self._right(smooth)
        self._in_step = kinematics.in_step(self._measured, simulation, noise)
        # What smoothing, or the integral of a rate, makes of channels whose samples have something besides.
        self._better = {**noisy_inputs(self._measured), **kinematics.departing(self._measured, simulation, noise)}
        self._sure = kinematics.disagreeing(self._measured, simulation, noise)
        self._decided = False
        self._out = (*self.clipped.values(), *self.misread.values(), *self._beyond(train))
        self._gap = 0.0

    def near(self, point: Point) -> Rows:
        """See `Source.near`."""
        point = replace(point, sensors=self._as_pairs_say(point.sensors))
        # Delays, and gains that samples tell, are undone in the data; all other errors are linear.
        freed = {
            error: size
            for error, size in point.sensors.items()
            if error.kind == channels.DELAY or (error.kind == channels.GAIN and error.key in self._sure)
        }
        delays = channels.delays_of(freed)
        gains = {error.channel: 1.0 + size for error, size in freed.items() if error.kind == channels.GAIN}

        def undone(data: Trajectories) -> Trajectories:
            right = {name: data.column(name) / gain for name, gain in gains.items()}
            return channels.undone(channels.with_columns(data, right), self.equation, delays)

        whole = undone(self._measured)
        used = _usable(self._measured, self.equation, delays, self._out)
        model = with_hidden_states(self.model.at(point.parameters), point.hidden, whole)
        # Hidden states follow the inputs as these were.
        whole = model.rows.complete(whole, self.equation, model.simulator(whole))
        data = whole.keep(used)
        slopes = self.model.named.slopes(self.equation, point.parameters)
        added = (*point.added, *slopes)
        effects = [effect for effect in self.effects if point.weighs(effect.label)]
        regressors = regressors_of(model, data, self.equation, effects, point.values, whole=whole, kept=used)
        # Errors of sensors act on what the user's own terms do, too, before any hypothesis is at hand.
        own = () if point.added else regressors.own_terms()
        rate = modelled_rate(model, whole, self.equation, (*added, *own))
        bare = modelled_rate(model, whole, self.equation, slopes)
        columns, known = [], {error.key for error in self.known}
        driven, bare = _driven(rate, model, self.equation), _driven(bare, model, self.equation)
        noisy = {error: x for error, x in self._better.items() if point.weighs(error.key)}
        better = channels.with_columns(self._measured, {error.channel: x for error, x in noisy.items()})
        noise = noise_columns(whole, undone(better), noisy, driven)
        others = channels.suspect_columns(whole, self.equation, driven)
        drifting = [replace(error, kind=channels.DRIFT) for error in noisy if error.kind == channels.DEPARTURE]
        drifting += [error for error in self._sure.values() if error.kind == channels.DRIFT]
        for error, column in (*_drifts(whole, drifting, driven), *others, *noise):
            error = self._sure.get(error.key, error)
            if error.expected and error.kind == channels.GAIN:
                # A large one with the shape of an effect in it would stand for the effect.
                column = _gain_column(whole, bare, error, gains.get(error.channel))
            elif error.channel in gains and error.kind in (channels.OFFSET, channels.DRIFT):
                # Per unit of what the sensor shows, x = (measured − o)/(1 + κ).
                column = column / gains[error.channel]
            if error.kind == channels.DELAY:
                # Samples of states and of their rates set a limit to a delay.
                error = replace(error, sd=min(error.sd, self._in_step.get(error.channel, np.inf)))
            # No sensor reads what follows from its start.
            seen = error.channel not in whole.computed
            if seen and point.weighs(error.key) and error.key not in known:
                columns.append((error, column[used]))
        regressors.add_sensor_errors(columns, [*(error.key for error in point.sensors), *self._sure])
        self._decide(regressors)
        _show_again(regressors, {error.key: size for error, size in freed.items()})
        # A memory reaches back to rows that are out, too.
        seen = replace(whole, states={name: x for name, x in whole.states.items() if name not in whole.computed})
        elements = chain(memory_columns(seen, point.weighs), drift_columns(seen, point.weighs))
        regressors.remember((memory, table[used]) for memory, table in elements)
        scale = regressors.target_scale
        floor = with_rounding(regressors.rows.measured / scale, self.model.noise_floor) ** 2
        # One gap for all points: otherwise their evidences would not compare.
        self._gap = self._gap or _gap(regressors, floor)
        size = float(np.sqrt(np.mean(regressors.target**2))) * scale
        force = _force(regressors, data, self._gap / size if self._gap and size > 0 else 1.0)
        return Rows(
            point, model, data, regressors, force, rate, np.flatnonzero(used),
            self.train.n_obs, floor, math.log(scale),
        )  # fmt: skip

    def _as_pairs_say(self, sizes: Sizes) -> Sizes:
        """Return sizes of errors; of a gain that is alone of two the size of the samples, which rates know less."""
        sure = {
            error: self._sure[error.key] for error in sizes if error.kind == channels.GAIN and error.key in self._sure
        }
        count = Counter(each.sure for each in sure.values() if each.sure)
        return {**sizes, **{error: each.expected for error, each in sure.items() if count[each.sure] == 1}}

    def _decide(self, regressors: Regressors) -> None:
        """Ask for one of two errors only where both have a column, which the first rows tell for all others."""
        if not self._decided:
            self._decided, called = True, {column.called for column in regressors.columns}
            alone = {error.sure for key, error in self._sure.items() if key not in called}
            for key, error in self._sure.items():
                self._sure[key] = replace(error, sure="" if error.sure in alone else error.sure)
        regressors.columns = [
            replace(column, suspect=self._sure.get(column.called, column.suspect)) if column.suspect else column
            for column in regressors.columns
        ]

    def quantities(self, rows: Rows) -> dict[str, Float[np.ndarray, " n_row"]]:
        """Return all columns, the modelled rate, and its change, which jitter turns into noise."""
        data = rows.data
        simulated = self.model.simulator(data).on(data, self.equation)
        quantities = {**data.columns, f"simulated {rows.regressors.rows.label}": simulated}
        values, runs = rows.rate(data), channels.run_slices(data.run)
        if all(each.stop - each.start > 1 for each in runs):
            name = f"change of {data.target_in_words(self.equation, article='the ')}"
            quantities[name] = np.concatenate([np.gradient(values[each], data.time[each]) for each in runs])
        operator = rows.regressors.rows.operator
        return quantities if operator is None else {k: column[operator.sample] for k, column in quantities.items()}

    def put_right(
        self, data: Trajectories, point: Point, sensors: Sizes, clock: Trajectories, hidden: Sequence[HiddenState] = ()
    ) -> Trajectories:
        """See `Source.put_right`."""
        delays, sensors = channels.delays_of(point.sensors), self._as_pairs_say(sensors)
        out: tuple[np.ndarray, ...] = ()
        if self.equation in data.derivatives:
            data, slips = _mended(data, self.equation, self._bare) if self.misread else (data, {})
            out = (*_at_end(data, self.equation).values(), *slips.values())
        quiet = without_noise(self._right(self._smooth(data)), sensors)
        quiet = kinematics.without_departures(quiet, self.model.simulator(data), sensors)
        right = channels.calibrated(channels.undone(quiet, self.equation, delays), self.equation, sensors, clock)
        # Hidden states follow the right inputs, also where rows are left out.
        model = self.model.at(point.parameters).remembering(hidden, right)
        right = model.rows.complete(right, self.equation, model.simulator(right))
        return right.keep(_usable(data, self.equation, delays, (*out, *self._beyond(data))))

    def _right(self, data: Trajectories) -> Trajectories:
        return kinematics.free_of(data, kinematics.sizes_of(self.known))

    def _beyond(self, data: Trajectories) -> list[Bool[np.ndarray, " n_obs"]]:
        """Return rows at ends of runs that a late state was not measured at."""
        late = channels.delays_of(kinematics.sizes_of(self.known)).values()
        return [~channels.measured_at(data, set(late))] if late and _separable(data) else []


def _drifts(data: Trajectories, errors: Iterable[ChannelSuspect], rate: Rate) -> ErrorColumns:
    """Return drifts of states with their columns: they come before that of the rate, which may have the very same."""
    span = float(np.ptp(data.time))
    if not span > 0:
        return []
    along = (data.time - np.mean(data.time)) / span
    return [(each, -channels.slope_along(data, rate, each.channel, along)) for each in errors]


def _show_again(regressors: Regressors, freed: Mapping[str, float]) -> None:
    """Add what was undone in the data again, as its size times its column: a coefficient is a whole error."""
    regressors.freed = [*regressors.freed, *freed]
    for k, column in enumerate(regressors.columns):
        if column.called in freed:
            size = freed[column.called] * column.scale / regressors.target_scale
            regressors.shown = regressors.shown + size * regressors.values[:, k]


def _gain_column(data: Trajectories, rate: Rate, error: ChannelSuspect, gain: float | None) -> np.ndarray:
    """Return the change of the measured rate per unit of a gain: at data that are free of it, or all the way there."""
    values = data.column(error.channel)
    if gain is not None:
        return -channels.slope_along(data, rate, error.channel, values) / gain
    right = values / (1.0 + error.expected)
    return (rate(channels.with_columns(data, {error.channel: right})) - rate(data)) / error.expected


def _driven(rate: Rate, model: Program, equation: str) -> Rate:
    """Return a rate whose hidden states follow the columns that it is asked at."""
    if not model.starts:
        return rate
    return lambda data: rate(model.rows.complete(data, equation, model.simulator(data)))


def _gap(regressors: Regressors, floor: float) -> float:
    """Return the RMS of what the user's own terms leave of the target, at least that of its rounding, user's units."""
    target = regressors.target
    left = target - regressors.at_rows(regressors.own) @ regressors.least_squares(regressors.own)[0]
    return max(float(np.sqrt(np.mean(left**2))), math.sqrt(floor)) * regressors.target_scale


def _force(regressors: Regressors, data: Trajectories, gap: float) -> LatentForce:
    """Return the latent force and the noise on rows of rates; none beside a filter's noise."""
    rows, target = regressors.rows, regressors.target
    period = period_of(data, rows.equation)
    scales = OUTPUT_SCALES if rows.output else SENSOR_SCALES
    spread = correlation_and_sd(rows.noise)[1]
    force = ForcedRates(rows.time, rows.run, period, spread, rough_noise(target), scales, gap)
    if rows.noise.independent:
        return force
    white = rows.whiten(target[:, None])[:, 0]
    noise = rough_noise(white) * float(np.sqrt(np.mean(white**2) / np.mean(target**2)))
    return KnownNoise(rows.noise, period, force.step, noise, gap)


def _at_end(data: Trajectories, equation: str) -> ByChannel:
    """Return true at rows where the sensor of the rate was at its end, by its name in tables."""
    # A state may rest, and an input may be held; a rate that stays to the last bit where it is largest is clipped.
    if not _separable(data):
        return {}
    values = data.rate(equation)
    # An output may rest too, as a force does in a dead zone; a noisy one does not.
    if data.is_output(equation) and not sample_noise(data.time, values[:, None], data.run_lengths)[0] > 0:
        return {}
    return clipped({data.target_label(equation): values}, data.run)


def _mended(data: Trajectories, equation: str, rate: Rate) -> tuple[Trajectories, ByChannel]:
    """Return the data without slips of sensors, and true where these were, by channel."""
    if not _separable(data) or equation not in data.derivatives:
        return data, {}
    slips, columns, ones = {}, {}, np.ones(data.n_obs)
    for name, values in data.columns.items():
        if name in data.computed:
            continue
        slope = channels.slope_along(data, rate, name, ones)
        out, better = misread(values, data.run, data.rate(equation), slope)
        if np.any(out):
            slips[name], columns[name] = out, better
    return (channels.with_columns(data, columns) if slips else data), slips


def _usable(data: Trajectories, equation: str, delays: Mapping[str, float], out: Sequence[np.ndarray]) -> np.ndarray:
    """Return true for rows that are not out, and whose states and inputs were measured where delays take them."""
    used = channels.within(data, equation, delays) if _separable(data) else np.ones(data.n_obs, bool)
    return np.logical_and.reduce([used, *(~rows for rows in out)])


def _separable(data: Trajectories) -> bool:
    """Return true if a row can be left out: the rows of a filter hang together."""
    return all(noise.local for noise in data.noise.values())
