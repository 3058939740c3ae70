"""Free runs of the model before and after: each started where the measurements start, and left alone."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_greybox.criticism.bands import Band, band_holds
from bayes_greybox.criticism.free_run import FreeRunner
from bayes_greybox.data.samples.clipping import clipped_states
from bayes_greybox.data.samples.starts import Starts, estimate_starts
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.decision.vetoes import FAILURE, FREE_RUN
from bayes_greybox.discovery.sensor_errors import channels
from bayes_greybox.discovery.sensor_errors.channels import ChannelSuspect, Sizes
from bayes_greybox.discovery.sensor_errors.noisy_inputs import without_noise
from bayes_greybox.model.program import Program

from .amendment import Added, Amendment
from .interval import INTERVAL, INTERVAL_ENDS

PATH_DRAWS = 40
"""Posterior draws behind the intervals of free runs."""


@dataclass(frozen=True)
class FreePath:
    """One state in free run from the start of each run: bands before, of the start alone, and after; the measurement.

    `measured` is as the sensor showed it; without a sensor, on the path through the samples put right. `holds` says
    what the band after holds: "90 % band: coefficients, nonlinear parameters, f, start".
    """

    time: np.ndarray
    run: np.ndarray
    measured: np.ndarray
    before: Band
    after: Band
    holds: str = ""


class FreeRuns:
    """Free runs of the model before and after, compiled once for all data with the same columns."""

    def __init__(
        self, model: Program, amendments: Mapping[str, Amendment], interpolation: str | Sequence[str] | None = None
    ) -> None:
        self.amendments = amendments
        every = list(amendments.values())
        self.hidden = {state.name for each in every for state in (*each.hidden, *each.slopes)}
        self.model = self.before = model
        self.moved = any(each.parameters for each in every)
        for amendment in every if self.hidden or self.moved else ():
            # The model before has them too, where they drive nothing.
            self.model = amendment.model(self.model)
            self.before = replace(amendment, parameters={}).model(self.before)
        self.interpolation = model.rows.interpolation if interpolation is None else interpolation
        self._runners: dict[tuple, tuple[FreeRunner, Mapping[str, Added]]] = {}

    def __call__(
        self, data: Trajectories, part: str, starts: Starts | None = None, seed: int = 0
    ) -> tuple[dict[str, FreePath], list[tuple]]:
        """Return paths by state, and rows of the gap table; both empty if a state has no equation to integrate."""
        amendments, given = self.amendments, data
        data = self._with_hidden(given, self.model)
        equations = self.model.simulator(data, lacking=True).equations
        if not amendments or not set(data.state_names) <= {*equations, *amendments}:
            return {}, []
        sensors, clock = self._sensors(data)
        right = self._without_errors(data, sensors, clock)
        start = estimate_starts(data) if starts is None else starts
        every = list(amendments.values())
        n_draw = PATH_DRAWS if not start.exact or any(len(a.after.indices) or a.discrepancy for a in every) else 1
        # The model before runs from the very starts of the draws after; from exact ones once.
        n_before = 1 if start.exact else n_draw
        first = start.draws(n_draw, np.random.default_rng(seed))
        runner, added = self._runner(data, n_before, n_draw, self.model)
        parameters = {name: (jnp.asarray(a.coefficients), jnp.asarray(a.weights)) for name, a in added.items()}
        if sensors or self.moved:
            # Before, nothing was known of the sensors; after, right inputs drive the path from where it was. Hidden
            # states of the two follow other values of parameters.
            def begun(measured: Trajectories) -> np.ndarray:
                own = estimate_starts(measured) if starts is None else start
                return own.draws(n_draw, np.random.default_rng(seed))

            seen, earlier = data, runner
            if self.moved:
                seen = self._with_hidden(given, self.before)
                earlier = self._runner(seen, n_before, n_draw, self.before)[0]
            both = [
                earlier(seen, jax.tree.map(lambda x: x[:n_before], parameters), begun(seen)[:n_before]),
                runner(right, jax.tree.map(lambda x: x[n_before:], parameters), begun(right)),
            ]
            states, failed_at = np.concatenate([x for x, _ in both]), np.concatenate([t for _, t in both], axis=1)
            for i, name in enumerate(data.state_names):
                states[n_before:, :, i] = channels.as_shown(states[n_before:, :, i], name, data, sensors, clock)
        else:
            states, failed_at = runner(data, parameters, np.concatenate([first[:n_before], first]))
        # A state without a sensor is compared with the path through the samples put right.
        unseen = set() if data.samples is None else {*data.state_names} - {*data.samples.state_names}
        measured_after = {name: (right if name in unseen else data).states[name] for name in data.state_names}
        sources = {
            "coefficients": any(np.ptp(a.after.draws, axis=0).any() for a in every),
            "nonlinear parameters": any(np.ptp(a.after.inner, axis=0).any() for a in every),
            "f": any(a.discrepancy is not None for a in every),
            "start": not start.exact,
        }
        holds = band_holds(INTERVAL, sources)
        paths, errors = _compared(data, measured_after, states, n_before, holds)
        rows = [(part, *row) for row in (*errors, *_failures(data, failed_at, n_before))]
        # Hidden states of an effect are no part of the model before, and are not shown.
        shown = {name: path for name, path in paths.items() if name not in self.hidden}
        return shown, [row for row in rows if row[2] not in self.hidden]

    def _with_hidden(self, data: Trajectories, model: Program) -> Trajectories:
        """Return data with the hidden states of a model, started as on the path through the samples."""
        if self.hidden <= {*data.state_names} and not self.moved:
            return data
        samples = data.samples or data
        return model.rows.complete_all(samples, tuple(self.amendments), model.simulator(samples))

    def _sensors(self, data: Trajectories) -> tuple[Sizes, Trajectories]:
        """Return sensor errors of states and inputs, and the data of their clock; none if two equations disagree."""
        errors: dict[ChannelSuspect, float] = {}
        by_key: dict[str, float] = {}
        clock = data
        for amendment in self.amendments.values():
            for suspect, size in amendment.sensors.items():
                if suspect.channel not in (*data.columns, channels.STATES):
                    continue
                if by_key.setdefault(suspect.key, size) != size:
                    return {}, data
                errors[suspect], clock = size, amendment.clock or data
        return errors, clock

    def _without_errors(self, data: Trajectories, sensors: Sizes, clock: Trajectories) -> Trajectories:
        """Return the data without sensor errors, with as many rows. Samples have a path of their own."""
        if not sensors:
            return data
        right = channels.calibrated(without_noise(data.samples or data, sensors), "", sensors, clock)
        right = channels.shifted(right, channels.late_by(right, sensors))
        if data.samples is None:
            return right
        return self.model.rows.complete_all(right, tuple(self.amendments), self.model.simulator(right))

    def _runner(
        self, data: Trajectories, n_before: int, n_draw: int, model: Program
    ) -> tuple[FreeRunner, Mapping[str, Added]]:
        key = (data.state_names, data.input_names, n_before, n_draw, model is self.model)
        if key not in self._runners:
            added = {name: a.added(n_before, n_draw) for name, a in self.amendments.items()}
            # An integrator cannot stay on a jump.
            rounded = {name: [term.rounded(data.columns) for term in each.terms] for name, each in added.items()}
            added = {name: each._replace(terms=rounded[name]) for name, each in added.items()}
            self._runners[key] = (
                FreeRunner(self._rate(data, added, model), self.interpolation, rtol=1e-6, atol=1e-7),
                added,
            )
        return self._runners[key]

    def _rate(
        self, data: Trajectories, added: Mapping[str, Added], model: Program
    ) -> Callable[[Array, Array, Array, dict], Array]:
        simulation = model.simulator(data, lacking=True).rounded(data.columns)
        names = (*data.state_names, *data.input_names)
        places = {name: data.state_names.index(name) for name in self.amendments}

        def right_hand_side(t: Array, x: Array, u: Array, args: dict) -> Array:
            rate = simulation.rate(t, x, u)
            columns = dict(zip(names, (*x, *u), strict=True))
            for name, (coefficient, weight) in args.items():
                # Sums and a mask, which compile into the step; products and scatters would be calls at each stage.
                terms = added[name].terms
                gain = sum((coefficient[i] * term.evaluate(columns) for i, term in enumerate(terms)), jnp.zeros(()))
                if weight.shape[0]:
                    at = {name: value[None] for name, value in columns.items()}
                    gain = gain + jnp.sum(weight * self.amendments[name].features(at)[0])
                rate = rate + jnp.where(jnp.arange(len(rate)) == places[name], gain, 0.0)
            return rate

        return right_hand_side


def relative(errors: Any, size: float) -> Any:
    """Return errors, of which some may be beyond all numbers, over the size of a measurement; NaN of data at rest."""
    with np.errstate(over="ignore"):
        return errors / size if size > 0 else np.full(np.shape(errors), np.nan)


def _compared(
    data: Trajectories, measured_after: Mapping[str, np.ndarray],
    states: Float[np.ndarray, "n_draw n_obs n_state"], n_before: int, holds: str,
) -> tuple[dict[str, FreePath], list[tuple]]:  # fmt: skip
    """Return paths, and their errors, of integrated states: `n_before` of the model before, then those after."""
    paths, rows = {}, []
    at_end = {} if data.samples is None else clipped_states(data.samples)
    for i, name in enumerate(data.state_names):
        measured = {"before": data.states[name], "after": measured_after[name]}
        draws = {"before": states[:n_before, :, i], "after": states[n_before:, :, i]}
        before, after = (Band.surviving(each, INTERVAL) for each in draws.values())
        paths[name] = FreePath(data.time, data.run, measured["after"], before, after, holds)
        spread = float(np.std(measured["before"]))
        # A sensor at its end shows no error.
        alive = np.isfinite(states[:, :, i]).all(axis=0) & ~at_end.get(name, np.zeros(data.n_obs, bool))

        def error(values: np.ndarray, target: np.ndarray, alive=alive, spread=spread) -> Any:
            return relative(np.sqrt(np.mean((target[alive] - values[..., alive]) ** 2, axis=-1)), spread)

        means = [float(error(draws[key].mean(axis=0), measured[key])) for key in draws]
        rows.append((FREE_RUN, name, *means, *np.quantile(error(draws["after"], measured["after"]), INTERVAL_ENDS)))
    return paths, rows


def _failures(data: Trajectories, failed_at: Float[np.ndarray, "n_run n_draw"], n_before: int) -> list[tuple]:
    """Return the time to the first failure of any run, before and after, if there is one."""
    if not np.isfinite(failed_at).any():
        return []
    begun = np.array([data.time[data.run == i][0] for i in range(data.n_run)])
    lasted = failed_at - begun[:, None]
    first = np.where(np.isfinite(lasted), lasted, np.inf).min(axis=0)
    interval = np.quantile(first[n_before:], INTERVAL_ENDS, method="nearest")
    times = np.array([np.median(first[:n_before]), np.median(first[n_before:]), *interval])
    # Never is no number: records have null for it, and tables the word.
    return [(FAILURE, "all", *np.where(np.isfinite(times), times, np.nan))]
