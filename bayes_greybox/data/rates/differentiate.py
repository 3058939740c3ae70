"""Differentiators as linear operators: Savitzky–Golay, band-limited and spectral.

Derivatives, states and inputs are filtered alike. `data.rates.rate_filter` says how the filter changes the true rate,
and therefore every term of the equation. Rows at the edges, where a filter would invent samples, are dropped.

The functions here take plain arrays; `Trajectories.differentiate` is the user's way in.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.noise.banded import fir_noise
from bayes_greybox.data.noise.protocol import WHITE_SHARE, RowNoise
from bayes_greybox.data.noise.spectral import SpectralNoise
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

WRAP_FACTOR = 3.0
"""A record whose last and first sample differ by more than this many largest steps is not periodic."""


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


@dataclass(frozen=True, eq=False)
class Differentiated:
    """Filtered columns, added rates among the states, and the noise of the derivative rows by state.

    Attributes:
        rows: numbers of the rows that stay.
    """

    rows: Int[np.ndarray, " n_row"]
    states: dict[str, Float[np.ndarray, " n_row"]]
    inputs: dict[str, Float[np.ndarray, " n_row"]]
    derivatives: dict[str, Float[np.ndarray, " n_row"]]
    noise: dict[str, RowNoise]
    filter: RateFilter


def differentiate(
    time: Float[np.ndarray, " n_obs"],
    run: Int[np.ndarray, " n_obs"],
    run_names: Sequence[str],
    *,
    states: Mapping[str, Float[np.ndarray, " n_obs"]],
    inputs: Mapping[str, Float[np.ndarray, " n_obs"]],
    derivatives: Mapping[str, Float[np.ndarray, " n_obs"]],
    settings: FilterSettings,
) -> Differentiated:
    """Smooth every column and add the missing derivatives; see `Trajectories.differentiate`.

    Args:
        time: time stamps, evenly spaced in each run.
        run: number of the run of each row.
        run_names: name of each run, for messages.
        states: measured states.
        inputs: measured inputs.
        derivatives: measured derivatives and outputs, which are smoothed and not replaced.
        settings: the differentiator.

    Raises:
        InputError: if the data or the settings do not fit.
    """
    rates = settings.rates
    _check_request(states, inputs, derivatives, rates)
    check_settings(settings.method, settings.window, settings.polyorder, settings.band)
    blocks = [np.flatnonzero(run == i) for i in range(len(run_names))]
    steps = [uniform_step(time[rows], name) for rows, name in zip(blocks, run_names, strict=True)]
    missing = {name: values for name, values in states.items() if name not in derivatives}
    if settings.method == "spectral":
        _check_periodic(missing, blocks, run_names)
        applied = _spectral_filter(settings, blocks, steps, run_names)
    else:
        applied = _window_filter(settings, blocks, steps, run_names, missing)
    filtered = {name: applied.apply(values, 0) for name, values in states.items()}
    rows = {name: applied.apply(values, 0) for name, values in derivatives.items()}
    orders = dict.fromkeys(derivatives, 0)
    for name, values in missing.items():
        rows[name], orders[name] = applied.apply(values, 1), 1
        if name in rates:
            rate = rates[name]
            filtered[rate] = rows[name]
            rows[rate], orders[rate] = applied.apply(values, 2), 2
    in_order = np.concatenate(blocks)
    table = np.reshape([values[in_order] for values in states.values()], (len(states), len(in_order))).T
    noise = sample_noise(time[in_order], table, [len(b) for b in blocks])
    return Differentiated(
        rows=applied.rows,
        states=filtered,
        inputs={name: applied.apply(values, 0) for name, values in inputs.items()},
        derivatives=rows,
        noise={name: applied.row_noise(order) for name, order in orders.items()},
        filter=RateFilter(
            method=settings.method,
            window=applied.window,
            polyorder=applied.polyorder,
            band=settings.band,
            white_share=settings.white_share,
            rates=tuple(rates.items()),
            orders=tuple(orders.items()),
            steps=_different(steps),
            sample_noise=tuple(zip(states, map(float, noise), strict=True)),
        ),
    )


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
    settings: FilterSettings,
    blocks: Sequence[np.ndarray],
    steps: Sequence[float],
    run_names: Sequence[str],
    missing: Mapping[str, np.ndarray],
) -> _Filter:
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
            "leave the run out or choose a smaller window."
        )
    inner = [b[window // 2 : len(b) - window // 2] for b in blocks]

    def apply(values: np.ndarray, order: int) -> np.ndarray:
        parts = zip(blocks, steps, strict=True)
        return np.concatenate([np.correlate(values[b], taps[order], "valid") / h**order for b, h in parts])

    def row_noise(order: int) -> RowNoise:
        return fir_noise(taps[order], order, [len(b) for b in inner], steps, settings.white_share)

    return _Filter(np.concatenate(inner), window, polyorder, apply, row_noise)


def _different(steps: Sequence[float]) -> tuple[float, ...]:
    """Drop steps that are equal to an earlier one within the tolerance."""
    different: list[float] = []
    for step in steps:
        if not any(abs(step - other) <= STEP_TOLERANCE * other for other in different):
            different.append(step)
    return tuple(different)


def uniform_step(time: Float[np.ndarray, " n"], name: str) -> float:
    """Return the sample spacing of one run.

    Raises:
        InputError: if the spacing is not uniform.
    """
    if len(time) < 2:
        raise InputError(f'Run "{name}" has one row and cannot be differentiated; leave it out.')
    step = float(time[-1] - time[0]) / (len(time) - 1)
    deviation = np.abs(np.diff(time) - step)
    worst = int(np.argmax(deviation))
    slack = step_slack(time, step)
    if deviation[worst] > slack:
        steps = np.diff(time)
        usual = float(np.median(steps))
        # Single missing rows are put back at the usual step; jittered stamps keep their mean step.
        even = step if np.mean(np.abs(steps - usual) <= slack) < 0.5 else usual
        gap = np.max(steps) > GAP_STEPS * usual
        remedy = "it has a gap there" if gap else f"resample the runs evenly, data.resample({even:.6g})"
        raise InputError(
            f'Run "{name}" is not sampled evenly: the step after row {worst} is {steps[worst]:.6g} '
            f"where the mean step is {step:.6g}; {remedy}, or give measured derivatives, or take the samples as they "
            "are, without differentiating them (in a file without [data.differentiate]): those need no even steps."
        )
    return step


def _check_request(
    states: Mapping[str, np.ndarray],
    inputs: Mapping[str, np.ndarray],
    derivatives: Mapping[str, np.ndarray],
    rates: Mapping[str, str],
) -> None:
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
    for name, values in columns.items():
        for rows, run_name in zip(blocks, run_names, strict=True):
            jump = abs(values[rows[0]] - values[rows[-1]])
            largest = float(np.max(np.abs(np.diff(values[rows]))))
            if jump > WRAP_FACTOR * largest:
                raise InputError(
                    f'Run "{run_name}" is not a whole number of periods: state "{name}" jumps by {jump:.3g} '
                    f"from its last row to its first, but by {largest:.3g} at most between rows; cut it to "
                    "whole periods, or use method='savgol' or 'bandlimited'."
                )
