"""Free runs: the whole model integrated from its start and then left alone, with bands that say what they hold."""

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

FREE_RUN_DRAWS = 50
"""Posterior draws that a free run integrates."""

ROOMS = ("inference.whole_rate", "model", "physics.formula", "physics.integration.adaptive_steps", "physics.simulation")
"""Modules that a free run is traced through."""

MOST_STIFF = 100_000
"""Steps of a piece of the method for equations that an explicit one spends its steps on."""


@dataclass(frozen=True)
class FreeRun:
    """The amended model integrated from the start of each run.

    Attributes:
        data: The data whose starts and inputs were used.
        level: Probability of the bands.
        states: Band of each state, rows as in the data; NaN after every draw of a run has failed.
        failed: Share of posterior draws of each run that blew up before its end.
        failed_at: Median time to failure of those draws, NaN where none failed.
        holds: What the bands hold, in words: "90 % band: coefficients, f, start".
    """

    data: Trajectories
    level: float
    states: Mapping[str, Band]
    failed: Float[np.ndarray, " n_run"]
    failed_at: Float[np.ndarray, " n_run"]
    holds: str = ""

    def nrmse(self) -> pd.Series:
        """RMS of measured less mean free run, over the standard deviation of the measured state."""
        errors = {}
        for name, band in self.states.items():
            measured = self.data.states[name]
            errors[name] = float(np.sqrt(np.mean((measured - band.mean) ** 2)) / np.std(measured))
        return pd.Series(errors, name="nrmse")


def free_run(
    posterior: Posterior,
    data: Trajectories,
    level: float = 0.9,
    at_most: int = FREE_RUN_DRAWS,
    seed: int = 0,
    interpolation: str | Sequence[str] | None = None,
) -> FreeRun:
    """Integrate simulation + dictionary + f over each run, for several posterior draws and starts.

    Each posterior draw has its own draw of every start, x₀ ~ N(x̂₀, s₀²) by `data.starts.estimate_starts`; exact states
    start where they were measured.

    Args:
        posterior: Fitted model; every state needs an equation, in the simulation or in the dictionary. Outputs have no
            part in it.
        data: Runs to follow: their times, starts and inputs are used.
        level: Probability of the bands.
        at_most: Posterior draws integrated.
        seed: Seed of the choice of draws and of the starts.
        interpolation: Of the inputs between samples, see `FreeRunner`; by default that of the rows.

    Raises:
        InputError: States without an equation; outputs alone that were learned; a model on the exact path, whose f has
            no finite expansion.
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
    n_draw = posterior.idata["posterior"].sizes["chain"] * posterior.idata["posterior"].sizes["draw"]
    rng = np.random.default_rng(seed)
    pick = rng.permutation(n_draw)[: min(at_most, n_draw)]
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
    return FreeRun(
        data, level, bands, failed, np.array([np.median(t) if len(t) else np.nan for t in lost]),
        band_holds(level, sources),
    )  # fmt: skip


class FreeRunner:
    """Integrates runs of any length, for several parameters at once; compiled once.

    Args:
        right_hand_side: (t, x, u, one draw of the parameters) -> dx/dt.
        interpolation: Of the inputs between samples: "linear", "zoh" (held) or "cubic", for all or one for each. By
            default each input's own, linear or cubic, by `physics.integration.adaptive_steps.between_samples`.
        identity: What the right-hand side depends on beside its arguments, for `traces.kept`; None: keep no trace.
        **options: Tolerances, as of `physics.integration.adaptive_steps.StepSettings`.
    """

    def __init__(
        self,
        right_hand_side: Callable[[Array, Array, Array, Any], Array],
        interpolation: str | Sequence[str] | None = None,
        identity: Any = None,
        **options: Any,
    ) -> None:
        self.interpolation = interpolation

        @cache
        def follower(kinds: tuple[str, ...], stiff: bool) -> Callable[..., Any]:
            def follow(start: Any, samples: Samples, limits: Limits, parameters: Any) -> Any:
                def one(start: Any, x0: Array | np.ndarray, args: Any) -> Any:
                    own = limits._replace(x0=x0)
                    # Nobody differentiates here, and what could be takes a fifth longer to trace.
                    more: dict[str, Any] = {"adjoint": diffrax().ForwardMode()}
                    if stiff:
                        more |= {"solver": diffrax().Kvaerno5(), "max_steps": MOST_STIFF}
                    settings = StepSettings(**{**options, **more})
                    return follow_piece(right_hand_side, start, samples, own, args, kinds, settings)

                return jax.vmap(one)(start, limits.x0, parameters)

            known = None if identity is None else (identity, kinds, stiff, options)
            return kept(follow, known, "follow", rooms=ROOMS)

        self._follower = follower

    def __call__(
        self,
        data: Trajectories,
        parameters: Any,
        starts: Float[np.ndarray, "n_draw n_run n_state"] | None = None,
    ) -> tuple[Float[np.ndarray, "n_draw n_obs n_state"], Float[np.ndarray, "n_run n_draw"]]:
        """Integrate every run of the data from its start with its measured inputs.

        Args:
            data: Runs to follow.
            parameters: Pytree of arrays whose first axis counts draws.
            starts: State of each run at its first row, for each draw; by default the measured one for all.

        Returns:
            States at the rows of the data, NaN from where a run failed; and the time of each failure, NaN where none.
        """
        # Noise is of rows, and runs are of samples.
        data = replace(data, noise={})
        size = np.sqrt(np.mean(data.matrix(data.state_names) ** 2, axis=0))
        size = np.where(size > 0, size, 1.0)
        runs = [data.take(i) for i in range(data.n_run)]
        if starts is None:
            n_draw = len(jax.tree.leaves(parameters)[0])
            measured = np.array([run.matrix(data.state_names)[0] for run in runs])
            starts = np.tile(measured, (n_draw, 1, 1))
        kinds = self.interpolation
        if kinds is None:
            kinds = between_samples_of_runs([(run.time, run.matrix(data.input_names)) for run in runs])
        states, failed_at = [], []
        for i, run in enumerate(runs):
            u = run.matrix(data.input_names) if data.input_names else None
            found, failed = self._run(run.time, u, kinds, starts[:, i], size, parameters)
            states.append(found)
            failed_at.append(failed)
        return np.concatenate(states, axis=1), np.array(failed_at)

    def _run(
        self,
        t: np.ndarray,
        u: np.ndarray | None,
        kinds: str | Sequence[str],
        x0: np.ndarray,
        size: np.ndarray,
        parameters: Any,
    ) -> tuple[np.ndarray, np.ndarray]:
        samples, kinds = cut(t, u, kinds)
        limits = limits_of(t, x0, size)

        def whole(stiff: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            start, pieces = (x0, np.ones(len(x0), bool)), []
            for i in range(len(samples.times)):
                piece = Samples(*(part[i] for part in samples))
                start, found = self._follower(kinds, stiff)(start, piece, limits, parameters)
                pieces.append(found)
            # As NumPy's: JAX compiles a program for each operation.
            states, failed_at, exhausted = (np.stack(parts, axis=1) for parts in zip(*pieces, strict=True))
            return states, failed_at, np.any(exhausted, axis=1)

        states, failed_at, exhausted = whole(False)
        if np.any(exhausted):
            # An implicit method takes longer to compile, and where nothing is stiff to run.
            others = whole(True)
            states = np.where(exhausted[:, None, None, None], others[0], states)
            failed_at = np.where(exhausted[:, None], others[1], failed_at)
        found, failed = joined(x0, t, states, failed_at)
        return np.asarray(found), np.asarray(failed)
