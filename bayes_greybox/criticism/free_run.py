"""Free runs: the whole model integrated from its start without correction, with bands."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import jax
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from bayes_greybox.data.samples.starts import estimate_starts
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.whole_rate import whole_rate
from bayes_greybox.physics.integration.adaptive_steps import (
    Limits,
    Samples,
    StepSettings,
    between_samples_of_runs,
    cut,
    follow_piece,
    joined,
    limits_of,
)
from bayes_greybox.physics.integration.solvers import diffrax
from bayes_greybox.running.arrays import on_device
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.traces import kept

from .bands import Band, band_holds
from .prediction import require_columns

ROOMS = ("inference.whole_rate", "model", "physics.formula", "physics.integration.adaptive_steps", "physics.simulation")
"""Modules that a trace of a free run depends on."""

FREE_RUN_DRAWS, MOST_STIFF = 50, 100_000
"""Posterior draws that are integrated; most steps of an implicit method where an explicit one exceeds its own."""


@dataclass(frozen=True)
class FreeRun:
    """The extended model integrated from the start of each run.

    Attributes:
        data: Data whose starts and inputs were used.
        level: Probability of the bands.
        states: Band of each state, rows as in the data; NaN after every draw of a run has failed.
        failed: Share of posterior draws of each run that diverged before its end.
        failed_at: Median time of failure of those draws, NaN if none failed.
        holds: Legend of the bands: "90 % band: coefficients, f, start".
    """

    data: Trajectories
    level: float
    states: Mapping[str, Band]
    failed: Float[np.ndarray, " n_run"]
    failed_at: Float[np.ndarray, " n_run"]
    holds: str = ""

    def nrmse(self) -> pd.Series:
        """Return the RMS of measured less mean free run, over the standard deviation of the measured state."""
        errors = {}
        for name, band in self.states.items():
            measured = self.data.states[name]
            errors[name] = float(np.sqrt(np.mean((measured - band.mean) ** 2)) / np.std(measured))
        return pd.Series(errors, name="nrmse")


def free_run(
    posterior: Posterior, data: Trajectories, level: float = 0.9, at_most: int = FREE_RUN_DRAWS,
    interpolation: str | Sequence[str] | None = None,
) -> FreeRun:  # fmt: skip
    """Integrate simulation + dictionary + f over each run, for several posterior draws and starts.

    Each posterior draw has its own draw of every start, x₀ ~ N(x̂₀, s₀²) by `data.starts.estimate_starts`; exact states
    start where they were measured. Of the data the times, starts and inputs are used. The interpolation of the inputs
    between samples, see `FreeRunner`, is by default that of the rows.

    Raises:
        InputError: States without an equation, learned outputs only, or a model on the exact path, whose f has no
            finite expansion.
    """
    require_columns(posterior, data)
    learned = {name: each for name, each in posterior.learned().items() if not posterior.data.is_output(name)}
    if not learned:
        raise InputError(
            f"There is nothing to integrate: what the model learns, {', '.join(posterior.model.equations)}, has no "
            "derivative in its equation; fit.predict(data) gives its values."
        )
    if not all(each.equation.design.expands for each in learned.values()):
        raise InputError("A free run needs f at every step: fit with OrthogonalGP(path='hsgp').")
    simulation = posterior.model.simulator(data, lacking=True)
    idle = [s for s in data.state_names if s not in simulation.equations and s not in learned]
    if idle:
        raise InputError(
            f"State {idle[0]!r} has no equation to integrate: add it to the simulation, for example "
            f"simulation={{{idle[0]!r}: '...'}}."
        )
    group, rng = posterior.idata["posterior"], np.random.default_rng(0)
    pick = rng.permutation(group.sizes["chain"] * group.sizes["draw"])[:at_most]
    starts = estimate_starts(data)
    parameters = {}
    for name, each in learned.items():
        draws = each.of(posterior.draws(each.block))
        parameters[name] = on_device((draws.theta[pick], draws.weight[pick]))

    rate = whole_rate(simulation, learned, data.columns)
    kinds = posterior.model.rows.interpolation if interpolation is None else interpolation
    states, failed_at = FreeRunner(rate, kinds, rate.identity)(data, parameters, starts.draws(len(pick), rng))
    bands = {name: Band.surviving(states[:, :, i], level) for i, name in enumerate(data.state_names)}
    lost = [times[np.isfinite(times)] for times in failed_at]
    failed = np.array([len(times) / len(every) for times, every in zip(lost, failed_at, strict=True)])
    sources = {
        "coefficients": any(len(each.frame.dictionary) for each in learned.values()),
        "f": any(each.frame.variables for each in learned.values()),
        "start": not starts.exact,
    }
    median = np.array([np.median(t) if len(t) else np.nan for t in lost])
    return FreeRun(data, level, bands, failed, median, band_holds(level, sources))


class FreeRunner:
    """Integrates runs of any length, for several parameters at once; compiled once.

    The right-hand side is (t, x, u, one draw of the parameters) -> dx/dt. Inputs are interpolated between samples by
    "linear", "zoh" (zero-order hold) or "cubic", one for all or one for each; by default
    `physics.integration.adaptive_steps.between_samples` chooses linear or cubic for each. `identity` is a key of the
    right-hand side for `traces.kept`; options are tolerances, as of `StepSettings`.
    """

    def __init__(
        self, right_hand_side: Callable[[Array, Array, Array, Any], Array],
        interpolation: str | Sequence[str] | None = None, identity: Any = None, **options: Any,
    ) -> None:  # fmt: skip
        self.interpolation = interpolation

        @cache
        def follower(kinds: tuple[str, ...], stiff: bool) -> Callable[..., Any]:
            def follow(start: Any, samples: Samples, limits: Limits, parameters: Any) -> Any:
                def one(start: Any, x0: Array | np.ndarray, args: Any) -> Any:
                    # No derivatives are needed, and other adjoints take a fifth longer to trace.
                    settings: dict[str, Any] = {**options, "adjoint": diffrax().ForwardMode()}
                    if stiff:
                        settings |= {"solver": diffrax().Kvaerno5(), "max_steps": MOST_STIFF}
                    limits_of_one = limits._replace(x0=x0)
                    return follow_piece(
                        right_hand_side, start, samples, limits_of_one, args, kinds, StepSettings(**settings)
                    )

                return jax.vmap(one)(start, limits.x0, parameters)

            key = None if identity is None else (identity, kinds, stiff, options)
            return kept(follow, key, "follow", rooms=ROOMS)

        self._follower = follower

    def __call__(
        self, data: Trajectories, parameters: Any, starts: Float[np.ndarray, "n_draw n_run n_state"]
    ) -> tuple[Float[np.ndarray, "n_draw n_obs n_state"], Float[np.ndarray, "n_run n_draw"]]:
        """Integrate every run of the data from its start with its measured inputs.

        Parameters are a pytree of arrays whose first axis counts draws. Returned are states at the rows of the data,
        NaN after a failure; and the time of each failure, NaN without one.
        """
        # The noise belongs to rows, and runs consist of samples.
        data = replace(data, noise={})
        size = np.sqrt(np.mean(data.matrix(data.state_names) ** 2, axis=0))
        size = np.where(size > 0, size, 1.0)
        runs = [data.take(i) for i in range(data.n_run)]
        kinds = self.interpolation
        if kinds is None:
            kinds = between_samples_of_runs([(run.time, run.matrix(data.input_names)) for run in runs])
        results = [
            self._run(run.time, run.matrix(data.input_names), kinds, starts[:, i], size, parameters)
            for i, run in enumerate(runs)
        ]
        states, failed_at = zip(*results, strict=True)
        return np.concatenate(states, axis=1), np.array(failed_at)

    def _run(
        self, t: np.ndarray, u: np.ndarray, kinds: str | Sequence[str], x0: np.ndarray, size: np.ndarray,
        parameters: Any,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        samples, kinds = cut(t, u, kinds)
        limits = limits_of(t, x0, size)

        def whole(stiff: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            start, pieces = (x0, np.ones(len(x0), bool)), []
            for i in range(len(samples.times)):
                piece = Samples(*(part[i] for part in samples))
                start, result = self._follower(kinds, stiff)(start, piece, limits, parameters)
                pieces.append(result)
            # NumPy, because JAX compiles a program for each operation.
            states, failed_at, exhausted = (np.stack(parts, axis=1) for parts in zip(*pieces, strict=True))
            return states, failed_at, np.any(exhausted, axis=1)

        states, failed_at, exhausted = whole(False)
        if np.any(exhausted):
            # An implicit method takes longer to compile, and to run unless the equations are stiff.
            others = whole(True)
            states = np.where(exhausted[:, None, None, None], others[0], states)
            failed_at = np.where(exhausted[:, None], others[1], failed_at)
        path, failed = joined(x0, t, states, failed_at)
        return np.asarray(path), np.asarray(failed)
