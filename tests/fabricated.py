"""Posteriors with given draws, so that criticism can be tested without sampling."""

from typing import Any

import numpy as np
import xarray as xr

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.greybox import Fit
from bayes_greybox.inference.kept.groups import data_table
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.frame import Frame
from bayes_greybox.model.program import Program


def oscillator(n: int, seed: int = 0, unit: float = 1.0) -> Trajectories:
    """Noisy rows of a cubic oscillator at random states; `unit` scales the position's and velocity's unit."""
    rng = np.random.default_rng(seed)
    y, v = rng.uniform(-1, 1, n), rng.uniform(-0.8, 0.8, n)
    a = -(y**3) - 0.3 * v + 0.1 * np.sin(3 * y) + 0.05 * rng.standard_normal(n)
    return Trajectories.from_arrays(
        np.arange(n) * 0.1, states={"y": unit * y, "v": unit * v}, derivatives={"v": unit * a}
    )


def fabricate(
    model: Program,
    data: Trajectories,
    *,
    chains: int = 2,
    draws: int = 3,
    seed: int = 0,
    stats: dict[str, np.ndarray] | None = None,
    **scaled: np.ndarray,
) -> Posterior:
    """A posterior with random draws, or those given for the first equation, scaled [n_chain, n_draw, ...]."""
    rng = np.random.default_rng(seed)
    equations, shape = model.assemble(data), (chains, draws)
    first = next(iter(equations))
    group = xr.merge(
        [_draws(name, each.frame, rng, shape, scaled if name == first else {}) for name, each in equations.items()]
    )
    sampler = {
        "diverging": np.zeros(shape, bool),
        "energy": rng.standard_normal(shape),
        "n_steps": np.full(shape, 7),
    } | (stats or {})
    tree = xr.DataTree.from_dict(
        {
            "posterior": group,
            "constant_data": xr.Dataset({name: ("obs_id", values) for name, values in data_table(data).items()}),
            "sample_stats": xr.Dataset({name: (("chain", "draw"), value) for name, value in sampler.items()}),
        }
    )
    return Posterior(model, data, Sampling(draws=draws, tune=1, chains=chains), tree)


def shown(model: Program, data: Trajectories, **given: Any) -> Posterior:
    """Such a posterior, of one equation, with what a page of it asks for."""
    made = fabricate(model, data, draws=20, **given)
    (name,) = made.equations
    made.idata["log_prior"] = xr.DataTree(made.idata["posterior"].dataset[[f"{name}_sigma"]])
    return made


def estimated(model: Program, data: Trajectories, draws: int = 50, **given: Any) -> Fit:
    """A fit of one equation without f, its draws around least squares on its rows, as a flat prior leaves them."""
    model, data = model.near(data)
    ((name, equation),) = model.assemble(data).items()
    Phi, y = np.asarray(equation.design.Phi), np.asarray(equation.design.y)
    theta = np.linalg.lstsq(Phi, y, rcond=None)[0]
    sigma = np.sqrt(np.sum((y - Phi @ theta) ** 2) / (equation.rows.n_white - len(theta)))
    root = np.linalg.cholesky(np.linalg.inv(Phi.T @ Phi))
    theta = theta + sigma * np.random.default_rng(1).standard_normal((2, draws, len(theta))) @ root.T
    made = fabricate(model, data, draws=draws, theta=theta, sigma=np.full((2, draws), sigma), **given)
    made.idata["log_prior"] = xr.DataTree(made.idata["posterior"].dataset[[f"{name}_sigma"]])
    return Fit(made.model, made.data, made.sampling, made.idata)


def _draws(
    name: str, frame: Frame, rng: np.random.Generator, shape: tuple[int, int], scaled: dict[str, np.ndarray]
) -> xr.Dataset:
    n_term, n_var = len(frame.dictionary), len(frame.variables)
    values = {
        "sigma": 0.1 * np.exp(0.2 * rng.standard_normal(shape)),
        "theta": rng.standard_normal((*shape, n_term)),
        "prior_sd": np.exp(0.3 * rng.standard_normal((*shape, n_term))),
    }
    units = {"sigma": frame.target_scale, "theta": frame.coefficient_scale, "prior_sd": 1.0}
    if n_var:
        values["amplitude"] = 0.5 * np.exp(0.3 * rng.standard_normal(shape))
        values["length_scale"] = np.exp(0.2 * rng.standard_normal((*shape, n_var)))
        units |= {"amplitude": frame.target_scale, "length_scale": frame.half_width, "weight": frame.target_scale}
    if "gamma" in scaled:
        # What the odds of the patterns are computed from.
        values |= {"pi": np.full(shape, 0.5), "tau": np.ones(shape)}
    values |= scaled
    dims = dict.fromkeys(("theta", "prior_sd", "gamma", "inclusion"), f"{name}_term")
    dims["length_scale"] = f"{name}_variable"
    coords = {f"{name}_term": list(frame.dictionary.names), f"{name}_variable": list(frame.variables)}
    variables = {
        f"{name}_{key}": (
            ("chain", "draw", *((dims.get(key, f"{name}_{key}_dim"),) if value.ndim > 2 else ())),
            value * units.get(key, 1.0),
        )
        for key, value in values.items()
    }
    used = {dim for dimensions, _ in variables.values() for dim in dimensions}
    return xr.Dataset(variables, coords={dim: labels for dim, labels in coords.items() if dim in used})
