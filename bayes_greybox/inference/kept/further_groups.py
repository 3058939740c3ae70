"""Groups that are added to the tree of a fit after its draws: predictions, densities, scales of the slab."""

from collections.abc import Mapping

import numpy as np
import xarray as xr

from bayes_greybox.inference.posterior import Posterior

from .groups import row_dimension


def add_group(
    posterior: Posterior, name: str, values: Mapping[str, np.ndarray], draw: np.ndarray | None = None
) -> None:
    """Add a group with variables [n_chain, n_draw, n_obs] to the tree of a fit.

    `draw` are the numbers of the draws, if not all were kept.
    """
    n_chain, n_draw = next(iter(values.values())).shape[:2]
    rows = {posterior.sites[key].rate: row_dimension(entry) for key, entry in posterior.equations.items()}
    variables, numbers = {}, {}
    for key, value in values.items():
        dimension, number = rows[key]
        if value.shape[2] == len(number):
            numbers[dimension] = number
        else:
            # Under spectral noise the observations are whitened coefficients, fewer than rows and without a time.
            dimension = f"{key}_coefficient"
        variables[key] = (("chain", "draw", dimension), value)
    coords = {"chain": np.arange(n_chain), "draw": np.arange(n_draw) if draw is None else draw}
    posterior.idata[name] = xr.DataTree(xr.Dataset(variables, coords=coords | numbers))


def slab_group(posterior: Posterior) -> xr.Dataset:
    """Return scales and log odds of θ at the draws, for equations whose patterns the sampler summed over."""
    group, variables = posterior.idata["posterior"].dataset, {}
    for name, own in posterior.sites.items():
        slab = posterior.slab(name)
        if slab is not None:
            for variable, value in ((own.theta_sd, slab.sd), (own.log_odds, slab.log_odds)):
                variables[variable] = group[own.theta].copy(data=np.asarray(value).reshape(group[own.theta].shape))
    return xr.Dataset(variables)
