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


def require_draws(tree: xr.DataTree, model: Program, data: Trajectories) -> None:
    """Require that the groups of draws in a file match each other and the model, or raise InputError."""
    # A simulation is read when it is first used: here, so that an error in it is reported with the file's name.
    model.simulator(data, lacking=True)
    sizes, gp = _sizes(tree), model.discrepancy
    of_f = () if gp is None else ("amplitude", "length_scale", "weight" if gp.path == "hsgp" else "f")
    terms = {name: len(each) for name, each in model.dictionaries(data).items()}
    group = xr.merge([tree[name].dataset for name in DRAW_GROUPS[:2] if name in tree.children], compat="override")
    names = [str(name) for name in group]
    for block, equations in model.blocks.items():
        for name in ("log_likelihood", "posterior_predictive", "prior_predictive"):
            if name not in tree.children:
                continue
            values = tree[name].dataset.get(model.sites[block].rate)
            by_row = values is not None and _numeric(values) and values.dims[:2] == DRAW_DIMENSIONS and values.ndim == 3
            _require(by_row, f"{name} has no numbers {model.sites[block].rate!r} for each chain, draw and row")
        own = model.sites.owned(block, names)
        # An equation whose f has no variables has no draws of f.
        for quantity in ("theta", "sigma", "prior_sd", *(of_f if set(of_f) & set(own) else ())):
            _require(quantity in own, f"it has no draws {model.sites[block][quantity]!r}")
        for quantity, dimension in (("theta", "term"), ("length_scale", "variable")):
            if quantity in own:
                alike = group[own[quantity]].dims[2:] == (model.sites[block][dimension],)
                _require(alike, f"{own[quantity]} is not of each {dimension} of {block!r}")
        for quantity, name in own.items():
            _require_variable(name, group[name], quantity, sum(terms[each] for each in equations), sizes)


def _require(met: bool, otherwise: str) -> None:
    if not met:
        raise InputError(f"the file is damaged: {otherwise}.")


def _numeric(values: xr.DataArray) -> bool:
    return values.dtype.kind in "biuf"


def _sizes(tree: xr.DataTree) -> tuple[int, int]:
    """Return the numbers of chains and of draws, which must be the same in all groups."""
    sizes = {}
    for name in (each for each in DRAW_GROUPS if each in tree.children):
        for variable in tree[name].dataset.values():
            _require(variable.dims[:2] == DRAW_DIMENSIONS, f"{variable.name} has no chains and draws")
        sizes[name] = tuple(tree[name].sizes.get(dimension, 0) for dimension in DRAW_DIMENSIONS)
    complete = "posterior" in sizes and "sample_stats" in sizes
    _require(complete, "it lacks the group of draws, or that of the sampler's statistics")
    for name in ("diverging", "energy", "n_steps"):
        values = tree["sample_stats"].dataset.get(name)
        _require(values is not None and _numeric(values), f"it has no {name!r} of the sampler")
    alike = len(set(sizes.values())) == 1 and 0 not in sizes["posterior"]
    _require(alike, f"its groups have {sizes} chains and draws")
    return sizes["posterior"]


def _require_variable(name: str, values: xr.DataArray, quantity: str, n_term: int, sizes: tuple[int, int]) -> None:
    """Require that draws of one quantity have the type, shape and range that the model gives them."""
    _require(_numeric(values) and values.shape[:2] == sizes, f"{name} is not numbers by chain and draw")
    by_term = quantity not in BY_TERM or values.shape[2:] == (n_term,)
    _require(by_term, f"{name} is not of the {n_term} terms of the model")
    _require(values.ndim == AXES.get(quantity, values.ndim), f"{name} has {values.ndim} dimensions")
    numbers = values.to_numpy()
    _require(quantity not in AXES or bool(np.all(np.isfinite(numbers))), f"{name} has draws that are no numbers")
    positive = quantity not in ("sigma", "length_scale") or bool(np.all(numbers > 0))
    _require(positive, f"{name} has draws that are not positive")
