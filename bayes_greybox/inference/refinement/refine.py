"""NUTS on the exact trajectory posterior, started and preconditioned by the posterior on linear rows.

Coordinates are those of the collapsed fit: with m and C = L Lᵀ the mean and covariance of its draws on the real line,
u = m + L η, and NUTS samples η, whose posterior is near N(0, I) where rows are nearly linear.
"""

import math
from dataclasses import asdict, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool
from threadpoolctl import threadpool_limits

from bayes_greybox.inference.checkpoint import Checkpoint, run_facts
from bayes_greybox.inference.kept.further_groups import add_group
from bayes_greybox.inference.kept.groups import DETAILS, data_table, tree_of, user_units
from bayes_greybox.inference.path_starts import path_of
from bayes_greybox.inference.posterior import MOST_NUMBERS, Posterior
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.inference.whole_rate import WholeRate
from bayes_greybox.model.equation import Equation
from bayes_greybox.model.exact_program import PREDICTED_SITE, SENSOR_SITE, START_SITE, ExactLikelihood, GivenTerms
from bayes_greybox.model.sites import EquationSites
from bayes_greybox.physics.simulation.code import require_traceable
from bayes_greybox.running.errors import InputError

from .accurate import ACCURATE, ESTIMATE, MOVED, PATH_ERROR, Paths, Sampled
from .exact_paths import Course, ExactPaths
from .linear_start import Stated, first_draws, likelihood_of
from .methods import Method
from .programs import Asked, Known, exact_programs


def refine(
    posterior: Posterior, sampling: Sampling, starts: Stated | None, noise: Stated | None, progress: bool,
    checkpoint: Checkpoint | None = None,
) -> Posterior:  # fmt: skip
    """Sample the exact posterior.

    Paths are followed on steps that are fine enough at the draws of the linear rows. At each exact draw its path is
    followed once more on finer ones: where that moves samples by more than `ACCURATE` of their sizes, or by more than
    `MOVED` of their noise, all is sampled again.

    Args:
        posterior: On linear rows.
        sampling: Settings.
        starts: Mean and standard deviation of states at the start of each run, by state.
        noise: Median and logarithmic standard deviation of the noise of each sensor, by state.
        progress: Whether to show a progress bar.
        checkpoint: Keeps the chains.

    Raises:
        InputError: Rows of rates; a fit of a stream; an unknown force; noise of one sensor alone; f without weights; no
            path at the estimate; paths that no steps follow accurately; a checkpoint of something else.
    """
    if posterior.whole is not None and posterior.model.rows.follows_path:
        raise InputError(
            "Fit.refine follows the exact path of every run at each step of its sampler, and this fit has read "
            f"{posterior.n_obs:,} samples in chunks: refine a fit of as many runs as memory holds, such as "
            "model.fit(fit.data.samples)."
        )
    if checkpoint is not None:
        of = {"starts": starts, "noise": noise, "fit": asdict(posterior.sampling)}
        checkpoint.require("refined", run_facts(posterior.model, posterior.data, sampling, **of))
    # One thread from the first: how sums are split must not decide where chains start.
    with threadpool_limits(1):
        return _refined(posterior, sampling, starts, noise, progress, checkpoint)


def _refined(
    posterior: Posterior, sampling: Sampling, starts: Stated | None, noise: Stated | None, progress: bool,
    checkpoint: Checkpoint | None,
) -> Posterior:  # fmt: skip
    path = path_of(posterior)
    name, equation = _only(posterior)
    own, active = posterior.sites[name], posterior.likeliest_pattern(name)
    rate, columns = _rate(posterior, active)
    course = Course.of(path, posterior.data.samples or posterior.data, posterior.model.rows.interpolation)
    terms = GivenTerms.of(active, equation.design.coefficients)
    asked = Asked(posterior.model.bare, name, terms, sampling.tune, sampling.target_accept)

    def likelihood_by(method: Method) -> ExactLikelihood:
        paths, along = ExactPaths(rate, method, columns), course.along(method, rate)
        return likelihood_of(posterior, equation, path, starts or {}, noise or {}, paths, along)

    likelihood = likelihood_by(course.methods[0])
    first = first_draws(posterior, equation, path, own, active, likelihood)
    tried = []
    for method in course.methods:
        known = jax.tree.map(jnp.asarray, Known(equation.design, likelihood_by(method)))
        programs = exact_programs(asked, known)
        found = Paths(method, course, programs, own).sampled(known, first, sampling, progress, checkpoint)
        if found.drawn:
            return _result(posterior, sampling, equation, likelihood, own, active, found.drawn, found.stats)
        tried.append(found)
    raise InputError(_refused(min(tried, key=lambda each: each.error)))


def _refused(found: Sampled) -> str:
    """Why no draws are accurate, by the method that came nearest."""
    if math.isfinite(found.error):
        return (
            f"No steps that are allowed follow the exact paths {found.where} accurately: finer ones move samples by "
            f"{found.error:.2g} times what they may, which is {ACCURATE:g} of the sizes of state and sample and "
            f"{MOVED:g} standard deviations of the noise of all samples together. So it is of stiff equations: give "
            "friction or contacts a width of their own, or take a part of the record."
        )
    lost = f"Exact paths {found.where} leave all bounds, or take more steps than are allowed, as of stiff equations"
    if found.where == ESTIMATE:
        return f"{lost}: nothing can be sampled around it."
    return f"{lost}: state what is known of coefficients (coefficients=...) or of starts, or take a part of the record."


def _only(posterior: Posterior) -> tuple[str, Equation]:
    ((name, equation),) = posterior.equations.items()
    if equation.rows.noise.moved:
        raise InputError(
            "An unknown force moves the path of this fit, and refine() knows no paths that a random force moves: leave "
            "out GreyBox(noise=bg.Noise(force=...))."
        )
    return name, equation


def _rate(
    posterior: Posterior, active: Bool[np.ndarray, " n_term"]
) -> tuple[WholeRate, tuple[tuple[str, tuple[int, ...]], ...]]:
    """The rate of all states with the terms that are in, and which of all coefficients each learned state's has."""
    frames, columns = {}, {}
    for state, each in posterior.learned().items():
        index = np.arange(len(active))[each.columns]
        # Features have all terms projected out of them.
        own = index[active[index]] if each.frame.basis is None and any(active[index]) else index
        frames[state], columns[state] = each.frame.of_terms(own - index[0]), tuple(own.tolist())
    simulation = posterior.model.simulator(posterior.data)
    if not simulation.differentiable:
        raise InputError(
            "refine() differentiates integrated paths at every step of NUTS, and a simulation that is an FMU cannot be "
            "differentiated so: the posterior on linear rows, which is this fit, is what there is."
        )
    require_traceable(simulation)
    rate = WholeRate(posterior.model.simulator(posterior.data), frames, posterior.data.columns)
    return rate, tuple(columns.items())


def _result(
    posterior: Posterior, sampling: Sampling, equation: Equation, likelihood: ExactLikelihood, own: EquationSites,
    active: Bool[np.ndarray, " n_term"], drawn: dict[str, np.ndarray], stats: dict[str, np.ndarray],
) -> Posterior:  # fmt: skip
    """The draws in the tree of a fit."""
    before, data = posterior.drawn(), posterior.data
    n_chain, n_draw = stats["lp"].shape
    predicted = drawn[own[PREDICTED_SITE]]
    if own.gamma in before:
        # The pattern is given; how probable each term is, linear rows tell.
        included = before[own.inclusion].to_numpy().mean(axis=(0, 1))
        drawn[own.gamma] = np.broadcast_to(active, (n_chain, n_draw, len(active)))
        drawn[own.inclusion] = np.broadcast_to(included, (n_chain, n_draw, len(active)))
    floor = float(equation.design.noise_floor)
    drawn.setdefault(own.noise, np.sqrt(np.maximum(drawn[own.sigma] ** 2 - floor**2, 0.0)))
    placed = (n_chain, n_draw, len(equation.design.coefficients.bounded))
    drawn.setdefault(own.placement, np.full(placed, 0.5))
    designs = {own.equation: equation.design}
    densities = posterior.programs.log_prior(designs, drawn) | likelihood.log_prior(drawn, own)
    kept = {*map(str, before), own.theta_sd, own[START_SITE], own[SENSOR_SITE]}
    groups = {
        "posterior": user_units({name: value for name, value in drawn.items() if name in kept}, posterior.equations),
        "sample_stats": stats,
        "log_prior": densities,
        "observed_data": {own.rate: equation.rows.shown},
        "constant_data": data_table(data),
    }
    tree = tree_of(groups, posterior.equations)
    tree["sample_stats"][PATH_ERROR].attrs |= {
        "units": "1",
        "long_name": "error of the path at all samples together, in standard deviations of their noise",
    }
    for group in ("prior", DETAILS["prior"], "prior_predictive"):
        # Of other priors of noise and starts nothing was drawn.
        if group in posterior.idata.children and not likelihood.restated:
            tree[group] = posterior.idata[group].copy()
    found = replace(posterior, sampling=sampling, idata=tree, made=None)
    if predicted.size <= MOST_NUMBERS:
        sigma = likelihood.sigma(drawn.get(own[SENSOR_SITE]), drawn[own.sigma])
        rng, rows = np.random.default_rng(sampling.seed), equation.rows
        white = rng.standard_normal((n_chain * n_draw, rows.n_row))
        noise = rows.noise.error.correlated(white).reshape(predicted.shape)
        add_group(found, "posterior_predictive", {own.rate: predicted + sigma * noise})
        if likelihood.independent:
            add_group(found, "log_likelihood", {own.rate: likelihood.log_density(predicted, sigma)})
    return found
