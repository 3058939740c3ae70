"""Inputs of the exact posterior from that on linear rows: the likelihood of the samples, and initial draws."""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.inference.path_starts import start_draws
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.model.equation import Equation
from bayes_greybox.model.exact_program import SENSOR_SITE, ExactLikelihood
from bayes_greybox.model.rows.path.reference_path import ReferencePath
from bayes_greybox.model.sites import EquationSites
from bayes_greybox.running.errors import InputError

from .exact_paths import Along, ExactPaths

MOST_CORRELATED = 2000
"""Most rows with correlated noise; beyond, dense whitening costs more than the paths."""

_OTHERWISE = ("theta", "prior_sd", "gamma", "inclusion", "weight", "f", "sigma", "amplitude", "length_scale")
"""Quantities that a fit has in other units, or under other names, than the sites of the exact model."""

Stated = Mapping[str, tuple[float, float]]


class FirstDraws(NamedTuple):
    """Draws by site of the exact model, each [n_draw, ...], and the number of distinct ones."""

    sites: dict[str, np.ndarray]
    distinct: int


def likelihood_of(
    posterior: Posterior, equation: Equation, path: ReferencePath, starts: Stated, noise: Stated, paths: ExactPaths,
    along: Along,
) -> ExactLikelihood:  # fmt: skip
    """Return the likelihood of the samples on exact paths; see `Fit.refine` for starts and noise.

    InputError is raised for an unknown state or sensor, noise of some sensors only, and too many correlated rows.
    """
    rows, outputs = equation.rows, path.segments.outputs
    samples, simulation = posterior.data.samples or posterior.data, posterior.model.simulator(posterior.data)
    error = rows.noise.error
    if not error.independent and rows.n_row > MOST_CORRELATED:
        raise InputError(
            f"refine() whitens at most {MOST_CORRELATED} rows of correlated noise, and there are {rows.n_row}: "
            "take a part of the record."
        )
    whiten = np.sqrt(error.precision_diagonal()) if error.independent else error.whiten(np.eye(rows.n_row))
    mean = path.segments.points[:, 0, 1 : 1 + len(simulation.states)].copy()
    sd = np.tile(path.start_sd, (len(mean), 1))
    for name, (expected, spread) in starts.items():
        if not spread > 0:
            raise InputError(f"starts={{{name!r}: ({expected:g}, {spread:g})}} needs a standard deviation above 0.")
        if name not in simulation.states:
            raise InputError(f"starts={{{name!r}: ...}} names no state; there are {', '.join(simulation.states)}.")
        if path.n_segment > samples.n_run:
            raise InputError("The path has several segments a run, whose starts are of no use for a prior of starts.")
        k = simulation.states.index(name)
        mean[:, k], sd[:, k] = expected, spread
    return ExactLikelihood(
        predict=paths,
        measured=rows.measured * rows.gain,
        sensor=np.repeat(np.arange(len(outputs)), rows.n_row // len(outputs)),
        whiten=whiten,
        log_det=float(error.log_det),
        unit=equation.frame.target_scale * rows.gain,
        share=path.sensor_sd / np.sqrt(np.mean(path.sensor_sd**2)),
        start_mean=mean,
        start_sd=sd,
        restated=bool(starts or noise),
        sensor_noise=_sensor_noise(noise, samples.state_names, independent=error.independent),
        along=along,
    )


def first_draws(
    posterior: Posterior, equation: Equation, path: ReferencePath, own: EquationSites,
    active: Bool[np.ndarray, " n_term"], likelihood: ExactLikelihood,
) -> FirstDraws:  # fmt: skip
    """Return draws of the posterior on linear rows with the likeliest pattern, by site of the exact model."""
    design, draws = equation.design, posterior.draws(own.equation)
    distinct = np.flatnonzero(np.all((np.asarray(draws.prior_sd) > 0) == active, axis=1))
    # As many as there are draws in all, so that programs compiled for them have one shape.
    with_pattern = distinct[np.arange(len(draws.theta)) * len(distinct) // len(draws.theta)]
    theta, weight = draws.theta[with_pattern], draws.weight[with_pattern]
    hyper = jax.tree.map(lambda leaf: np.asarray(leaf)[with_pattern], draws.hyper)
    values = {
        quantity: value[with_pattern]
        for quantity, value in posterior.values(own.equation).items()
        if quantity not in _OTHERWISE
    }
    values["noise"] = np.sqrt(np.maximum(hyper.sigma**2 - float(design.noise_floor) ** 2, 1e-12))
    if equation.frame.variables:
        values |= {"amplitude": hyper.amplitude, "length_scale": hyper.length_scale}
    bounded = [j for j in design.coefficients.bounded if active[j]]
    free = [j for j in np.flatnonzero(active) if j not in bounded]
    values |= {"theta_free": theta[:, free], **{f"theta_{j}": theta[:, j] for j in bounded}}
    if weight.shape[1]:
        fresh = np.random.default_rng(posterior.sampling.seed + 1).standard_normal(weight.shape)
        values["z"] = np.asarray(jax.vmap(design.standardised)(jnp.asarray(weight), hyper, jnp.asarray(fresh)))
    if likelihood.sensor_noise is not None:
        values[SENSOR_SITE] = (hyper.sigma * likelihood.unit)[:, None] * likelihood.share
    start = start_draws(equation, path, theta, weight, hyper.sigma, posterior.sampling.seed)
    values["start_unit"] = (start - likelihood.start_mean) / likelihood.start_sd
    return FirstDraws({own[quantity]: np.asarray(value) for quantity, value in values.items()}, len(distinct))


def _sensor_noise(noise: Stated, sensors: tuple[str, ...], *, independent: bool) -> Float[np.ndarray, "n 2"] | None:
    if not noise:
        return None
    if set(noise) != set(sensors):
        raise InputError(
            f"noise={{...}} must name every sensor, {', '.join(sensors)}: a median and the standard deviation of the "
            "logarithm for each."
        )
    if not all(min(values) > 0 for values in noise.values()):
        raise InputError("noise={...} needs medians and standard deviations of the logarithm above 0.")
    if not independent:
        raise InputError("The noise of this fit is correlated, and has no place for a noise of each sensor's own.")
    return np.array([noise[name] for name in sensors], float)
