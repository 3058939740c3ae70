"""Where the record starts, as a fit to samples estimates it beside its coefficients."""

from collections.abc import Mapping

import numpy as np

from bayes_greybox.inference.path_starts import path_of, start_draws
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.remembering import remembered
from bayes_greybox.model.exact_program import START_SITE

from .learned import Value


@remembered
def estimated_starts(posterior: Posterior) -> Mapping[str, Value]:
    """States at the first sample of the first run, measured or not, with their standard deviations; user's units.

    Draws are those of the likeliest pattern, as in the equations of `fitted_system`.

    Args:
        posterior: The fit.

    Returns:
        By state; empty where rows follow no path from its start, or an unknown force moves it.
    """
    model = posterior.model
    if not model.rows.follows_path:
        return {}
    ((block, equation),) = posterior.equations.items()
    if equation.rows.noise.moved:
        return {}
    values = posterior.values(block)
    active = posterior.likeliest_pattern(block)
    patterns = values.get("gamma", np.ones((len(values["sigma"]), len(active)), bool))
    alike = np.all(patterns.astype(bool) == active, axis=1)
    if START_SITE in values:
        draws = values[START_SITE][alike]
    else:
        drawn = posterior.draws(block)
        draws = start_draws(
            equation, path_of(posterior), np.asarray(drawn.theta)[alike], np.asarray(drawn.weight)[alike],
            np.asarray(drawn.hyper.sigma)[alike], posterior.sampling.seed,
        )  # fmt: skip
    states = model.simulator(posterior.data).states
    return {name: Value.of(draws[:, 0, k]) for k, name in enumerate(states)}
