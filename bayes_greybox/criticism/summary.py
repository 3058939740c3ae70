"""One table of all estimates with the precision of their sampling."""

import numpy as np
import pandas as pd

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.physics.units import target_unit

from .convergence import precision_of
from .inclusion import inclusion


def summary(posterior: Posterior, level: float = 0.9) -> pd.DataFrame:
    """Return coefficients, noise and kernel of every equation, with equal-tailed intervals.

    Returns:
        Table indexed by (equation, quantity): mean, sd, lower, upper, unit, r_hat, ess_bulk, ess_tail. Quantities
        are the terms, `sigma`, `amplitude` and `length_scale[variable]`, in user's units. A coefficient that is fixed,
        or zero in every draw, has no R̂ or effective sample size. Equations that share their rows have one `sigma`,
        that of "x_and_y".
    """
    group = posterior.idata["posterior"].dataset
    tail = (1 - level) / 2
    terms = inclusion(posterior, level)
    rows: dict[tuple[str, str], tuple] = {}
    for name, equation in posterior.equations.items():
        frame, own = equation.frame, posterior.sites[name]
        quantities = {
            label: (group[own.theta].isel({own["term"]: j}).to_numpy(), terms.loc[label, "unit"])
            for j, label in enumerate(frame.labels)
        }
        rate_unit = target_unit(name, posterior.data)
        quantities[(name, "sigma")] = (group[own.sigma].to_numpy(), rate_unit)
        if own.amplitude in group:
            quantities[(name, "amplitude")] = (group[own.amplitude].to_numpy(), rate_unit)
            for d, variable in enumerate(frame.variables):
                scale = group[own.length_scale].isel({own["variable"]: d}).to_numpy()
                quantities[(name, f"length_scale[{variable}]")] = (scale, posterior.data.unit(variable) or "")
        shape, learned = group[own.sigma].shape, {name, *(state for state, _ in frame.labels)}
        for label in terms.index:
            if label[0] in learned and label not in quantities:
                quantities[label] = (np.full(shape, terms.loc[label, "mean"]), terms.loc[label, "unit"])
        for quantity, (draws, unit) in quantities.items():
            moving = np.ptp(draws) > 0
            r_hat, bulk, tail_size, _ = precision_of(draws)
            # The mean of many equal numbers is not exactly that number.
            mean, sd = (draws.mean(), draws.std()) if moving else (float(draws.flat[0]), 0.0)
            lower, upper = np.quantile(draws, tail), np.quantile(draws, 1 - tail)
            rows[quantity] = (mean, sd, lower, upper, unit, r_hat, bulk, tail_size)
    index = pd.MultiIndex.from_tuples(list(rows), names=["equation", "quantity"])
    columns = ["mean", "sd", "lower", "upper", "unit", "r_hat", "ess_bulk", "ess_tail"]
    return pd.DataFrame(list(rows.values()), index=index, columns=columns)
