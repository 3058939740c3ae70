"""Free runs of the model before and after: each started where the measurements start, and left alone."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
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
from bayes_greybox.discovery.answer.amendment import Added, Amendment
from bayes_greybox.discovery.sensor_errors.channels import (
    STATES,
    ChannelSuspect,
    as_shown,
    calibrated,
    driven_later,
    late_by,
    shifted,
)
from bayes_greybox.model.program import Program

LEVEL = 0.9
"""Probability of the intervals."""

PATH_DRAWS = 40
"""Posterior draws behind the intervals of free runs."""


@dataclass(frozen=True)
class FreePath:
    """One state in free run from the start of each run: measured, and bands before and after.

    The band before holds the start alone.

    Attributes:
        time: Times of the rows.
        run: Their runs.
        measured: The state, as its sensor showed it; without a sensor, on the path through the samples put right.
        before: Model before.
        after: Amended model, with the errors of sensors that belong to it.
        holds: What the band after holds, in words: "90 % band: coefficients, inner parameters, f, start".
    """

    time: np.ndarray
    run: np.ndarray
    measured: np.ndarray
    before: Band
    after: Band
    holds: str = ""


class FreeRuns:
    """Free runs of the model before and after, compiled once for all data with the same columns.

    Args:
        model: The model before.
        amendments: By state whose equation was studied.
        interpolation: Of the inputs between samples, see `criticism.free_run.FreeRunner`; by default that of the rows.
    """

    def __init__(
        self,
        model: Program,
        amendments: Mapping[str, Amendment],
        interpolation: str | Sequence[str] | None = None,
    ) -> None:
        self.amendments = amendments
        self.hidden = {state.name for amendment in amendments.values() for state in amendment.hidden}
        self.model = model
        for amendment in amendments.values() if self.hidden else ():
            # The model before has them too, where they drive nothing.
            self.model = amendment.model(self.model)
        self.interpolation = model.rows.interpolation if interpolation is None else interpolation
        self._runners: dict[tuple, tuple[FreeRunner, Mapping[str, Added]]] = {}

    def __call__(
        self, data: Trajectories, part: str, starts: Starts | None = None, seed: int = 0
    ) -> tuple[dict[str, FreePath], list[tuple]]:
        """Paths by state, and rows of the gap table; none where a state has no equation to integrate, or none is new.

        Args:
            data: Measurements to compare with.
            part: "train" or "test".
            starts: State of each run at its first row; estimated from the data by default.
            seed: Seed of their draws.
        """
        amendments, data = self.amendments, self._remembered(data)
        known = self.model.simulator(data, lacking=True).equations
        if not amendments or not set(data.state_names) <= {*known, *amendments}:
            return {}, []
        sensors, clock = self._sensors(data)
        right = self._right(data, sensors, clock)
        given, starts = starts, estimate_starts(data) if starts is None else starts
        varies = any(len(a.after.indices) or a.discrepancy is not None for a in amendments.values())
        n_draw = PATH_DRAWS if varies or not starts.exact else 1
        # The model before runs from the very starts of the draws after; from exact ones once.
        n_before = 1 if starts.exact else n_draw
        begin = starts.draws(n_draw, np.random.default_rng(seed))
        runner, added = self._runner(data, n_before, n_draw)
        parameters = {name: (jnp.asarray(a.coefficients), jnp.asarray(a.weights)) for name, a in added.items()}
        if sensors:
            # Before, nothing was known of the sensors; after, right inputs drive the path from where it was.
            first = begin if given is not None else estimate_starts(right).draws(n_draw, np.random.default_rng(seed))
            each = [
                runner(data, jax.tree.map(lambda x: x[:n_before], parameters), begin[:n_before]),
                runner(right, jax.tree.map(lambda x: x[n_before:], parameters), first),
            ]
            states, failed_at = np.concatenate([x for x, _ in each]), np.concatenate([t for _, t in each], axis=1)
            for i, name in enumerate(data.state_names):
                states[n_before:, :, i] = as_shown(states[n_before:, :, i], name, data, sensors, clock)
        else:
            states, failed_at = runner(data, parameters, np.concatenate([begin[:n_before], begin]))
        # What no sensor showed is compared with the path through what the sensors should have shown.
        unseen = set() if data.samples is None else {*data.state_names} - {*data.samples.state_names}
        after = {name: (right if name in unseen else data).states[name] for name in data.state_names}
        holds = band_holds(LEVEL, _sources(amendments, starts))
        paths, rows = _compared(data, after, part, states, failed_at, n_before, holds)
        # Hidden states of an effect are its own: nobody looks for them in the model before.
        shown = {name: path for name, path in paths.items() if name not in self.hidden}
        return shown, [row for row in rows if row[2] not in self.hidden]

    def _remembered(self, data: Trajectories) -> Trajectories:
        """Data with the hidden states of what was added, where they start as on the path through the samples."""
        if self.hidden <= {*data.state_names}:
            return data
        samples = data.samples or data
        return self.model.rows.complete_all(samples, tuple(self.amendments), self.model.simulator(samples))

    def _sensors(self, data: Trajectories) -> tuple[Mapping[ChannelSuspect, float], Trajectories]:
        """Errors of states' and inputs' sensors in the model after; none where two equations say different ones."""
        found: dict[ChannelSuspect, float] = {}
        by_key: dict[str, float] = {}
        clock = data
        for amendment in self.amendments.values():
            for suspect, size in amendment.sensors.items():
                if suspect.channel not in (*data.columns, STATES):
                    continue
                if by_key.setdefault(suspect.key, size) != size:
                    return {}, data
                found[suspect], clock = size, amendment.clock or data
        return found, clock

    def _right(self, data: Trajectories, sensors: Mapping[ChannelSuspect, float], clock: Trajectories) -> Trajectories:
        """The data without errors of their sensors; as many rows. Samples have a path of their own."""
        if not sensors:
            return data
        right = calibrated(data.samples or data, "", sensors, clock)
        late = late_by(right, sensors)
        right = driven_later(right, {name: by for name, by in late.items() if name in data.input_names})
        right = shifted(right, {name: by for name, by in late.items() if name in right.states})
        if data.samples is None:
            return right
        return self.model.rows.complete_all(right, tuple(self.amendments), self.model.simulator(right))

    def _runner(self, data: Trajectories, n_before: int, n_draw: int) -> tuple[FreeRunner, Mapping[str, Added]]:
        key = (data.state_names, data.input_names, n_before, n_draw)
        if key not in self._runners:
            added = {name: a.added(n_before, n_draw) for name, a in self.amendments.items()}
            # An integrator cannot stay on a jump.
            added = {
                name: each._replace(terms=[term.rounded(data.columns) for term in each.terms])
                for name, each in added.items()
            }
            self._runners[key] = (FreeRunner(self._rate(data, added), self.interpolation, rtol=1e-6, atol=1e-7), added)
        return self._runners[key]

    def _rate(self, data: Trajectories, added: Mapping[str, Added]) -> Callable[[Array, Array, Array, dict], Array]:
        simulation = self.model.simulator(data, lacking=True).rounded(data.columns)
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


def over(values: Any, size: float) -> Any:
    """A share of what was measured; NaN where the data are at rest, and nothing is a share of nothing.

    Args:
        values: Errors.
        size: Of what was measured.
    """
    # A free run that blew up may be off by more than numbers can say.
    with np.errstate(over="ignore"):
        return values / size if size > 0 else np.full(np.shape(values), np.nan)


def _compared(
    data: Trajectories,
    measured_after: Mapping[str, np.ndarray],
    part: str,
    states: Float[np.ndarray, "n_draw n_obs n_state"],
    failed_at: Float[np.ndarray, "n_run n_draw"],
    n_before: int,
    holds: str,
) -> tuple[dict[str, FreePath], list[tuple]]:
    """Paths and rows of the table, from integrated states: `n_before` of the model before, then those after."""
    paths, rows = {}, []
    at_end = {} if data.samples is None else clipped_states(data.samples)
    for i, name in enumerate(data.state_names):
        measured = data.states[name]
        before, after = states[:n_before, :, i], states[n_before:, :, i]
        paths[name] = FreePath(
            data.time,
            data.run,
            measured_after[name],
            Band.surviving(before, LEVEL),
            Band.surviving(after, LEVEL),
            holds,
        )
        spread = float(np.std(measured))
        # A sensor at its end shows no error.
        alive = np.isfinite(states[:, :, i]).all(axis=0) & ~at_end.get(name, np.zeros(data.n_obs, bool))

        def error(values: np.ndarray, measured=measured, alive=alive, spread=spread) -> Any:
            return over(np.sqrt(np.mean((measured[alive] - values[..., alive]) ** 2, axis=-1)), spread)

        low, high = np.quantile(error(after, measured_after[name]), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
        means = (float(error(before.mean(axis=0))), float(error(after.mean(axis=0), measured_after[name])))
        rows.append((part, "free-run NRMSE", name, *means, low, high))
    if np.isfinite(failed_at).any():
        begun = np.array([data.time[data.run == i][0] for i in range(data.n_run)])
        lasted = failed_at - begun[:, None]
        first = np.where(np.isfinite(lasted), lasted, np.inf).min(axis=0)
        low, high = np.quantile(first[n_before:], [(1 - LEVEL) / 2, (1 + LEVEL) / 2], method="nearest")
        times = np.array([np.median(first[:n_before]), np.median(first[n_before:]), low, high])
        # Never is no number: records have null for it, and tables the word.
        rows.append((part, "time to failure", "all", *np.where(np.isfinite(times), times, np.nan)))
    return paths, rows


def _sources(amendments: Mapping[str, Amendment], starts: Starts) -> dict[str, bool]:
    """What varies between the draws of a free run."""
    every = list(amendments.values())
    return {
        "coefficients": any(np.ptp(a.after.draws, axis=0).any() for a in every),
        "inner parameters": any(np.ptp(a.after.inner, axis=0).any() for a in every),
        "f": any(a.discrepancy is not None for a in every),
        "start": not starts.exact,
    }
