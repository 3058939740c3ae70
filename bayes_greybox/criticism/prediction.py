"""Posterior predictions on any rows, and free runs of the whole model, with bands."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.draws import dense_draw
from bayes_greybox.inference.posterior import EquationDraws, Posterior
from bayes_greybox.model.assemble import Equation
from bayes_greybox.model.likelihood import DenseDesign, Hyperparameters
from bayes_greybox.model.simulation import Simulation
from bayes_greybox.physics.integrate import between_samples, integrate

PREDICTION_DRAWS = 500
"""Posterior draws behind a prediction; bands change by less than their Monte Carlo error beyond."""

DENSE_DRAWS = 100
"""The same on the exact path, where each draw costs a dense factorisation."""

FREE_RUN_DRAWS = 50
"""Posterior draws that a free run integrates."""

PREDICTIVE_ROWS, PREDICTIVE_DRAWS = 2000, 1000
"""Largest data set, and most draws, for which the posterior predictive group is kept."""

ROWS = 4096
"""Rows predicted at once."""


@dataclass(frozen=True)
class Band:
    """A predicted quantity at n rows: posterior mean, standard deviation and equal-tailed interval."""

    mean: Float[np.ndarray, " n_obs"]
    sd: Float[np.ndarray, " n_obs"]
    lower: Float[np.ndarray, " n_obs"]
    upper: Float[np.ndarray, " n_obs"]

    @classmethod
    def of(cls, draws: Float[np.ndarray, "n_draw n_obs"], level: float) -> "Band":
        """Summarise draws."""
        tail = (1 - level) / 2
        lower, upper = np.quantile(draws, [tail, 1 - tail], axis=0)
        return cls(draws.mean(axis=0), draws.std(axis=0), lower, upper)

    @classmethod
    def surviving(cls, draws: Float[np.ndarray, "n_draw n_obs"], level: float) -> "Band":
        """Summarise draws that may end in NaN: of those that have not yet, and NaN once all have."""
        found = {field: np.full(draws.shape[1], np.nan) for field in ("mean", "sd", "lower", "upper")}
        left = np.isfinite(draws)
        # Runs end one by one, so few different sets of draws are left: one call of quantile for each.
        sets, which = np.unique(np.packbits(left, axis=0), axis=1, return_inverse=True)
        for i in range(sets.shape[1]):
            rows = np.flatnonzero(which.ravel() == i)
            alive = left[:, rows[0]]
            if alive.any():
                band = cls.of(draws[np.ix_(alive, rows)], level)
                for field, values in found.items():
                    values[rows] = getattr(band, field)
        return cls(**found)

    @classmethod
    def join(cls, parts: "list[Band]") -> "Band":
        """Bands of consecutive rows as one."""
        return cls(*(np.concatenate([getattr(p, f) for p in parts]) for f in ("mean", "sd", "lower", "upper")))


@dataclass(frozen=True)
class EquationPrediction:
    """Prediction of one equation.

    Attributes:
        rate: dx/dt without noise: simulation + dictionary + f.
        measurement: dx/dt as it would be measured, noise included.
        discrepancy: f alone.
        simulation: The simulation's rate.
        inside: Rows inside the box of the training data; elsewhere f extrapolates.
    """

    rate: Band
    measurement: Band
    discrepancy: Band
    simulation: Float[np.ndarray, " n_obs"]
    inside: np.ndarray


@dataclass(frozen=True)
class Prediction(Mapping[str, EquationPrediction]):
    """Predictions by equation, and the data they are for."""

    data: Trajectories
    level: float
    equations: Mapping[str, EquationPrediction]

    def __getitem__(self, equation: str) -> EquationPrediction:
        return self.equations[equation]

    def __iter__(self) -> Iterator[str]:
        return iter(self.equations)

    def __len__(self) -> int:
        return len(self.equations)

    def nmse(self) -> pd.Series:
        """Normalised mean square error of the predicted rate, mean((ẏ − ŷ)²)/var(ẏ), by equation.

        Raises:
            InputError: If the data have no derivative to compare with.
        """
        errors = {}
        for name, predicted in self.equations.items():
            if name not in self.data.derivatives:
                raise InputError(f"The data have no derivative of {name!r} to compare the prediction with.")
            measured = self.data.derivatives[name]
            errors[name] = float(np.mean((measured - predicted.rate.mean) ** 2) / np.var(measured))
        return pd.Series(errors, name="nmse")

    def to_frame(self) -> pd.DataFrame:
        """One row per (equation, time): bands of rate, measurement and discrepancy."""
        tables = {}
        for name, predicted in self.equations.items():
            columns = {"t": self.data.time, "run": self.data.run, "simulation": predicted.simulation}
            for part in ("rate", "measurement", "discrepancy"):
                band = getattr(predicted, part)
                columns |= {f"{part}_{field}": getattr(band, field) for field in ("mean", "sd", "lower", "upper")}
            tables[name] = pd.DataFrame({**columns, "inside": predicted.inside})
        return pd.concat(tables, names=["equation", "row"])


@dataclass(frozen=True)
class FreeRun:
    """The amended model integrated from the measured start of each run.

    Attributes:
        data: The data whose starts and inputs were used.
        level: Probability of the bands.
        states: Band of each state, rows as in the data; NaN after every draw of a run has failed.
        failed: Share of posterior draws of each run that blew up before its end.
        failed_at: Median time to failure of those draws, NaN where none failed.
    """

    data: Trajectories
    level: float
    states: Mapping[str, Band]
    failed: Float[np.ndarray, " n_run"]
    failed_at: Float[np.ndarray, " n_run"]

    def nrmse(self) -> pd.Series:
        """RMS of measured less mean free run, over the standard deviation of the measured state."""
        errors = {}
        for name, band in self.states.items():
            measured = self.data.states[name]
            errors[name] = float(np.sqrt(np.mean((measured - band.mean) ** 2)) / np.std(measured))
        return pd.Series(errors, name="nrmse")


def predict(
    posterior: Posterior, data: Trajectories, level: float = 0.9, at_most: int = PREDICTION_DRAWS
) -> Prediction:
    """Posterior of the rates at the states and inputs of any data.

    Args:
        posterior: Fitted model.
        data: Rows to predict at; derivatives are not needed.
        level: Probability of the intervals.
        at_most: Posterior draws used.

    Raises:
        InputError: If the data lack a state or input of the model.
    """
    _require_columns(posterior, data)
    simulation = Simulation.of(posterior.model.simulation, data.state_names, data.input_names)
    predictions = {}
    for name, equation in posterior.equations.items():
        g = simulation.on(data, name)
        draws = posterior.draws(name, min(at_most, DENSE_DRAWS) if _is_dense(equation) else at_most)
        rng = np.random.default_rng(posterior.sampling.seed)
        parts: dict[str, list[Band]] = {"rate": [], "measurement": [], "discrepancy": []}
        for start in range(0, data.n_obs, ROWS):
            columns = {key: column[start : start + ROWS] for key, column in data.columns.items()}
            explained, f = _scaled_parts(equation, draws, columns)
            scale = equation.frame.target_scale
            rate = g[start : start + ROWS] + scale * (explained + f)
            noise = scale * np.asarray(draws.hyper.sigma)[:, None] * rng.standard_normal(rate.shape)
            parts["rate"].append(Band.of(rate, level))
            parts["measurement"].append(Band.of(rate + noise, level))
            parts["discrepancy"].append(Band.of(scale * f, level))
        joined = {key: Band.join(bands) for key, bands in parts.items()}
        predictions[name] = EquationPrediction(**joined, simulation=g, inside=equation.frame.inside(data.columns))
    return Prediction(data, level, predictions)


def discrepancy_draws(
    equation: Equation, draws: EquationDraws, columns: Mapping[str, np.ndarray]
) -> Float[np.ndarray, "n_draw n_obs"]:
    """Posterior draws of f at any rows, user's units."""
    return equation.frame.target_scale * _scaled_parts(equation, draws, columns)[1]


def free_run(
    posterior: Posterior,
    data: Trajectories,
    level: float = 0.9,
    at_most: int = FREE_RUN_DRAWS,
    seed: int = 0,
    interpolation: str | Sequence[str] | None = None,
) -> FreeRun:
    """Integrate simulation + dictionary + f over each run from its measured start, for several posterior draws.

    Args:
        posterior: Fitted model; every state needs an equation, in the simulation or in the dictionary.
        data: Runs to follow: their times, starts and inputs are used.
        level: Probability of the bands.
        at_most: Posterior draws integrated.
        seed: Seed of the choice of draws.
        interpolation: Of the inputs between samples, see `integrate_runs`.

    Raises:
        InputError: States without an equation; a model on the exact path, whose f has no finite expansion.
    """
    _require_columns(posterior, data)
    equations = posterior.equations
    if any(_is_dense(equation) for equation in equations.values()):
        raise InputError("A free run needs f at every step: fit with OrthogonalGP(path='hsgp').")
    given = posterior.model.simulation
    known = set(data.state_names) if callable(given) else set(given or {})
    idle = [s for s in data.state_names if s not in known and s not in equations]
    if idle:
        raise InputError(
            f"State {idle[0]!r} has no equation to integrate: add it to the simulation, for example "
            f"simulation={{{idle[0]!r}: '...'}}."
        )
    simulation = Simulation.of(given, data.state_names, data.input_names)
    n_draw = posterior.idata["posterior"].sizes["chain"] * posterior.idata["posterior"].sizes["draw"]
    pick = np.random.default_rng(seed).permutation(n_draw)[: min(at_most, n_draw)]
    parameters = {}
    for name in equations:
        draws = posterior.draws(name)
        parameters[name] = (jnp.asarray(draws.theta[pick]), jnp.asarray(draws.weight[pick]))

    def right_hand_side(t: Array, x: Array, u: Array, args: dict) -> Array:
        rate = simulation.rate(t, x, u)
        names = (*data.state_names, *data.input_names)
        columns = {name: value[None] for name, value in zip(names, (*x, *u), strict=True)}
        for name, (theta, weight) in args.items():
            frame = equations[name].frame
            Phi, Psi = frame.rows(columns)
            added = frame.target_scale * (Phi[0] @ theta + Psi[0] @ weight)
            rate = rate.at[data.state_names.index(name)].add(added)
        return rate

    states, failed_at = integrate_runs(right_hand_side, data, parameters, interpolation)
    bands = {name: Band.surviving(states[:, :, i], level) for i, name in enumerate(data.state_names)}
    lost = [times[np.isfinite(times)] for times in failed_at]
    failed = np.array([len(times) / len(every) for times, every in zip(lost, failed_at, strict=True)])
    return FreeRun(data, level, bands, failed, np.array([np.median(t) if len(t) else np.nan for t in lost]))


def integrate_runs(
    right_hand_side: Callable[[Array, Array, Array, Any], Array],
    data: Trajectories,
    parameters: Any,
    interpolation: str | Sequence[str] | None = None,
    **options: Any,
) -> tuple[Float[np.ndarray, "n_draw n_obs n_state"], Float[np.ndarray, "n_run n_draw"]]:
    """Integrate every run of the data from its measured start with its measured inputs, for several parameters at once.

    Args:
        right_hand_side: (t, x, u, one draw of the parameters) -> dx/dt.
        data: Runs to follow.
        parameters: Pytree of arrays whose first axis counts draws.
        interpolation: Of the inputs between samples: "linear", "zoh" (held) or "cubic", for all or one for each. By
            default each input's own, linear or cubic, by `physics.integrate.between_samples`.
        **options: Of `physics.integrate.integrate`.

    Returns:
        States at the rows of the data, NaN from where a run failed; and the time of each failure, NaN where none.
    """
    size = np.sqrt(np.mean(data.matrix(data.state_names) ** 2, axis=0))
    size = np.where(size > 0, size, 1.0)
    runs = [data.take(i) for i in range(data.n_run)]
    if interpolation is None:
        interpolation = _most_cautious([between_samples(run.time, run.matrix(data.input_names)) for run in runs])

    def follow(args: Any, t: Array, x0: Array, u: Array | None) -> Any:
        return integrate(right_hand_side, t, x0, u, args, scale=size, interpolation=interpolation, **options)

    # Compiled once for all runs of one length.
    follow_all = jax.jit(jax.vmap(follow, in_axes=(0, None, None, None)))
    states, failed_at = [], []
    for run in runs:
        u = jnp.asarray(run.matrix(data.input_names)) if data.input_names else None
        path = follow_all(parameters, jnp.asarray(run.time), jnp.asarray(run.matrix(data.state_names)[0]), u)
        states.append(np.asarray(path.states))
        failed_at.append(np.asarray(path.failed_at))
    return np.concatenate(states, axis=1), np.array(failed_at)


def predictive_group(
    posterior: Posterior, source: str = "posterior"
) -> tuple[dict[str, np.ndarray], np.ndarray] | None:
    """Predictive draws of the measured rates at the training rows, noise with its correlation included.

    Args:
        posterior: Fitted model.
        source: Group whose draws are used: "posterior", or "prior" for the prior predictive.

    Returns:
        `e_rate` by equation [n_chain, n_kept, n_obs], and the draws kept (at most PREDICTIVE_DRAWS over all chains);
        None above PREDICTIVE_ROWS rows, where the group would dwarf everything else in the file.
    """
    data = posterior.data
    if data.n_obs > PREDICTIVE_ROWS:
        return None
    sizes = posterior.idata[source].sizes
    n_chain, n_draw = sizes["chain"], sizes["draw"]
    kept = np.arange(0, n_draw, max(1, -(-n_chain * n_draw // PREDICTIVE_DRAWS)))
    pick = (np.arange(n_chain)[:, None] * n_draw + kept).ravel()
    simulation = Simulation.of(posterior.model.simulation, data.state_names, data.input_names)
    rng = np.random.default_rng(posterior.sampling.seed)
    groups = {}
    for name, equation in posterior.equations.items():
        every = posterior.draws(name, group_name=source)
        draws = jax.tree.map(lambda leaf: leaf[pick], every)
        if _is_dense(equation):
            f = posterior.idata[source][f"{name}_f"].to_numpy().reshape(-1, data.n_obs)[pick]
            Phi = equation.frame.dictionary_rows(data.columns)
            mean = draws.theta @ np.asarray(Phi).T + f / equation.frame.target_scale
        else:
            explained, f = _scaled_parts(equation, draws, data.columns)
            mean = explained + f
        noise = rng.standard_normal(mean.shape)
        if name in data.noise:
            values, vectors = np.linalg.eigh(data.noise[name].covariance())
            noise = noise @ (vectors * np.sqrt(np.maximum(values, 0))).T
        measured = mean + np.asarray(draws.hyper.sigma)[:, None] * noise
        rate = simulation.on(data, name) + equation.frame.target_scale * measured
        groups[f"{name}_rate"] = rate.reshape(n_chain, len(kept), data.n_obs)
    return groups, kept


def _scaled_parts(
    equation: Equation, draws: EquationDraws, columns: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Φθ and f at rows, for each draw, scaled units."""
    frame, design = equation.frame, equation.design
    Phi, Psi = frame.rows(columns)
    explained = draws.theta @ np.asarray(Phi).T
    if not isinstance(design, DenseDesign):
        return explained, draws.weight @ np.asarray(Psi).T
    left = (jnp.asarray(frame.position(columns)), jnp.asarray(Phi @ frame.orthonormal))
    keys = jax.random.split(jax.random.PRNGKey(0), len(draws.theta))

    def one(item: tuple[Array, Hyperparameters, Array]) -> Array:
        key, hyper, theta = item
        return dense_draw(key, design, hyper, theta, left, design.covariance_at(left, hyper))

    return explained, np.asarray(jax.lax.map(one, (keys, draws.hyper, draws.theta)))


def _most_cautious(kinds: list[tuple[str, ...]]) -> tuple[str, ...]:
    """For each input "cubic" where all runs say so: a step in one run is a step."""
    return tuple("cubic" if set(each) == {"cubic"} else "linear" for each in zip(*kinds, strict=True))


def _is_dense(equation: Equation) -> bool:
    return isinstance(equation.design, DenseDesign)


def _require_columns(posterior: Posterior, data: Trajectories) -> None:
    missing = [name for name in posterior.data.columns if name not in data.columns]
    if missing:
        raise InputError(f"The data lack {missing[0]!r}, which the model was fitted with.")
