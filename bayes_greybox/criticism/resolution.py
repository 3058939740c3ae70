"""Whether the features resolve the length scales that the posterior asks for."""

import numpy as np

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.model.kernels import KERNELS

QUANTILE = 0.05
"""The basis must resolve all but the shortest five percent of each length scale's posterior."""

LARGEST_BASIS = 400
"""Automatic refits stop at this many features."""


def features_needed(posterior: Posterior) -> dict[str, tuple[int, ...]]:
    """Features per variable that the posterior length scales call for, for equations whose basis has too few.

    m ≥ a L/ℓ resolves the length scale ℓ, with a from Riutort-Mayol et al. 2023, Sec. 4.2, and ℓ the 5 % quantile of
    its posterior in half-widths of the box.

    Returns:
        Features per variable by equation; empty if all is resolved.
    """
    gp = posterior.model.discrepancy
    if gp is None or gp.path != "hsgp":
        return {}
    per_unit = KERNELS[gp.kernel].features_per_unit
    needed = {}
    for name, equation in posterior.equations.items():
        basis = equation.frame.basis
        if basis is None:
            continue
        shortest = np.quantile(posterior.draws(name).hyper.length_scale, QUANTILE, axis=0)
        per_variable = np.array(basis.per_variable)
        required = np.ceil(per_unit * basis.boundary / shortest).astype(int)
        if np.any(required > per_variable):
            needed[name] = tuple(int(m) for m in np.maximum(required, per_variable))
    return needed
