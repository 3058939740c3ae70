"""Warnings on rows of rates: noisy regressors, a filter that cuts too deep, too few samples."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.rates.rate_filter import RowOperator
from bayes_greybox.data.samples.sample_noise import sample_noise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.simulation.protocol import Simulation

from .row_kind import RowKind

NOISE_SHARE = 0.1
"""Variance that the states' noise brings into the simulation, over that of the rate's own noise, from which to warn."""

TRUNCATION_SHARE = 0.1
"""RMS of what the filter takes from the simulation, over that of the gap, from which to warn."""

FEWEST_SAMPLES = 10.0
"""Samples per period of the fastest visible motion below which derivatives of samples are rough."""

VISIBLE = 0.99
"""Share of a rate's power that lies below the fastest visible frequency."""


def row_warnings(kind: RowKind, data: Trajectories, equation: str, simulation: Simulation) -> list[str]:
    """Return a sentence with its figures on each thing that is wrong with the rows of an equation.

    Noise in the regressors: s² mean (∂g/∂x)² of each state x with noise s against the noise variance σ² of the rate,
    since E[e | x] = s² ∇ log p(x) is a force that more rows make surer; s and σ from third differences of the samples.
    Truncation: what the filter takes from the simulation's rate when the states pass through it once more, against the
    gap. Sampling: samples per period of the frequency below which 99 % of the rate's power lies.
    """
    rows = kind.rows(data, equation, simulation)
    sentences = [*_noisy(data, equation, simulation), *_coarse(data, equation)]
    size, gap = _truncation(data, equation, simulation), float(np.sqrt(np.mean(rows.target**2)))
    if size > TRUNCATION_SHARE * gap:
        sentences.append(
            f"The filter takes {size:.2g} from the simulation's {_called(data, equation)}, where {gap:.2g} is left to "
            "explain: coefficients of fast terms are off. Halve its window, and see whether they stay."
        )
    return sentences


def _noisy(data: Trajectories, equation: str, simulation: Simulation) -> list[str]:
    filtered, sentences = data.filter, []
    if filtered is not None and not filtered.finite:
        return []
    columns = np.column_stack([data.matrix(data.state_names), data.rate(equation)])
    *of_states, sigma = sample_noise(data.time, columns, data.run_lengths)
    noise = dict(zip(data.state_names, of_states, strict=True))
    if filtered is not None:
        steps = data.row_steps
        noise, sigma = filtered.noise_of_states(steps), filtered.noise_of_rate(equation, steps)
    here = simulation.on(data, equation)
    for name, s in noise.items():
        # Steps of the noise's own size, so that kinks count by how often they are crossed.
        moved = replace(data, states={**data.states, name: data.states[name] + s})
        reached = float(np.sqrt(np.mean((simulation.on(moved, equation) - here) ** 2)))
        if s > 0 and reached**2 > NOISE_SHARE * sigma**2:
            sentences.append(
                f"Noise of {s:.2g} in {name} reaches the simulation's {_called(data, equation)} with {reached:.2g}, "
                f"beside noise of {sigma:.2g} in the measured {data.target_in_words(equation)}: coefficients are "
                "biased, and more rows do not help."
            )
    return sentences


def _truncation(data: Trajectories, equation: str, simulation: Simulation) -> float:
    """Return the RMS of s ∗ g(x) − s ∗ g(s ∗ x), x the smoothed states."""
    filtered = data.filter
    if filtered is None or not filtered.finite or max(data.run_lengths) < 2 * filtered.window:
        return 0.0

    def smooth(values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {
            name: RowOperator(filtered.column_weights(name), 1, data.run_lengths)(column[:, None])[:, 0]
            for name, column in values.items()
        }

    again = RowOperator(filtered.smoothing(equation), 1, data.run_lengths)
    part = replace(
        data,
        time=data.time[again.sample],
        run=data.run[again.sample],
        states=smooth(data.states),
        inputs=smooth(data.inputs),
        derivatives={},
        noise={},
    )
    lost = simulation.on(part, equation) - simulation.on(data, equation)[again.sample]
    last = RowOperator(again.weights, 1, again.row_lengths)
    return float(np.sqrt(np.mean(last(lost[:, None]) ** 2)))


def _coarse(data: Trajectories, equation: str) -> list[str]:
    longest = int(np.argmax(data.run_lengths))
    rate = data.rate(equation)[data.run == longest]
    if len(rate) < 4 * FEWEST_SAMPLES:
        return []
    power = np.abs(np.fft.rfft((rate - rate.mean()) * np.hanning(len(rate)))) ** 2
    # What all frequencies have alike is noise.
    power = np.maximum(power - 3 * np.median(power), 0.0)
    share: Float[np.ndarray, " n"] = np.cumsum(power) / np.sum(power)
    samples = len(rate) / max(1, int(np.searchsorted(share, VISIBLE)))
    if samples >= FEWEST_SAMPLES or math.isnan(samples):
        return []
    remedy = "sample faster" if data.is_output(equation) else "sample faster, or measure the rate"
    return [
        f"The fastest visible motion in {_called(data, equation, 'the ')} has {samples:.1f} samples a period, fewer "
        f"than {FEWEST_SAMPLES:.0f}: {remedy}."
    ]


def _called(data: Trajectories, equation: str, article: str = "") -> str:
    words = data.target_in_words(equation, article=article)
    return words if data.is_output(equation) else f"{words} of {equation}"
