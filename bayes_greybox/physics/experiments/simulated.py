"""Simulated systems with known truth, and the excitation that drives them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.formula.expressions import evaluate, parse_expression
from bayes_greybox.running.errors import InputError

_TOLERANCE = 1e-11
# Stiff growth would otherwise take the integration for ever.
_CALLS, _CALLS_PER_SAMPLE = 100_000, 100


@dataclass(frozen=True)
class Drive:
    """Default excitation of one input: an offset plus a multisine.

    Attributes:
        band: Lowest and highest frequency, in cycles per unit of time.
        amplitude: Largest deviation from the offset.
        offset: Mean level.
        seed: Seed of the phases.
    """

    band: tuple[float, float]
    amplitude: float
    offset: float = 0.0
    seed: int = 0


@dataclass(frozen=True, eq=False)
class System:
    """Equations of motion whose coefficients are known.

    Attributes:
        name: Name of the system.
        states: Names of the states, in order.
        inputs: Names of the inputs.
        rates: Time derivative of each state, as a formula.
        truth: For each equation to learn, its terms and their true coefficients; they add up to the rate.
        units: Units by column name.
        t: Default sampling times.
        x0: Default initial state.
        drives: Default excitation by input.
    """

    name: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    rates: Mapping[str, str]
    truth: Mapping[str, Mapping[str, float]]
    units: Mapping[str, str]
    t: Float[np.ndarray, " n"] = field(repr=False)
    x0: tuple[float, ...]
    drives: Mapping[str, Drive] = field(default_factory=dict)

    @property
    def learned(self) -> tuple[str, ...]:
        """States whose equation is to be learned."""
        return tuple(self.truth)

    @property
    def names(self) -> tuple[str, ...]:
        """States, then inputs: the names that formulas may use."""
        return (*self.states, *self.inputs)

    def rate(self, columns: Mapping[str, Float[Array | np.ndarray, "*rows"]]) -> Float[Array, "*rows n_state"]:
        """Return dx/dt, states along the last axis, from columns of states and inputs by name."""
        expressions = [parse_expression(self.rates[state], self.names) for state in self.states]
        return jnp.stack([evaluate(expr, columns) for expr in expressions], axis=-1)

    def simulate(
        self,
        t: Any = None,
        x0: Any = None,
        inputs: Mapping[str, Any] | None = None,
        noise: float = 0.0,
        noise_on: str = "derivatives",
        seed: int = 0,
    ) -> Trajectories:
        """Sample the system, with the exact derivatives at the true states.

        The integration (order 8, tolerance 1e-11) is not the one that models use for their free runs. Inputs
        are twice differentiable splines through their samples.

        Args:
            t: Sampling times; `self.t` by default.
            x0: Initial state, as a sequence in the order of `states` or by name; a list of these gives
                several runs, each with its own phases of the default excitation.
            inputs: Samples at `t` by input name; a list of arrays has one for each run.
            noise: SD of the added noise, as a share of the SD of each signal.
            noise_on: "derivatives", "states" or "both". Derivatives are always those of the true states.
            seed: Seed of the noise.

        Returns:
            The runs, with units.

        Raises:
            InputError: Shapes or names do not fit, or a run leaves every bound.
        """
        if noise_on not in ("derivatives", "states", "both"):
            raise InputError(f"noise_on is {noise_on!r}; use 'derivatives', 'states' or 'both'.")
        if not 0.0 <= noise < np.inf:
            raise InputError(f"noise is {noise}; give a share such as 0.02, or 0 for none.")
        times = self.t if t is None else np.asarray(t, dtype=float)
        if times.ndim != 1 or len(times) < 4 or not np.all(np.diff(times) > 0):
            raise InputError(f"The times of {self.name} must be at least four increasing numbers.")
        starts = self._starts(self.x0 if x0 is None else x0)
        drives = [self._inputs(times, inputs, run, len(starts)) for run in range(len(starts))]
        flow = jax.jit(lambda x, u: self.rate(self._columns(x, u)))
        paths = [self._path(flow, times, start, u) for start, u in zip(starts, drives, strict=True)]
        slopes = [np.asarray(flow(x, u)) for x, u in zip(paths, drives, strict=True)]
        keys = iter(np.random.default_rng(seed).spawn(2 * len(self.states)))

        def noisy(runs: list[np.ndarray], kind: str) -> dict[str, list[np.ndarray]]:
            share = noise if noise_on in (kind, "both") else 0.0
            return {s: _noisy([x[:, i] for x in runs], share, next(keys)) for i, s in enumerate(self.states)}

        return Trajectories.from_arrays(
            [times] * len(starts),
            states=noisy(paths, "states"),
            derivatives=noisy(slopes, "derivatives"),
            inputs={name: [u[:, i] for u in drives] for i, name in enumerate(self.inputs)},
            units=dict(self.units),
            constant="keep",
        )

    def _columns(self, x: Any, u: Any) -> dict[str, Any]:
        states = {name: x[..., i] for i, name in enumerate(self.states)}
        return states | {name: u[..., i] for i, name in enumerate(self.inputs)}

    def _starts(self, x0: Any) -> list[np.ndarray]:
        several = not isinstance(x0, Mapping) and len(x0) > 0 and (isinstance(x0[0], Mapping) or np.ndim(x0[0]))
        starts = []
        for start in x0 if several else [x0]:
            if isinstance(start, Mapping):
                if set(start) != set(self.states):
                    raise InputError(
                        f"x0 of {self.name} names {', '.join(map(str, start))}; name {', '.join(self.states)}."
                    )
                start = [start[name] for name in self.states]
            vector = np.asarray(start, dtype=float)
            if vector.shape != (len(self.states),) or not np.all(np.isfinite(vector)):
                raise InputError(
                    f"x0 of {self.name} is {start!r}; give one finite number for each of {', '.join(self.states)}."
                )
            starts.append(vector)
        return starts

    def _inputs(self, t: np.ndarray, given: Mapping[str, Any] | None, run: int, n_run: int) -> np.ndarray:
        for name in given or {}:
            if name not in self.inputs:
                known = ", ".join(self.inputs) or "none"
                raise InputError(f"{self.name} has no input {name!r}; its inputs: {known}.")
        columns = np.empty((len(t), len(self.inputs)))
        for i, name in enumerate(self.inputs):
            if given is None or name not in given:
                drive = self.drives[name]
                columns[:, i] = drive.offset + multisine(t, drive.band, drive.amplitude, drive.seed + run)
                continue
            several = isinstance(given[name], list | tuple) and np.ndim(given[name][0]) == 1
            if several and len(given[name]) != n_run:
                raise InputError(f"The input {name!r} has {len(given[name])} runs for {n_run} initial states.")
            values = np.asarray(given[name][run] if several else given[name], dtype=float)
            if values.shape != t.shape or not np.all(np.isfinite(values)):
                raise InputError(f"The input {name!r} needs one finite value for each of the {len(t)} times.")
            columns[:, i] = values
        return columns

    def _path(self, flow: Any, t: np.ndarray, start: np.ndarray, u: np.ndarray) -> np.ndarray:
        input_at = CubicSpline(t, u) if u.shape[1] else lambda time: np.empty(0)
        left = _CALLS_PER_SAMPLE * len(t) + _CALLS

        def slope(time, x):
            nonlocal left
            left -= 1
            if left < 0:
                raise InputError(
                    f"{self.name} changes too fast near t = {time:g} to be followed from "
                    f"x0 = {start.tolist()}; sample it more finely, start closer to rest, or drive it less."
                )
            return np.asarray(flow(x, input_at(time)))

        with np.errstate(over="ignore", invalid="ignore"):
            result = solve_ivp(
                slope,
                (t[0], t[-1]),
                start,
                method="DOP853",
                t_eval=t,
                rtol=_TOLERANCE,
                atol=_TOLERANCE * max(1e-3, float(np.max(np.abs(start), initial=0.0))),
                # An input that is still zero at the start must not be stepped over.
                max_step=float(np.max(np.diff(t))),
            )
        if not result.success or not np.all(np.isfinite(result.y)):
            reached = result.t[-1] if len(result.t) else t[0]
            raise InputError(
                f"{self.name} blows up near t = {reached:g} from x0 = {start.tolist()}; start closer to "
                "rest, drive it less, or stop earlier."
            )
        return result.y.T


def multisine(
    t: Float[np.ndarray, " n"], band: tuple[float, float], amplitude: float, seed: int
) -> Float[np.ndarray, " n"]:
    """Return a sum of sines of equal size and random phase that fills a frequency band.

    The frequencies are whole multiples of one cycle in the record, sum_k sin(2 pi k t / T + phase_k), so that
    an evenly sampled record repeats without a jump.

    Args:
        t: Sampling times.
        band: Lowest and highest frequency, in cycles per unit of t.
        amplitude: Largest absolute value of the result.
        seed: Seed of the phases.

    Raises:
        InputError: No frequency of the record lies in the band, or the sampling is too slow for the band.
    """
    low, high = band
    step = (t[-1] - t[0]) / (len(t) - 1)
    if not 0.0 < low <= high:
        raise InputError(f"The band {band} is not a frequency range; give (lowest, highest), both above 0.")
    if high >= 0.5 / step:
        raise InputError(
            f"A band up to {high:g} needs more than {2 * high:g} samples per unit of time, and t has "
            f"{1 / step:g}; sample faster or lower the band."
        )
    period = step * len(t)
    orders = np.arange(np.ceil(low * period - 1e-9), np.floor(high * period + 1e-9) + 1)
    if len(orders) == 0:
        raise InputError(f"The record is too short for the band {band}; it needs about {1 / low:g} units of t.")
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(orders))
    signal = np.sin(2.0 * np.pi * np.outer(t - t[0], orders / period) + phases).sum(axis=1)
    return amplitude * signal / np.max(np.abs(signal))


def _noisy(runs: Sequence[np.ndarray], share: float, rng: np.random.Generator) -> list[np.ndarray]:
    if share == 0.0:
        return list(runs)
    sd = share * float(np.std(np.concatenate(runs)))
    return [values + sd * rng.standard_normal(len(values)) for values in runs]
