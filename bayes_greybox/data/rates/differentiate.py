"""Differentiators as linear operators: Savitzky–Golay, band-limited and spectral.

Derivatives, states and inputs are filtered alike. What the filter makes of the true rate, and therefore of every term
of the equation, is in `data.rates.rate_filter`. Rows at the edges, where a filter would invent samples, are dropped.

The functions here take plain arrays; `Trajectories.differentiate` is the user's way in.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True, eq=False)
class Differentiated:
    """Filtered columns and the noise of the derivative rows.

    Attributes:
        rows: numbers of the rows that stay.
        states: smoothed states, the added rates included.
        inputs: smoothed inputs.
        derivatives: derivative rows by state.
        noise: covariance of these rows.
        filter: what the rates were computed by.
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
    method: str = "savgol",
    rates: Mapping[str, str] | None = None,
    window: int | None = None,
    polyorder: int | None = None,
    band: float | None = None,
    white_share: float = WHITE_SHARE,
) -> Differentiated:
    """Smooth every column and add the missing derivatives; see `Trajectories.differentiate`.

    Args:
        time: time stamps, evenly spaced in each run.
        run: number of the run of each row.
        run_names: name of each run, for messages.
        states: measured states.
        inputs: measured inputs.
        derivatives: measured derivatives, and outputs; smoothed, not replaced.
        method: "savgol", "bandlimited" or "spectral".
        rates: {"y": "ydot"} adds the rate of y as a state ydot and differentiates twice.
        window: odd number of samples.
        polyorder: degree of the local polynomial (savgol).
        band: edge of the pass band in cycles per unit of time (bandlimited, spectral).
        white_share: share of the row variance that is white, see `bayes_greybox.data.noise.banded`.

    Returns:
        The filtered columns.

    Raises:
        InputError: if the data or the settings do not fit.
    """
    rates = dict(rates or {})
    _check_request(states, inputs, derivatives, rates)
    check_settings(method, window, polyorder, band)
    blocks = [np.flatnonzero(run == i) for i in range(len(run_names))]
    steps = [uniform_step(time[rows], name) for rows, name in zip(blocks, run_names, strict=True)]
    wanted = [name for name in states if name not in derivatives]
    highest, given_band = (2 if rates else 1), band

    if method == "spectral":
        _check_periodic({name: states[name] for name in wanted}, blocks, run_names)
        kept = [
            kept_frequencies(len(rows), h, band, name) for rows, h, name in zip(blocks, steps, run_names, strict=True)
        ]
        rows, window = np.arange(len(time)), 0

        def apply(values: np.ndarray, order: int) -> np.ndarray:
            parts = zip(blocks, steps, kept, strict=True)
            return np.concatenate([spectral_derivative(values[b], h, order, k) for b, h, k in parts])

        def row_noise(order: int) -> RowNoise:
            return SpectralNoise(order, tuple(len(b) for b in blocks), tuple(steps), tuple(kept), white_share)

    else:
        band = band_per_sample(band, steps, run_names) if method == "bandlimited" else None
        shortest = min(len(b) for b in blocks)
        if method == "savgol":
            polyorder = polyorder if polyorder is not None else (4 if highest == 2 else 3)
            if window is None:
                series = [[states[name][b] for b in blocks] for name in wanted]
                window = savgol_window(series, polyorder)
        taps = {m: filter_taps(m, method, window=window, polyorder=polyorder, band=band) for m in range(highest + 1)}
        window = len(taps[0])
        if window > shortest:
            short = run_names[int(np.argmin([len(b) for b in blocks]))]
            raise InputError(
                f'Run "{short}" has {shortest} rows, fewer than the window of {window}; leave the run out or '
                "choose a smaller window."
            )
        half = window // 2
        inner = [b[half : len(b) - half] for b in blocks]
        rows = np.concatenate(inner)

        def apply(values: np.ndarray, order: int) -> np.ndarray:
            parts = zip(blocks, steps, strict=True)
            return np.concatenate([np.correlate(values[b], taps[order], "valid") / h**order for b, h in parts])

        def row_noise(order: int) -> RowNoise:
            return fir_noise(taps[order], order, [len(b) for b in inner], steps, white_share)

    new_states = {name: apply(values, 0) for name, values in states.items()}
    new_derivatives = {name: apply(values, 0) for name, values in derivatives.items()}
    orders = dict.fromkeys(derivatives, 0)
    for name in wanted:
        new_derivatives[name], orders[name] = apply(states[name], 1), 1
        if name in rates:
            rate = rates[name]
            new_states[rate] = new_derivatives[name]
            new_derivatives[rate], orders[rate] = apply(states[name], 2), 2
    runs = np.concatenate(blocks)
    table = np.column_stack([values[runs] for values in states.values()]) if states else np.zeros((len(runs), 0))
    noisy = sample_noise(time[runs], table, [len(b) for b in blocks])
    different: list[float] = []
    for step in steps:
        if not any(abs(step - other) <= STEP_TOLERANCE * other for other in different):
            different.append(step)
    return Differentiated(
        rows=rows,
        states=new_states,
        inputs={name: apply(values, 0) for name, values in inputs.items()},
        derivatives=new_derivatives,
        noise={name: row_noise(order) for name, order in orders.items()},
        filter=RateFilter(
            method=method,
            window=window,
            polyorder=polyorder,
            band=given_band,
            white_share=white_share,
            rates=tuple(rates.items()),
            orders=tuple(orders.items()),
            steps=tuple(different),
            sample_noise=tuple(zip(states, map(float, noisy), strict=True)),
        ),
    )


def uniform_step(time: Float[np.ndarray, " n"], name: str) -> float:
    """Sample spacing of one run.

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
        # Rows that lack alone are put back where they were; jitter keeps its mean.
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
