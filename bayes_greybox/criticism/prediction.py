"""Posterior predictions of the rates on any rows, with bands."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import jax
import numpy as np
import pandas as pd
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.posterior import MOST_NUMBERS, Posterior
from bayes_greybox.physics.units import require_units_of
from bayes_greybox.running.errors import InputError

from .bands import Band

PREDICTION_DRAWS, PREDICTED_AT_ONCE = 500, 4096
"""Most posterior draws behind a prediction, beyond which bands change by less than their Monte Carlo error; rows
that are predicted at once."""

PREDICTIVE_ROWS, PREDICTIVE_DRAWS = 2000, 1000
"""Most rows for which the posterior predictive group is stored, and most draws of it after thinning."""


@dataclass(frozen=True)
class EquationPrediction:
    """Prediction of one equation.

    Attributes:
        rate: dx/dt, or an output itself, without noise: simulation + dictionary + f.
        measurement: The rate or output with noise, as it would be measured.
        discrepancy: f alone.
        simulation: Rate of the simulation.
        inside: True for rows inside the box of the training data; elsewhere f extrapolates.
    """

    rate: Band
    measurement: Band
    discrepancy: Band
    simulation: Float[np.ndarray, " n_obs"]
    inside: np.ndarray


@dataclass(frozen=True)
class Prediction(Mapping[str, EquationPrediction]):
    """Predictions of some data, by equation."""

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
        """Return the normalised mean square error of the rates or outputs, mean((ẏ − ŷ)²)/var(ẏ), by equation.

        InputError is raised if the data have no derivative, or no output, to compare with.
        """
        if missing := [name for name in self if name not in self.data.derivatives]:
            what = f"derivative of {missing[0]!r}" if missing[0] in self.data.states else repr(missing[0])
            raise InputError(f"The data have no {what} to compare the prediction with.")
        errors = {name: nmse(self.data.derivatives[name], each.rate.mean) for name, each in self.equations.items()}
        return pd.Series(errors, name="nmse")

    def to_frame(self) -> pd.DataFrame:
        """Return one row per (equation, time) with bands of rate, measurement and discrepancy."""
        tables = {}
        for name, predicted in self.equations.items():
            columns = {"t": self.data.time, "run": self.data.run, "simulation": predicted.simulation}
            for part in ("rate", "measurement", "discrepancy"):
                columns |= {f"{part}_{field}": values for field, values in vars(getattr(predicted, part)).items()}
            tables[name] = pd.DataFrame({**columns, "inside": predicted.inside})
        return pd.concat(tables, names=["equation", "row"])


def nmse(
    measured: Float[np.ndarray, " n_obs"], predicted: Float[np.ndarray, "*batch n_obs"]
) -> Float[np.ndarray, "*batch"] | float:
    """Return the normalised mean square error, mean((ẏ − ŷ)²)/var(ẏ)."""
    return np.mean((measured - predicted) ** 2, axis=-1) / np.var(measured)


def predict(posterior: Posterior, data: Trajectories, level: float = 0.9) -> Prediction:
    """Return the posterior of the rates at the states and inputs of any data; raise InputError if one is missing."""
    require_columns(posterior, data)
    simulation = posterior.model.simulator(data, lacking=True)
    predictions = {}
    for name, learned in posterior.learned().items():
        g, frame, design = simulation.on(data, name), learned.frame, learned.equation.design
        draws = learned.of(posterior.draws(learned.block, design.worthwhile(PREDICTION_DRAWS)))
        rng, scale, parts = np.random.default_rng(posterior.sampling.seed), frame.target_scale, []
        for start in range(0, data.n_obs, PREDICTED_AT_ONCE):
            columns = {key: column[start : start + PREDICTED_AT_ONCE] for key, column in data.columns.items()}
            explained = draws.theta @ np.asarray(frame.dictionary_rows(columns)).T
            f = design.at(frame, columns, draws)
            rate = g[start : start + PREDICTED_AT_ONCE] + scale * (explained + f)
            noise = scale * np.asarray(draws.hyper.sigma)[:, None] * rng.standard_normal(rate.shape)
            parts.append([Band.of(each, level) for each in (rate, rate + noise, scale * f)])
        bands = (Band.join(list(each)) for each in zip(*parts, strict=True))
        predictions[name] = EquationPrediction(*bands, simulation=g, inside=frame.inside(data.columns))
    return Prediction(data, level, predictions)


def predictive_group(
    posterior: Posterior, source: str = "posterior"
) -> tuple[dict[str, np.ndarray], np.ndarray] | None:
    """Draw the measured rates, or samples, at the training rows from the posterior or prior predictive distribution.

    They are `e_rate` by equation [n_chain, n_kept, n_obs], with the numbers of the draws. These are all up to the size
    of the `log_likelihood` group, as ArviZ's `loo_pit` needs both at every draw, and beyond at most PREDICTIVE_DRAWS
    over all chains. There are none above PREDICTIVE_ROWS rows, as the group would dwarf everything else in the file.
    """
    data, equations = posterior.data, posterior.equations
    if data.n_obs > PREDICTIVE_ROWS:
        return None
    sizes = posterior.idata[source].sizes
    n_chain, n_draw = sizes["chain"], sizes["draw"]
    kept = np.arange(n_draw)
    if n_chain * n_draw * sum(equation.rows.n_row for equation in equations.values()) > MOST_NUMBERS:
        kept = kept[:: max(1, -(-n_chain * n_draw // PREDICTIVE_DRAWS))]
    rng = np.random.default_rng(posterior.sampling.seed)
    groups = {}
    for name, equation in equations.items():
        # NumPy, because JAX compiles a program for each shape that it indexes.
        every = jax.tree.map(np.asarray, posterior.draws(name, group_name=source))
        Phi, Psi, _ = equation.parts()
        rates = np.empty((n_chain, len(kept), equation.rows.n_row))
        # One chain at a time, as each step needs as much memory as its result.
        for chain, rate in enumerate(rates):
            draws = jax.tree.map(lambda leaf: leaf[chain * n_draw + kept], every)  # noqa: B023
            mean = draws.theta @ Phi.T + equation.design.at_data(Psi, slice(None), draws)
            noise = equation.rows.noise.correlated(rng.standard_normal(mean.shape))
            measured = mean + np.asarray(draws.hyper.sigma)[:, None] * noise
            rate[:] = equation.rows.gain * (equation.rows.simulated + equation.frame.target_scale * measured)
        groups[posterior.sites[name].rate] = rates
    return groups, kept


def completed(posterior: Posterior, data: Trajectories) -> Trajectories:
    """Return measured data with the columns that the model adds; raise InputError for other units or columns."""
    # First, since a path in other units would end anywhere.
    require_units_of(data, posterior.data)
    return posterior.model.complete(data)


def require_columns(posterior: Posterior, data: Trajectories) -> None:
    """Require every state and input of the model, or raise InputError."""
    missing = [name for name in posterior.data.columns if name not in data.columns]
    if missing:
        raise InputError(f"The data lack {missing[0]!r}, which the model was fitted with.")
