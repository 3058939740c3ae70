"""The gap before and after: how far the simulation, and the amended model, are from the measurements."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from bayes_greybox.criticism.bands import Band, band_holds
from bayes_greybox.criticism.free_run import FreeRunner
from bayes_greybox.data.sample_noise import NORMAL_MEDIAN, sample_noise
from bayes_greybox.data.starts import Starts, estimate_starts
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.suspects.channels import (
    DELAY,
    ChannelSuspect,
    as_shown,
    calibrated,
    driven_later,
    shifted,
)
from bayes_greybox.model.program import Program

from .amendment import Added, Amendment

LEVEL = 0.9
"""Probability of the intervals."""

RATE_DRAWS, PATH_DRAWS = 200, 40
"""Posterior draws behind the intervals of rates and of free runs."""


GREW = 0.02
"""A free run is worse, or fails sooner, only beyond this share of what it was before."""

MISFIT = "misfit of samples"
"""Metric: what is left of samples over what their noise and the coefficients leave open; 1 where all is explained."""

NO_SHARES = ("time to failure", MISFIT)
"""Metrics whose fall is no share of the gap."""

LEFT = 1.5
"""Misfit of held-out samples, over that of training samples, from which on the model after does not hold for them."""

FORCED = 2.0
"""An unknown force may leave so many times as much of one record as of another, which it moves for longer."""

NOTHING = 1e-4
"""Error of a free run, over the standard deviation of the measurement, that is none: the integrator's."""


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


def gap_rows(
    model: Program,
    amendments: Mapping[str, Amendment],
    data: Trajectories,
    part: str,
    free_runs: "FreeRuns | None" = None,
    *,
    starts: Starts | None = None,
    seed: int = 0,
) -> tuple[pd.DataFrame, dict[str, FreePath]]:
    """The gap table's rows for one data set, and its free runs.

    Metrics: derivative NMSE, mean((ẋ − x̂̇)²)/var(ẋ), or sample NMSE, the same of the samples that rows are of;
    unexplained share, (mean((ẋ − x̂̇)²) − σ²)/mean(ẋ²), not below zero; misfit of samples of one sensor,
    (median((y − ŷ)²)/0.455/(σ² + var ŷ))^½, σ not below what the samples themselves show, `FORCED` times as large
    beside an unknown force, and var ŷ that of the draws; free-run NRMSE,
    RMS(x − x̂)/SD(x) up to the first failure of either; time to failure of runs that blow up, NaN where a model never
    does. What is over a measurement at rest is NaN. The figures are those of the mean over draws, the intervals those
    of the draws.

    Args:
        model: The model before.
        amendments: By equation.
        data: Measurements to compare with.
        part: "train" or "test".
        free_runs: Integrates free runs; without it there are none.
        starts: State of each run at its first row, of which each draw has its own; estimated from the data by default.
        seed: Seed of these draws.
    """
    rows = []
    for equation, amendment in amendments.items():
        if equation not in data.derivatives:
            continue
        # Rows that are linear only near a model are near the one that they are compared with, before and after.
        first = replace(model, rows=model.rows.around(amendment.terms_before()))
        raw, corrected = first.equation_rows(data, equation), amendment.corrected(data)
        near = model if amendment.rows is None else replace(model, rows=amendment.rows)
        measured = near.equation_rows(corrected, equation)
        size = float(np.mean(measured.measured**2)) * measured.gain**2
        # Before, nothing was known of the sensors either. A filtered rate is compared with the filter's mean of what
        # was added.
        before = raw.operate(amendment.rates(raw.columns, 1)[0][:, None])[:, 0]
        after = measured.operate(amendment.rates(measured.columns, RATE_DRAWS)[1].T).T
        # In the unit of the sensor: rows near another model are over another gain.
        variance = float(np.var(measured.measured)) * measured.gain**2
        noise = (amendment.sigma * amendment.statistics.rows.gain) ** 2
        allowed = max(noise, _own_noise(data)) * (FORCED**2 if amendment.statistics.rows.noise.moved else 1.0)

        def squares(added: np.ndarray, rows=measured) -> np.ndarray:
            # [n_row] or [n_draw, n_row]; where a path started is nobody's error.
            left = rows.noise.without_starts(np.atleast_2d(rows.target - added).T).T
            return (rows.gain * left).reshape(np.shape(added)) ** 2

        def error(added: np.ndarray, rows=measured) -> Any:
            return np.mean(squares(added, rows), axis=-1)

        def nmse(values: Any, variance=variance) -> Any:
            return _over(values, variance)

        def share(values: Any, size=size, noise=noise) -> Any:
            return _over(np.maximum(values - noise, 0.0), size)

        def misfit(values: Any, uncertain: float = 0.0, allowed=allowed) -> Any:
            # Single samples that are far off say nothing of the others.
            return np.sqrt(_over(np.median(values, axis=-1) / NORMAL_MEDIAN, allowed + uncertain))

        errors = error(after)
        uncertain = measured.gain**2 * float(np.mean(np.var(after, axis=0)))
        compared = "derivative NMSE" if model.rows.rates_measured else "sample NMSE"
        for metric, f in ((compared, nmse), ("unexplained share", share)):
            low, high = np.quantile(f(errors), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
            mean = f(error(after.mean(axis=0)))
            rows.append((part, metric, equation, float(f(error(before, raw))), float(mean), low, high))
        if data.samples is not None and len(data.samples.state_names) == 1:
            low, high = np.quantile(misfit(squares(after), uncertain), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
            each = float(misfit(squares(before, raw))), float(misfit(squares(after.mean(axis=0)), uncertain))
            rows.append((part, MISFIT, equation, *each, low, high))
    paths: dict[str, FreePath] = {}
    if free_runs is not None:
        paths, more = free_runs(data, part, starts, seed)
        rows += more
    table = pd.DataFrame(rows, columns=["data", "metric", "variable", "before", "after", "lower", "upper"])
    ratio = table["after"] / table["before"].where(table["before"] > 0)
    table["closed"] = (1 - ratio).where(~table["metric"].isin(NO_SHARES))
    return table.set_index(["data", "metric", "variable"]), paths


class FreeRuns:
    """Free runs of the model before and after, compiled once for all data with the same columns.

    Args:
        model: The model before.
        amendments: By equation.
        interpolation: Of the inputs between samples, see `criticism.free_run.FreeRunner`; by default that of the rows.
    """

    def __init__(
        self,
        model: Program,
        amendments: Mapping[str, Amendment],
        interpolation: str | Sequence[str] | None = None,
    ) -> None:
        self.model, self.amendments = model, amendments
        self.interpolation = model.rows.interpolation if interpolation is None else interpolation
        self._runners: dict[tuple, tuple[FreeRunner, Mapping[str, Added]]] = {}

    def __call__(
        self, data: Trajectories, part: str, starts: Starts | None = None, seed: int = 0
    ) -> tuple[dict[str, FreePath], list[tuple]]:
        """Paths by state, and rows of the gap table; none where a state has no equation to integrate.

        Args:
            data: Measurements to compare with.
            part: "train" or "test".
            starts: State of each run at its first row; estimated from the data by default.
            seed: Seed of their draws.
        """
        amendments = self.amendments
        if not set(data.state_names) <= {*self.model.simulator(data).equations, *amendments}:
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
        return _compared(data, after, part, states, failed_at, n_before, holds)

    def _sensors(self, data: Trajectories) -> tuple[Mapping[ChannelSuspect, float], Trajectories]:
        """Errors of states' and inputs' sensors in the model after; none where two equations say different ones."""
        found: dict[ChannelSuspect, float] = {}
        by_key: dict[str, float] = {}
        clock = data
        for amendment in self.amendments.values():
            for suspect, size in amendment.sensors.items():
                if suspect.channel not in data.columns:
                    continue
                if by_key.setdefault(suspect.key, size) != size:
                    return {}, data
                found[suspect], clock = size, amendment.clock or data
        return found, clock

    def _right(self, data: Trajectories, sensors: Mapping[ChannelSuspect, float], clock: Trajectories) -> Trajectories:
        """The data without errors of their sensors; as many rows. Samples have a path of their own."""
        if not sensors:
            return data
        late = {suspect.channel: size for suspect, size in sensors.items() if suspect.kind == DELAY}
        right = calibrated(data.samples or data, "", sensors, clock)
        right = driven_later(right, {name: by for name, by in late.items() if name in data.input_names})
        right = shifted(right, {name: by for name, by in late.items() if name in right.states})
        if data.samples is None:
            return right
        return self.model.rows.complete_all(right, tuple(self.amendments), self.model.simulator(right))

    def _runner(self, data: Trajectories, n_before: int, n_draw: int) -> tuple[FreeRunner, Mapping[str, Added]]:
        key = (data.state_names, data.input_names, n_before, n_draw)
        if key not in self._runners:
            added = {name: a.added(n_before, n_draw) for name, a in self.amendments.items()}
            self._runners[key] = (FreeRunner(self._rate(data, added), self.interpolation, rtol=1e-6, atol=1e-7), added)
        return self._runners[key]

    def _rate(self, data: Trajectories, added: Mapping[str, Added]) -> Callable[[Array, Array, Array, dict], Array]:
        simulation, names = self.model.simulator(data), (*data.state_names, *data.input_names)
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


def worsened(gap: pd.DataFrame) -> tuple[tuple[str, str, str], ...]:
    """What the amended model does worse in free run than the model before: what vetoes that a gap was closed.

    A state's free-run NRMSE has grown where the error of the mean path exceeds the error before by more than `GREW` of
    it: a model that can only be said to be no worse has closed nothing. The time to failure has fallen where the median
    draw fails sooner by more than that, and so does the upper end of the interval, or the model before never failed.

    Args:
        gap: Gap table; its free runs on held-out data are looked at, on training data where there are none.

    Returns:
        Rows of the table, (data, metric, variable); a time to failure has the variable "all".
    """
    metrics = ("free-run NRMSE", "time to failure")
    records = zip(gap.index, gap.to_dict("records"), strict=True)
    # A state at rest has no error to speak of.
    rows = [
        (key, row) for key, row in records
        if key[1] in metrics and (key[1] == "time to failure" or not np.isnan(row["before"]))
    ]  # fmt: skip
    held_out = [(key, row) for key, row in rows if key[0] == "test"]
    found = []
    for key, row in held_out or rows:
        if key[1] == "free-run NRMSE":
            worse = row["after"] > row["before"] + max(GREW * row["before"], NOTHING)
        else:
            # Never is later than any time.
            before, after, upper = (
                np.inf if np.isnan(row[name]) else row[name] for name in ("before", "after", "upper")
            )
            worse = after < (1 - GREW) * before and (upper < before or not np.isfinite(before))
        if worse:
            found.append((str(key[0]), str(key[1]), str(key[2])))
    return tuple(found)


def left_over(gap: pd.DataFrame) -> dict[str, float]:
    """Where the model after explains the training samples and not the held-out ones: misfit there, by equation.

    A model that is right explains both; one that bends to the training data, or that stands for something else there,
    does not.

    Args:
        gap: Gap table; without held-out data, or with rates, there is nothing to tell.
    """
    train, test = misfits(gap, "train"), misfits(gap, "test")
    return {name: left for name, left in test.items() if left > LEFT * max(1.0, train.get(name, 1.0))}


def misfits(gap: pd.DataFrame, part: str) -> dict[str, float]:
    """Misfit of the samples after, by equation; none of rates.

    Args:
        gap: Gap table.
        part: "train" or "test".
    """
    records = zip(gap.index, gap.to_dict("records"), strict=True)
    return {str(key[2]): float(row["after"]) for key, row in records if key[:2] == (part, MISFIT)}


def _own_noise(data: Trajectories) -> float:
    """Variance of the white noise that samples of one sensor show by themselves; 0 for several, or for rates."""
    samples = data.samples
    if samples is None or len(samples.state_names) > 1:
        return 0.0
    return float(sample_noise(samples.time, samples.matrix(samples.state_names), samples.run_lengths)[0]) ** 2


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
        alive = np.isfinite(states[:, :, i]).all(axis=0)

        def error(values: np.ndarray, measured=measured, alive=alive, spread=spread) -> Any:
            return _over(np.sqrt(np.mean((measured[alive] - values[..., alive]) ** 2, axis=-1)), spread)

        low, high = np.quantile(error(after, measured_after[name]), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
        means = (float(error(before.mean(axis=0))), float(error(after.mean(axis=0), measured_after[name])))
        rows.append((part, "free-run NRMSE", name, *means, low, high))
    if np.isfinite(failed_at).any():
        begun = np.array([data.take(i).time[0] for i in range(data.n_run)])
        lasted = failed_at - begun[:, None]
        first = np.where(np.isfinite(lasted), lasted, np.inf).min(axis=0)
        low, high = np.quantile(first[n_before:], [(1 - LEVEL) / 2, (1 + LEVEL) / 2], method="nearest")
        times = np.array([np.median(first[:n_before]), np.median(first[n_before:]), low, high])
        # Never is no number: records have null for it, and tables the word.
        rows.append((part, "time to failure", "all", *np.where(np.isfinite(times), times, np.nan)))
    return paths, rows


def _over(values: Any, size: float) -> Any:
    """A share of what was measured; NaN where the data are at rest, and nothing is a share of nothing."""
    # A free run that blew up may be off by more than numbers can say.
    with np.errstate(over="ignore"):
        return values / size if size > 0 else np.full(np.shape(values), np.nan)


def _sources(amendments: Mapping[str, Amendment], starts: Starts) -> dict[str, bool]:
    """What varies between the draws of a free run."""
    every = list(amendments.values())
    return {
        "coefficients": any(np.ptp(a.after.draws, axis=0).any() for a in every),
        "inner parameters": any(np.ptp(a.after.inner, axis=0).any() for a in every),
        "f": any(a.discrepancy is not None for a in every),
        "start": not starts.exact,
    }
