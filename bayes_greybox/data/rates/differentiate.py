"""Differentiators as linear operators: Savitzky–Golay, band-limited and spectral.

Derivatives, states and inputs are filtered alike. `data.rates.rate_filter` says how the filter changes the true rate,
and therefore every term of the equation. Rows at the edges, where a filter would invent samples, are dropped.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.columns import rate_unit
from bayes_greybox.data.noise.banded import fir_noise
from bayes_greybox.data.noise.protocol import WHITE_SHARE, RowNoise
from bayes_greybox.data.noise.spectral import SpectralNoise
from bayes_greybox.data.runs.stacked import Runs
from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.running.errors import InputError

from .filters import (
    GAP_STEPS,
    STEP_TOLERANCE,
    band_per_sample,
    check_settings,
    filter_taps,
    kept_frequencies,
    savgol_window,
    spectral_derivative,
    step_slack,
)
from .rate_filter import RateFilter

AnyRuns = TypeVar("AnyRuns", bound=Runs)

WRAP_FACTOR = 3.0  # a record whose last and first sample differ by more than this many largest steps is not periodic


@dataclass(frozen=True)
class FilterSettings:
    """Settings of a differentiator; see `Trajectories.differentiate` for each."""

    method: str = "savgol"
    rates: Mapping[str, str] = field(default_factory=dict)
    window: int | None = None
    polyorder: int | None = None
    band: float | None = None
    white_share: float = WHITE_SHARE


class _Filter(NamedTuple):
    rows: Int[np.ndarray, " n_row"]
    window: int
    polyorder: int | None
    apply: Callable[[np.ndarray, int], np.ndarray]
    row_noise: Callable[[int], RowNoise]


def differentiate(data: AnyRuns, settings: FilterSettings) -> tuple[AnyRuns, Int[np.ndarray, " n_row"]]:
    """Return the data as `Trajectories.differentiate` filters them, and the numbers of the rows that stay."""
    rates, names = settings.rates, data.run_names
    _check_request(data, rates)
    check_settings(settings.method, settings.window, settings.polyorder, settings.band)
    blocks = data.run_rows
    steps = [uniform_step(data.time[rows], name) for rows, name in zip(blocks, names, strict=True)]
    missing = {name: values for name, values in data.states.items() if name not in data.derivatives}
    if settings.method == "spectral":
        _check_periodic(missing, blocks, names)
        filtered = _spectral_filter(settings, blocks, steps, names)
    else:
        filtered = _window_filter(settings, blocks, steps, names, missing)
    columns = data.each_column(lambda values: filtered.apply(values, 0))
    states, derivatives = columns["states"], columns["derivatives"]
    orders, units = dict.fromkeys(derivatives, 0), dict(data.units)
    for name, values in missing.items():
        derivatives[name], orders[name] = filtered.apply(values, 1), 1
        if name in rates:
            rate, unit = rates[name], rate_unit(units.get(name), units.get("t"))
            states[rate] = derivatives[name]
            derivatives[rate], orders[rate] = filtered.apply(values, 2), 2
            units |= {} if unit is None else {rate: unit}
    noise = sample_noise(data.time, data.matrix(data.state_names), data.run_lengths)
    rate_filter = RateFilter(
        settings.method, filtered.window, filtered.polyorder, settings.band, settings.white_share,
        tuple(rates.items()), tuple(orders.items()), _different(steps),
        sample_noise=tuple(zip(data.states, map(float, noise), strict=True)),
    )  # fmt: skip
    rows = filtered.rows
    result = replace(
        data,
        time=data.time[rows],
        run=data.run[rows],
        **columns,
        units=units,
        noise={name: filtered.row_noise(order) for name, order in orders.items()},
        filter=rate_filter,
        dropped=data.dropped + data.n_obs - len(rows),
        remarks=(*data.remarks, f"{rate_filter.in_words}: {data.n_obs} rows to {len(rows)}"),
    )
    return result, rows


def _spectral_filter(
    settings: FilterSettings, blocks: Sequence[np.ndarray], steps: Sequence[float], run_names: Sequence[str]
) -> _Filter:
    each = zip(blocks, steps, run_names, strict=True)
    kept = [kept_frequencies(len(rows), step, settings.band, name) for rows, step, name in each]

    def apply(values: np.ndarray, order: int) -> np.ndarray:
        parts = zip(blocks, steps, kept, strict=True)
        return np.concatenate([spectral_derivative(values[b], h, order, k) for b, h, k in parts])

    def row_noise(order: int) -> RowNoise:
        return SpectralNoise(order, tuple(len(b) for b in blocks), tuple(steps), tuple(kept), settings.white_share)

    return _Filter(np.arange(sum(map(len, blocks))), 0, settings.polyorder, apply, row_noise)


def _window_filter(
    settings: FilterSettings, blocks: Sequence[np.ndarray], steps: Sequence[float], run_names: Sequence[str],
    missing: Mapping[str, np.ndarray],
) -> _Filter:  # fmt: skip
    """Build a finite differentiator, its window chosen from the states without a derivative if it is left open."""
    highest = 2 if settings.rates else 1
    window, polyorder, band = settings.window, settings.polyorder, None
    if settings.method == "bandlimited":
        band = band_per_sample(settings.band, steps, run_names)
    else:
        polyorder = polyorder if polyorder is not None else highest + 2
        if window is None:
            window = savgol_window([[values[b] for b in blocks] for values in missing.values()], polyorder)
    options = {"window": window, "polyorder": polyorder, "band": band}
    taps = [filter_taps(order, settings.method, **options) for order in range(highest + 1)]
    window, lengths = len(taps[0]), [len(b) for b in blocks]
    if window > min(lengths):
        raise InputError(
            f'Run "{run_names[int(np.argmin(lengths))]}" has {min(lengths)} rows, fewer than the window of {window}; '
            "leave the run out (in a file leave_out), hold out more rows or none, or choose a smaller window."
        )
    inner = [b[window // 2 : len(b) - window // 2] for b in blocks]

    def apply(values: np.ndarray, order: int) -> np.ndarray:
        parts = zip(blocks, steps, strict=True)
        return np.concatenate([np.correlate(values[b], taps[order], "valid") / h**order for b, h in parts])

    def row_noise(order: int) -> RowNoise:
        return fir_noise(taps[order], order, [len(b) for b in inner], steps, settings.white_share)

    return _Filter(np.concatenate(inner), window, polyorder, apply, row_noise)


def _different(steps: Sequence[float]) -> tuple[float, ...]:
    """Drop steps that are equal to one that was kept within the tolerance."""
    different: list[float] = []
    for step in steps:
        if not any(abs(step - other) <= STEP_TOLERANCE * other for other in different):
            different.append(step)
    return tuple(different)


def uniform_step(time: Float[np.ndarray, " n"], name: str) -> float:
    """Return the sample spacing of one run, and refuse uneven ones."""
    if len(time) < 2:
        raise InputError(f'Run "{name}" has one row and cannot be differentiated; leave it out.')
    step, steps = float(time[-1] - time[0]) / (len(time) - 1), np.diff(time)
    worst, slack = int(np.argmax(np.abs(steps - step))), step_slack(time, step)
    if abs(steps[worst] - step) > slack:
        usual = float(np.median(steps))
        # Single missing rows are put back at the usual step; jittered stamps keep their mean step.
        even = step if np.mean(np.abs(steps - usual) <= slack) < 0.5 else usual
        gap = np.max(steps) > GAP_STEPS * usual
        remedy = "it has a gap there" if gap else f"resample the runs evenly, data.resample({even:.6g})"
        raise InputError(
            f'Run "{name}" is not sampled evenly: the step after row {worst} is {steps[worst]:.6g} where the mean '
            f"step is {step:.6g}; {remedy}, or give measured derivatives, or take the samples as they are, without "
            "differentiating them (in a file without [data.differentiate]): those need no even steps."
        )
    return step


def _check_request(data: Runs, rates: Mapping[str, str]) -> None:
    states, inputs, derivatives = data.states, data.inputs, data.derivatives
    for name, rate in rates.items():
        if name not in states:
            raise InputError(
                f'rates names "{name}", which is not a measured state; the states are {", ".join(states)}.'
            )
        if name in derivatives:
            raise InputError(f'The derivative of "{name}" is already given; leave "{name}" out of rates.')
        if rate in states or rate in inputs or rate in derivatives:
            raise InputError(
                f'"{rate}" is measured and cannot be added as the rate of "{name}"; leave "{name}" out of rates.'
            )
        if not rate.isidentifier() or rate in ("t", "run") or list(rates.values()).count(rate) > 1:
            raise InputError(f'"{rate}" cannot name the rate of "{name}"; choose another name.')
    if all(name in derivatives for name in states):
        raise InputError("Every state has a derivative already; there is nothing to differentiate.")


def _check_periodic(columns: Mapping[str, np.ndarray], blocks: Sequence[np.ndarray], run_names: Sequence[str]) -> None:
    for (name, values), (rows, run_name) in product(columns.items(), zip(blocks, run_names, strict=True)):
        jump = abs(values[rows[0]] - values[rows[-1]])
        largest = float(np.max(np.abs(np.diff(values[rows]))))
        if jump > WRAP_FACTOR * largest:
            raise InputError(
                f'Run "{run_name}" is not a whole number of periods: state "{name}" jumps by {jump:.3g} from its last '
                f"row to its first, but by {largest:.3g} at most between rows; cut it to whole periods, or use "
                "method='savgol' or 'bandlimited'."
            )
