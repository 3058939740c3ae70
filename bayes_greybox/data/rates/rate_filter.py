"""The filter behind rates that were computed from samples, and its effect on the terms of an equation.

A finite differentiator of order m annihilates polynomials below degree m, so its output is a weighted mean of the m-th
derivative over its window (Peano's kernel theorem): Σ_k c_k x_{n+k} = h^m Σ_k s_k x⁽ᵐ⁾_{n+k}. A filtered rate is
therefore s ∗ ẋ, and the equation that holds for it is s ∗ (g + Φθ + f) with the terms evaluated at the samples first
and smoothed then: h ∗ Φ(x) is not Φ(h ∗ x).
"""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.signal import upfirdn

from bayes_greybox.data.noise.banded import BandedNoise
from bayes_greybox.data.noise.protocol import RowNoise
from bayes_greybox.running.errors import InputError

from .filters import STEP_TOLERANCE, filter_taps
from .sample_spread import Columns, Evaluate
from .smoothing import smoothing_taps

NEIGHBOUR_CORRELATION = float(np.exp(-1))  # largest correlation of the noise of neighbouring rows
STRETCH_SAMPLES = 16_384  # samples at which a table is evaluated at once


@dataclass(frozen=True)
class RateFilter:
    """Filter that computed the rates of data; two are equal if they treat any data set alike."""

    method: str  # "savgol", "bandlimited" or "spectral"
    window: int  # taps; 0 for spectral
    polyorder: int | None
    band: float | None  # edge of the pass band, cycles per unit of time (bandlimited, spectral)
    white_share: float
    rates: tuple[tuple[str, str], ...]
    # Order of the derivative by the state whose equation the row is; 0 where the rate was measured and smoothed.
    orders: tuple[tuple[str, int], ...]
    # Different sample spacings of the runs, that of the first run first.
    steps: tuple[float, ...] = field(compare=False)
    # Standard deviation of the white noise on each measured state.
    sample_noise: tuple[tuple[str, float], ...] = field(default=(), compare=False)

    @property
    def finite(self) -> bool:
        """True if it has a window; a spectral derivative is band-limited by the whitening of its rows."""
        return self.method != "spectral"

    @property
    def in_words(self) -> str:
        """Description for remarks, such as "differentiated by savgol, window 21"."""
        settings = {"window": self.window or None, "polyorder": self.polyorder, "band": self.band}
        words = [f", {name} {value:g}" for name, value in settings.items() if value is not None]
        return f"differentiated by {self.method}{''.join(words)}"

    @property
    def settings(self) -> dict[str, Any]:
        """Arguments of `Trajectories.differentiate` that give this filter on other data."""
        names = ("method", "band", "white_share", *(("window", "polyorder") if self.finite else ()))
        return {"rates": dict(self.rates), **{name: getattr(self, name) for name in names}}

    def source(self, state: str) -> str:
        """Return the measured state behind a state: itself, or the state whose rate it is."""
        return {rate: name for name, rate in self.rates}.get(state, state)

    def one_sensor(self, state: str) -> tuple[str, ...]:
        """Return the states that share the sensor of a rate, the measured one first; none if the rate was measured."""
        if not dict(self.orders).get(state, 0):
            return ()
        source = self.source(state)
        return (source, *(rate for name, rate in self.rates if name == source))

    @cached_property
    def every(self) -> int:
        """Distance of rows: the first lag at which the noise of the highest derivative is correlated by 1/e at most."""
        taps = self._taps(max(order for _, order in self.orders))
        correlation = np.correlate(taps, taps, mode="full")[len(taps) - 1 :]
        return int(np.argmax(np.append(correlation, 0.0) <= NEIGHBOUR_CORRELATION * correlation[0]))

    def smoothing(self, state: str) -> Float[np.ndarray, " window"]:
        """Return the weights s of the mean of the true rate that a state's rate stands for; they add up to one."""
        order = dict(self.orders)[state]
        return smoothing_taps(self._taps(order), order, self.method)

    def column_weights(self, name: str) -> Float[np.ndarray, " window"]:
        """Return the weights of the mean that a smoothed column stands for; an added rate is a first derivative."""
        order = int(name in dict(self.rates).values())
        return smoothing_taps(self._taps(order), order, self.method)

    def noise_of_states(self, row_steps: Float[np.ndarray, " n_row"]) -> dict[str, float]:
        """Return the standard deviation of the noise that the filter leaves in each state, RMS over rows."""
        smoothed = {name: s * float(np.linalg.norm(self._taps(0))) for name, s in self.sample_noise}
        size = float(np.linalg.norm(self._taps(1))) * self._per_step(row_steps, 1) if self.rates else 0.0
        return smoothed | {rate: dict(self.sample_noise)[name] * size for name, rate in self.rates if name in smoothed}

    def noise_of_rate(self, state: str, row_steps: Float[np.ndarray, " n_row"]) -> float:
        """Return the standard deviation of a computed rate, RMS over rows; infinite for a smoothed measured rate."""
        order, noise = dict(self.orders)[state], dict(self.sample_noise)
        source = self.source(state)
        if order == 0 or source not in noise:
            return float("inf")
        return noise[source] * float(np.linalg.norm(self._taps(order))) * self._per_step(row_steps, order)

    def require_steps(self, steps: Mapping[str, float]) -> None:
        """Refuse runs, by name, of a sample spacing at which the window would last another time."""
        for name, step in steps.items():
            if self.finite and not any(abs(step - usual) <= STEP_TOLERANCE * usual for usual in self.steps):
                raise InputError(
                    f'Run "{name}" has the step {step:.6g}, but the filter was made for '
                    f"{', '.join(f'{usual:.6g}' for usual in self.steps)}: resample it, or give the settings instead "
                    "of like=..."
                )

    def to_dict(self) -> dict[str, Any]:
        """Return plain values that `from_dict` reads back."""
        pairs = {name: dict(getattr(self, name)) for name in ("rates", "orders", "sample_noise")}
        return asdict(self) | pairs | {"steps": list(self.steps)}

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> "RateFilter":
        """Rebuild from `to_dict`."""
        # Numbers of a damaged file are refused here, where its name is known.
        fields: dict[str, Any] = {name: record[name] for name in ("method", "polyorder", "band")}
        fields |= {"window": int(record["window"]), "white_share": float(record["white_share"])}
        fields |= {name: tuple(record[name].items()) for name in ("rates", "sample_noise")}
        orders = tuple((name, int(order)) for name, order in record["orders"].items())
        return cls(**fields, orders=orders, steps=tuple(record["steps"]))

    def _per_step(self, row_steps: Float[np.ndarray, " n_row"], order: int) -> float:
        """Return the RMS of 1/h^m over rows, h the step of each row's run; the first run's if no run has two rows."""
        steps = row_steps[row_steps > 0]
        return float(np.sqrt(np.mean((steps if len(steps) else np.array(self.steps[:1])) ** (-2.0 * order))))

    def _taps(self, order: int) -> Float[np.ndarray, " window"]:
        band = None if self.band is None else self.band * self.steps[0]
        return filter_taps(order, self.method, window=self.window, polyorder=self.polyorder, band=band)


@dataclass(frozen=True, eq=False)
class RowOperator:
    """Operator V from values at the samples to values of the rows, smoothed by s and taken every so many samples.

    Samples whose window reaches beyond their run have no row; a run shorter than the window has none.
    """

    weights: Float[np.ndarray, " window"]  # s
    every: int  # distance of rows in samples
    run_lengths: tuple[int, ...]

    @property
    def row_lengths(self) -> tuple[int, ...]:
        """Number of rows of each run."""
        return tuple(-(-max(0, n - len(self.weights) + 1) // self.every) for n in self.run_lengths)

    @property
    def sample(self) -> Int[np.ndarray, " n_row"]:
        """Number of the sample at the centre of each row."""
        starts = np.cumsum([0, *self.run_lengths[:-1]]) + len(self.weights) // 2
        parts = [a + self.every * np.arange(n) for a, n in zip(starts, self.row_lengths, strict=True)]
        return np.concatenate(parts).astype(np.int64)

    @property
    def place(self) -> Int[np.ndarray, " n_row"]:
        """Number of the sample at which the terms of each row are evaluated: its centre."""
        return self.sample

    def pieces(self, most: int) -> Iterator[slice]:
        """Yield stretches of at most so many samples, each with whole windows, whose rows follow each other."""
        window, start = len(self.weights), 0
        count = max(1, (most - window) // self.every + 1)
        for n, n_row in zip(self.run_lengths, self.row_lengths, strict=True):
            for row in range(0, n_row, count):
                first, last = row * self.every, (min(row + count, n_row) - 1) * self.every
                yield slice(start + first, start + last + window)
            start += n

    def of(self, evaluate: Evaluate, columns: Columns) -> Float[np.ndarray, "n_row k"]:
        """Return rows of the table [n, k] that a function makes of columns [n], without ever forming it as a whole."""
        at = ({name: column[piece] for name, column in columns.items()} for piece in self.pieces(STRETCH_SAMPLES))
        return np.concatenate([self.smooth(evaluate(part)) for part in at])

    def smooth(self, stretch: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n_some k"]:
        """Return the rows of one stretch of samples."""
        window = len(self.weights)
        # Leading zeros shift the full convolution, so that its first whole window is among those that are kept.
        lead = -(window - 1) % self.every
        taps = np.concatenate([np.zeros(lead), self.weights[::-1]])
        first = (window - 1 + lead) // self.every
        n_row = (len(stretch) - window) // self.every + 1
        return upfirdn(taps, stretch, down=self.every, axis=0)[first : first + n_row]

    def __call__(self, table: Float[np.ndarray, "n_sample k"]) -> Float[np.ndarray, "n_row k"]:
        """Return V table."""
        return np.concatenate([self.smooth(table[part]) for part in self.pieces(max(self.run_lengths))])

    def noise(self, noise: RowNoise) -> RowNoise:
        """Return the noise of the rows from the noise of a rate at every sample."""
        if not isinstance(noise, BandedNoise):
            raise TypeError(f"rates of a finite filter have banded noise, not {type(noise).__name__}")
        half, window = len(self.weights) // 2, len(self.weights)
        return noise.restrict([(half, half + max(0, n - window + 1)) for n in self.run_lengths]).thin(self.every)
