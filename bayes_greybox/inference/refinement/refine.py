"""NUTS on the exact trajectory posterior, started and preconditioned by the posterior on linear rows.

Coordinates are those of the collapsed fit: with m and C = L Lᵀ the mean and covariance of its draws on the real line,
u = m + L η, and NUTS samples η, whose posterior is near N(0, I) where rows are nearly linear.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float
from numpyro.distributions import biject_to
from numpyro.handlers import block, seed, trace
from numpyro.infer import NUTS
from numpyro.infer.util import constrain_fn, potential_energy
from threadpoolctl import threadpool_limits

from bayes_greybox.data.errors import InputError
from bayes_greybox.inference.groups import data_table, tree_of, user_units
from bayes_greybox.inference.nuts import Sampler
from bayes_greybox.inference.posterior import Posterior, Sampling, add_group
from bayes_greybox.inference.whole_rate import whole_rate
from bayes_greybox.model.equation import Equation
from bayes_greybox.model.exact_program import PREDICTED, SENSOR, START, ExactLikelihood, exact_model
from bayes_greybox.model.rows.path.reference_path import ReferencePath
from bayes_greybox.model.sites import VECTOR, EquationSites, density_model

from .exact_paths import ExactPaths

MOST_CORRELATED = 2000
"""Rows whose noise is correlated, beyond which its dense whitening costs more than the paths."""

MOST_NUMBERS = 10_000_000
"""Predictions and densities of all rows at all draws are kept up to so many numbers."""

RIDGE = 1e-6
"""Share of its variance by which a coordinate is known apart from the others, at least."""

FEWEST = 3
"""Draws per coordinate below which their covariance is that of its diagonal alone."""

_OTHERWISE = ("theta", "prior_sd", "gamma", "inclusion", "weight", "f", "sigma", "amplitude", "length_scale")
"""What the results of a fit have in other units, or under other names, than the exact model's sites."""

Stated = Mapping[str, tuple[float, float]]


def refine(
    posterior: Posterior, sampling: Sampling, starts: Stated | None, noise: Stated | None, progress: bool
) -> Posterior:
    """Sample the exact posterior.

    Args:
        posterior: On linear rows.
        sampling: Settings.
        starts: Mean and standard deviation of states at the start of each run, by state.
        noise: Median and logarithmic standard deviation of the noise of each sensor, by state.
        progress: Whether to show a progress bar.

    Raises:
        InputError: Rows of rates; an unknown force; noise of one sensor alone; f without weights; no path at the
            estimate.
    """
    path = _path(posterior)
    name, equation = _only(posterior)
    own, active = posterior.sites[name], posterior.likeliest_pattern(name)
    likelihood = _likelihood(posterior, equation, path, starts or {}, noise or {})
    model = exact_model(posterior.model, name, equation.design, active, likelihood)
    first = _first(posterior, equation, path, own, active, likelihood)
    with threadpool_limits(1):
        mean, root, unravel = _coordinates(model, first)

        def log_density(eta: Array, argument: tuple[Array, Array]) -> Array:
            center, L = argument
            # The sampler's own handlers would take the sites of the model for theirs.
            with block():
                return -jnp.asarray(potential_energy(model, (), {}, unravel(center + L @ eta)))

        if not np.isfinite(log_density(jnp.zeros(len(mean)), (mean, root))):
            raise InputError(
                "The exact path at the fit's own estimate leaves all bounds, or takes more steps than are allowed, as "
                "of stiff equations: nothing can be sampled around it."
            )
        program = density_model(log_density, len(mean))
        kernel = NUTS(program, target_accept_prob=sampling.target_accept, forward_mode_differentiation=True)
        chains = Sampler(lambda _: kernel, sampling.tune).run(
            (mean, root), draws=sampling.draws, chains=sampling.chains, key=jax.random.PRNGKey(sampling.seed),
            progress=progress,
        )  # fmt: skip

        def told(eta: Array) -> dict[str, Array]:
            return constrain_fn(model, (), {}, unravel(mean + root @ eta), return_deterministic=True)

        flat = jnp.asarray(chains.samples[VECTOR].reshape(-1, len(mean)))
        values = jax.jit(lambda points: jax.lax.map(told, points))(flat)
    shape = chains.samples[VECTOR].shape[:2]
    drawn = {str(name): np.asarray(value).reshape(*shape, *value.shape[1:]) for name, value in values.items()}
    return _result(posterior, sampling, equation, likelihood, own, active, drawn, chains.stats)


def _only(posterior: Posterior) -> tuple[str, Equation]:
    ((name, equation),) = posterior.equations.items()
    if equation.rows.noise.moved:
        raise InputError(
            "An unknown force moves the path of this fit, and refine() knows no paths that a random force moves: leave "
            "out GreyBox(noise=bg.Noise(force=...))."
        )
    return name, equation


def _path(posterior: Posterior) -> ReferencePath:
    model, data = posterior.model, posterior.data
    return model.rows.path(data, model.equations, model.simulator(data))


def _likelihood(
    posterior: Posterior, equation: Equation, path: ReferencePath, starts: Stated, noise: Stated
) -> ExactLikelihood:
    data, rows, outputs = posterior.data, equation.rows, path.segments.outputs
    samples = data.samples or data
    simulation, learned = posterior.model.simulator(data), posterior.learned()
    rate = whole_rate(simulation, learned, data.columns)
    paths = ExactPaths.along(path, samples, rate, posterior.model.rows.interpolation)
    columns = {name: each.columns for name, each in learned.items()}

    def predict(theta: Array, weight: Array, start: Array) -> Array:
        return paths({name: (theta[own], weight) for name, own in columns.items()}, start)

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
        predict=predict,
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
    )


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


def _first(
    posterior: Posterior, equation: Equation, path: ReferencePath, own: EquationSites,
    active: Bool[np.ndarray, " n_term"], likelihood: ExactLikelihood,
) -> dict[str, np.ndarray]:  # fmt: skip
    """Draws of the linear rows' posterior with the likeliest pattern, by what the sites of the exact model are."""
    rows, design, draws = equation.rows, equation.design, posterior.draws(own.equation)
    with_pattern = np.flatnonzero(np.all((np.asarray(draws.prior_sd) > 0) == active, axis=1))
    theta, weight = draws.theta[with_pattern], draws.weight[with_pattern]
    hyper = jax.tree.map(lambda leaf: np.asarray(leaf)[with_pattern], draws.hyper)
    found = {
        quantity: value[with_pattern]
        for quantity, value in posterior.values(own.equation).items()
        if quantity not in _OTHERWISE
    }
    found["noise"] = np.sqrt(np.maximum(hyper.sigma**2 - float(design.noise_floor) ** 2, 1e-12))
    if equation.frame.variables:
        found |= {"amplitude": hyper.amplitude, "length_scale": hyper.length_scale}
    bounded = [j for j in design.coefficients.bounded if active[j]]
    free = [j for j in np.flatnonzero(active) if j not in bounded]
    found |= {"theta_free": theta[:, free], **{f"theta_{j}": theta[:, j] for j in bounded}}
    if weight.shape[1]:
        fresh = np.random.default_rng(posterior.sampling.seed + 1).standard_normal(weight.shape)
        found["z"] = np.asarray(jax.vmap(design.standardised)(jnp.asarray(weight), hyper, jnp.asarray(fresh)))
    sigma = hyper.sigma * equation.frame.target_scale
    typical = np.sqrt(np.mean(path.sensor_sd**2))
    if likelihood.sensor_noise is not None:
        found[SENSOR] = (hyper.sigma * likelihood.unit)[:, None] * likelihood.share
    Phi, Psi, y = equation.parts()
    left = (y[:, None] - Phi @ theta.T - Psi @ weight.T) * equation.frame.target_scale / sigma
    white = np.random.default_rng(posterior.sampling.seed).standard_normal((rows.noise.n_start, len(theta)))
    unit = (rows.noise.starts_given(left, white)[0] * sigma * rows.gain / typical).T
    start = (
        path.segments.points[:, 0, 1 : 1 + likelihood.start_sd.shape[1]]
        + unit.reshape(-1, *likelihood.start_sd.shape) * path.start_sd
    )
    found["start_unit"] = (start - likelihood.start_mean) / likelihood.start_sd
    return {own[quantity]: value for quantity, value in found.items()}


def _coordinates(
    model: Callable[[], None], first: Mapping[str, np.ndarray]
) -> tuple[Array, Array, Callable[[Array], dict[str, Array]]]:
    """m, L and the way from a vector to the sites on the real line."""
    traced: dict[str, Any] = {}
    # Shapes and supports are wanted, and no path.
    jax.eval_shape(lambda: traced.update(trace(seed(model, 0)).get_trace()))
    sites = {name: site for name, site in traced.items() if site["type"] == "sample" and not site["is_observed"]}
    n_draw, real = len(next(iter(first.values()))), {}
    for name, site in sites.items():
        real[name] = jnp.zeros((n_draw, *np.shape(site["value"])))
        if name in first:
            real[name] = biject_to(site["fn"].support).inv(jnp.asarray(first[name]))
    unravel = ravel_pytree(jax.tree.map(lambda leaf: leaf[0], real))[1]
    points = np.asarray(jax.vmap(lambda each: ravel_pytree(each)[0])(real))
    points = points[np.all(np.isfinite(points), axis=1)]
    mean, sd = points.mean(axis=0), points.std(axis=0)
    sd = np.where(sd > 0, sd, 1.0)
    root = np.diag(sd)
    if len(points) > FEWEST * len(mean):
        correlation = np.cov(((points - mean) / sd).T, ddof=0).reshape(len(mean), -1)
        # What no draw tells has no spread among them.
        np.fill_diagonal(correlation, 1.0)
        root = sd[:, None] * np.linalg.cholesky(correlation + RIDGE * np.eye(len(mean)))
    return jnp.asarray(mean), jnp.asarray(root), unravel


def _result(
    posterior: Posterior, sampling: Sampling, equation: Equation, likelihood: ExactLikelihood, own: EquationSites,
    active: Bool[np.ndarray, " n_term"], drawn: dict[str, np.ndarray], stats: dict[str, np.ndarray],
) -> Posterior:  # fmt: skip
    """The draws in the tree of a fit."""
    before, data = posterior.idata, posterior.data
    n_chain, n_draw = stats["lp"].shape
    predicted = drawn[own[PREDICTED]]
    if own.gamma in before["posterior"]:
        # The pattern is given; how probable each term is, linear rows tell.
        included = before["posterior"][own.inclusion].to_numpy().mean(axis=(0, 1))
        drawn[own.gamma] = np.broadcast_to(active, (n_chain, n_draw, len(active)))
        drawn[own.inclusion] = np.broadcast_to(included, (n_chain, n_draw, len(active)))
    floor = float(equation.design.noise_floor)
    drawn.setdefault(own.noise, np.sqrt(np.maximum(drawn[own.sigma] ** 2 - floor**2, 0.0)))
    placed = (n_chain, n_draw, len(equation.design.coefficients.bounded))
    drawn.setdefault(own.placement, np.full(placed, 0.5))
    designs = {own.equation: equation.design}
    densities = posterior.programs.log_prior(designs, drawn) | likelihood.log_prior(drawn, own)
    kept = {*map(str, before["posterior"]), own.theta_sd, own[START], own[SENSOR]}
    groups = {
        "posterior": user_units({name: value for name, value in drawn.items() if name in kept}, posterior.equations),
        "sample_stats": stats,
        "log_prior": densities,
        "observed_data": {own.rate: equation.rows.measured},
        "constant_data": data_table(data),
    }
    tree = tree_of(groups, posterior.equations)
    for group in ("prior", "prior_predictive"):
        # Of other priors of noise and starts nothing was drawn.
        if group in before.children and not likelihood.restated:
            tree[group] = before[group].copy()
    found = replace(posterior, sampling=sampling, idata=tree, made=None)
    if predicted.size <= MOST_NUMBERS:
        sigma = likelihood.sigma(drawn.get(own[SENSOR]), drawn[own.sigma])
        rng, rows = np.random.default_rng(sampling.seed), equation.rows
        white = rng.standard_normal((n_chain * n_draw, rows.n_row))
        noise = rows.noise.error.correlated(white).reshape(predicted.shape)
        add_group(found, "posterior_predictive", {own.rate: (predicted + sigma * noise) / rows.gain})
        if likelihood.independent:
            density = np.asarray(likelihood.log_density(jnp.asarray(predicted), jnp.asarray(sigma)))
            add_group(found, "log_likelihood", {own.rate: density + math.log(rows.gain)})
    return found
