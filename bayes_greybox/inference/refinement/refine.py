"""NUTS on the exact trajectory posterior, started and preconditioned by the posterior on linear rows.

Coordinates are those of the collapsed fit: with m and C = L Lᵀ the mean and covariance of its draws on the real line,
u = m + L η, and NUTS samples η, whose posterior is close to N(0, I) if rows are nearly linear.
"""

import math
from dataclasses import asdict, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool
from threadpoolctl import threadpool_limits

from bayes_greybox.inference.checkpoint import Checkpoint, run_facts
from bayes_greybox.inference.kept.groups import DETAILS, data_table, tree_of, user_units
from bayes_greybox.inference.path_starts import path_of
from bayes_greybox.inference.posterior import MOST_NUMBERS, Posterior
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.inference.whole_rate import WholeRate
from bayes_greybox.model.exact_program import PREDICTED_SITE, SENSOR_SITE, START_SITE, ExactLikelihood, GivenTerms
from bayes_greybox.physics.simulation.code import require_traceable
from bayes_greybox.running.errors import InputError

from .accurate import ACCURATE, AT_ESTIMATE, MOVED, PATH_ERROR, Paths, Sampled
from .exact_paths import Course, ExactPaths
from .linear_start import Stated, first_draws, likelihood_of
from .methods import Method
from .programs import Argument, ProgramKey, exact_programs


# One thread from the beginning: how sums are split must not decide where chains start.
@threadpool_limits.wrap(limits=1)
def refine(
    posterior: Posterior, sampling: Sampling, starts: Stated | None, noise: Stated | None, progress: bool,
    checkpoint: Checkpoint | None = None,
) -> Posterior:  # fmt: skip
    """Sample the exact posterior, from the posterior on linear rows; see `Fit.refine` for starts and noise.

    Paths are followed on steps that are fine enough at the draws of the linear rows. At each exact draw the path is
    followed once more on finer steps. If that moves samples by more than `ACCURATE` of their sizes, or by more than
    `MOVED` of their noise, everything is sampled again.

    Raises:
        InputError: Rows of rates, a fit of a stream, an unknown force, noise of some sensors only, f without weights,
            no path at the estimate, paths that no steps follow accurately, or a checkpoint of another run.
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
    path = path_of(posterior)
    ((name, equation),) = posterior.equations.items()
    if equation.rows.noise.moved:
        raise InputError(
            "An unknown force moves the path of this fit, and refine() knows no paths that a random force moves: leave "
            "out GreyBox(noise=bg.Noise(force=...))."
        )
    own, active = posterior.sites[name], posterior.likeliest_pattern(name)
    rate, columns = _rate(posterior, active)
    course = Course.of(path, posterior.data.samples or posterior.data, posterior.model.rows.interpolation)
    terms = GivenTerms.of(active, equation.design.coefficients)
    key = ProgramKey(posterior.model.bare, name, terms, sampling.tune, sampling.target_accept)

    def likelihood_by(method: Method) -> ExactLikelihood:
        paths, along = ExactPaths(rate, method, columns), course.along(method, rate)
        return likelihood_of(posterior, equation, path, starts or {}, noise or {}, paths, along)

    likelihood = likelihood_by(course.methods[0])
    first = first_draws(posterior, equation, path, own, active, likelihood)
    tried = []
    for method in course.methods:
        argument = jax.tree.map(jnp.asarray, Argument(equation.design, likelihood_by(method)))
        programs = exact_programs(key, argument)
        result = Paths(method, course, programs, own).sampled(argument, first, sampling, progress, checkpoint)
        if result.drawn:
            return _posterior(posterior, sampling, likelihood, active, result)
        tried.append(result)
    raise InputError(_refusal(min(tried, key=lambda each: each.error)))


def _refusal(best: Sampled) -> str:
    """Explain why no draws are accurate, by the method that came closest."""
    if math.isfinite(best.error):
        return (
            f"No steps that are allowed follow the exact paths {best.where} accurately: finer ones move samples by "
            f"{best.error:.2g} times what they may, which is {ACCURATE:g} of the sizes of state and sample and "
            f"{MOVED:g} standard deviations of the noise of all samples together. So it is of stiff equations: give "
            "friction or contacts a width of their own, or take a part of the record."
        )
    lost = f"Exact paths {best.where} leave all bounds, or take more steps than are allowed, as of stiff equations"
    if best.where == AT_ESTIMATE:
        return f"{lost}: nothing can be sampled around it."
    return f"{lost}: state what is known of coefficients (coefficients=...) or of starts, or take a part of the record."


def _rate(
    posterior: Posterior, active: Bool[np.ndarray, " n_term"]
) -> tuple[WholeRate, tuple[tuple[str, tuple[int, ...]], ...]]:
    """Return the rate of all states with the included terms, and the coefficients of each learned state."""
    frames, columns = {}, {}
    for state, each in posterior.learned().items():
        index = np.arange(len(active))[each.columns]
        # Features have all terms projected out of them.
        used = index[active[index]] if each.frame.basis is None and any(active[index]) else index
        frames[state], columns[state] = each.frame.of_terms(used - index[0]), tuple(used.tolist())
    simulation = posterior.model.simulator(posterior.data)
    if not simulation.differentiable:
        raise InputError(
            "refine() differentiates integrated paths at every step of NUTS, and a simulation that is an FMU cannot be "
            "differentiated so: the posterior on linear rows, which is this fit, is what there is."
        )
    require_traceable(simulation)
    return WholeRate(simulation, frames, posterior.data.columns), tuple(columns.items())


def _posterior(
    posterior: Posterior, sampling: Sampling, likelihood: ExactLikelihood, active: Bool[np.ndarray, " n_term"],
    sampled: Sampled,
) -> Posterior:  # fmt: skip
    """Return the exact draws in the tree of a fit."""
    ((name, equation),) = posterior.equations.items()
    own, drawn, stats = posterior.sites[name], sampled.drawn, sampled.stats
    before, data = posterior.drawn(), posterior.data
    n_chain, n_draw = stats["lp"].shape
    predicted = drawn[own[PREDICTED_SITE]]
    if own.gamma in before:
        # The pattern is fixed; the probability of each term comes from linear rows.
        included = before[own.inclusion].to_numpy().mean(axis=(0, 1))
        drawn[own.gamma] = np.broadcast_to(active, (n_chain, n_draw, len(active)))
        drawn[own.inclusion] = np.broadcast_to(included, (n_chain, n_draw, len(active)))
    floor = float(equation.design.noise_floor)
    drawn.setdefault(own.noise, np.sqrt(np.maximum(drawn[own.sigma] ** 2 - floor**2, 0.0)))
    placed = (n_chain, n_draw, len(equation.design.coefficients.bounded))
    drawn.setdefault(own.placement, np.full(placed, 0.5))
    densities = posterior.programs.log_prior({name: equation.design}, drawn) | likelihood.log_prior(drawn, own)
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
        # Nothing was drawn from other priors of noise and starts.
        if group in posterior.idata.children and not likelihood.restated:
            tree[group] = posterior.idata[group].copy()
    result = replace(posterior, sampling=sampling, idata=tree, made=None)
    if predicted.size <= MOST_NUMBERS:
        sigma = likelihood.sigma(drawn.get(own[SENSOR_SITE]), drawn[own.sigma])
        rng, rows = np.random.default_rng(sampling.seed), equation.rows
        white = rng.standard_normal((n_chain * n_draw, rows.n_row))
        noise = rows.noise.error.correlated(white).reshape(predicted.shape)
        result.add_group("posterior_predictive", {own.rate: predicted + sigma * noise})
        if likelihood.independent:
            result.add_group("log_likelihood", {own.rate: likelihood.log_density(predicted, sigma)})
    return result
