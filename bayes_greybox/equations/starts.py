"""States at the start of a record, as estimated by a fit to samples."""

from collections.abc import Mapping

import numpy as np

from bayes_greybox.inference.path_starts import path_of, start_draws
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.remembering import remembered
from bayes_greybox.model.exact_program import START_SITE

from .learned import Value


@remembered
def estimated_starts(posterior: Posterior) -> Mapping[str, Value]:
    """Return all states at the first sample of the first run, by state; user's units.

    Draws are those of the likeliest pattern, as in the equations of `fitted_system`. There are no starts if rows follow
    no path from its start, or an unknown force moves it.
    """
    model = posterior.model
    if not model.rows.follows_path:
        return {}
    ((block, equation),) = posterior.equations.items()
    if equation.rows.noise.moved:
        return {}
    values = posterior.values(block)
    alike = np.all(posterior.patterns(block) == posterior.likeliest_pattern(block), axis=1)
    if START_SITE in values:
        draws = values[START_SITE][alike]
    else:
        drawn = posterior.draws(block)
        theta, weight, sigma = (np.asarray(each)[alike] for each in (drawn.theta, drawn.weight, drawn.hyper.sigma))
        draws = start_draws(equation, path_of(posterior), theta, weight, sigma, posterior.sampling.seed)
    states = model.simulator(posterior.data).states
    return {name: Value.of(draws[:, 0, k]) for k, name in enumerate(states)}
