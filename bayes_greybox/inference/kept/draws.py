"""Checks that the draws in a file belong to the model in it."""

import numpy as np
import xarray as xr

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.program import Program
from bayes_greybox.running.errors import InputError

from .groups import DETAILS

DRAW_DIMENSIONS = ("chain", "draw")
"""First dimensions of every variable of draws."""

DRAW_GROUPS = ("posterior", DETAILS["posterior"], "sample_stats", "log_prior")
"""Groups with values for every draw."""

BY_TERM = ("theta", "prior_sd", "gamma", "inclusion")
"""Quantities with one number for each term."""

AXES = {**dict.fromkeys(BY_TERM, 3), "sigma": 2, "amplitude": 2, "length_scale": 3, "weight": 3, "f": 3}
"""Number of dimensions of the quantities that the package itself draws."""

POSITIVE = ("sigma", "length_scale")
"""Quantities that are divided by."""

BY_ROW = ("log_likelihood", "posterior_predictive", "prior_predictive")
"""Optional groups with one number for each row of each equation and draw."""

NEEDED_STATISTICS = ("diverging", "energy", "n_steps")
"""Statistics of the sampler that the verdict on convergence needs."""

NEEDED = ("theta", "sigma", "prior_sd")
"""Quantities that every equation has."""


def require_draws(tree: xr.DataTree, model: Program, data: Trajectories) -> None:
    """Require that the groups of draws in a file match each other and the model, or raise InputError."""
    # A simulation is read when it is first used: here, so that an error in it is reported with the file's name.
    model.simulator(data, lacking=True)
    sizes = _sizes(tree)
    terms = {name: len(each) for name, each in model.dictionaries(data).items()}
    group = xr.merge([tree[name].dataset for name in DRAW_GROUPS[:2] if name in tree.children], compat="override")
    names = [str(name) for name in group]
    for block, equations in model.blocks.items():
        for name in BY_ROW:
            _require_rows(tree, name, model.sites[block].rate)
        own = model.sites.owned(block, names)
        # An equation whose f has no variables has no draws of f.
        of_f = tuple(quantity for quantity in _of_f(model) if set(_of_f(model)) & set(own))
        for quantity in (*NEEDED, *of_f):
            if quantity not in own:
                raise InputError(f"the file is damaged: it has no draws {model.sites[block][quantity]!r}.")
        for quantity, dimension in (("theta", "term"), ("length_scale", "variable")):
            if quantity in own and group[own[quantity]].dims[2:] != (model.sites[block][dimension],):
                raise InputError(f"the file is damaged: {own[quantity]} is not of each {dimension} of {block!r}.")
        for quantity, name in own.items():
            _require_variable(name, group[name], quantity, sum(terms[each] for each in equations), sizes)


def _of_f(model: Program) -> tuple[str, ...]:
    """Return the quantities that an equation with a discrepancy has."""
    if model.discrepancy is None:
        return ()
    return ("amplitude", "length_scale", "weight" if model.discrepancy.path == "hsgp" else "f")


def _sizes(tree: xr.DataTree) -> tuple[int, int]:
    """Return the numbers of chains and of draws, which must be the same in all groups."""
    sizes = {}
    for name in DRAW_GROUPS:
        if name in tree.children:
            for variable in tree[name].dataset.values():
                if variable.dims[:2] != DRAW_DIMENSIONS:
                    raise InputError(f"the file is damaged: {variable.name} has no chains and draws.")
            sizes[name] = tuple(tree[name].sizes.get(dimension, 0) for dimension in DRAW_DIMENSIONS)
    if "posterior" not in sizes or "sample_stats" not in sizes:
        raise InputError("the file is damaged: it lacks the group of draws, or that of the sampler's statistics.")
    for name in NEEDED_STATISTICS:
        if name not in tree["sample_stats"].dataset or tree["sample_stats"][name].dtype.kind not in "biuf":
            raise InputError(f"the file is damaged: it has no {name!r} of the sampler.")
    if len(set(sizes.values())) > 1 or 0 in sizes["posterior"]:
        raise InputError(f"the file is damaged: its groups have {sizes} chains and draws.")
    return sizes["posterior"]


def _require_rows(tree: xr.DataTree, group: str, name: str) -> None:
    """Require numbers for every row of an equation in a group, if the file has the group."""
    if group in tree.children:
        values = tree[group].dataset.get(name)
        if values is None or values.dtype.kind not in "biuf" or values.dims[:2] != DRAW_DIMENSIONS or values.ndim != 3:
            raise InputError(f"the file is damaged: {group} has no numbers {name!r} for each chain, draw and row.")


def _require_variable(name: str, values: xr.DataArray, quantity: str, n_term: int, sizes: tuple[int, int]) -> None:
    """Require that draws of one quantity have the type, shape and range that the model gives them."""
    if values.dtype.kind not in "biuf" or values.shape[:2] != sizes:
        raise InputError(f"the file is damaged: {name} is not numbers by chain and draw.")
    if quantity in BY_TERM and values.shape[2:] != (n_term,):
        raise InputError(f"the file is damaged: {name} is not of the {n_term} terms of the model.")
    if values.ndim != AXES.get(quantity, values.ndim):
        raise InputError(f"the file is damaged: {name} has {values.ndim} dimensions.")
    numbers = values.to_numpy()
    if quantity in AXES and not np.all(np.isfinite(numbers)):
        raise InputError(f"the file is damaged: {name} has draws that are no numbers.")
    if quantity in POSITIVE and np.any(numbers <= 0):
        raise InputError(f"the file is damaged: {name} has draws that are not positive.")
