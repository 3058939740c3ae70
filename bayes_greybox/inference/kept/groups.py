"""Groups of draws as an ArviZ DataTree: dimensions named by equation, values in user's units."""

import importlib.metadata
import platform
from collections.abc import Container, Mapping
from typing import Any

import numpy as np
import xarray as xr

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.equation import Equation
from bayes_greybox.model.sites import Sites

DETAILS = {"posterior": "posterior_details", "prior": "prior_details"}
"""Groups of draws, and the groups beside them with the variables that would swamp plots and tables."""

DETAILED = ("weight", "f", "prior_sd", "gamma", "inclusion")
"""Those variables: hundreds of weights or values of f, and patterns and scales, many of which never change. ArviZ has
no density or ranks of equal integers, and no density of numbers that differ by rounding only."""


def user_units(samples: Mapping[str, np.ndarray], equations: Mapping[str, Equation]) -> dict[str, np.ndarray]:
    """Return draws under their public names in user's units, without raw coordinates of other sites."""
    named = dict(samples)
    for name, own in Sites(equations).items():
        frame = equations[name].frame
        for raw in own.raw:
            named.pop(raw, None)
        units: dict[str, Any] = dict.fromkeys((own.sigma, own.amplitude, own.weight, own.f), frame.target_scale)
        units |= {own.length_scale: frame.half_width, own.theta: frame.coefficient_scale}
        for variable in units.keys() & named.keys():
            named[variable] = named[variable] * units[variable]
        if own.theta_sd in named:
            named[own.prior_sd] = named.pop(own.theta_sd)
        if own.gamma in named:
            named[own.gamma] = named[own.gamma].astype(np.int64)
    return named


def tree_of(groups: dict[str, dict[str, np.ndarray]], equations: Mapping[str, Equation]) -> xr.DataTree:
    """Return groups as a DataTree with dimensions named by equation, and details in groups of their own."""
    import arviz_base  # three seconds, so not at the top

    dims: dict[str, list[str]] = {}
    coords: dict[str, Any] = {"obs_id": np.arange(len(groups["constant_data"]["t"]))}
    for name, own in Sites(equations).items():
        frame = equations[name].frame
        coords[own["term"]] = list(frame.dictionary.names)
        dimension, numbers = row_dimension(equations[name])
        coords[dimension] = numbers
        dims[own.rate] = [dimension]
        for variable in (own.theta, own.prior_sd, own.gamma, own.inclusion, own["v"], own["lambda"]):
            dims[variable] = [own["term"]]
        if frame.variables:
            coords[own["variable"]] = list(frame.variables)
            dims[own.length_scale] = [own["variable"]]
        if frame.basis is not None:
            coords[own["basis"]] = np.arange(frame.basis.size)
            dims[own.weight] = [own["basis"]]
        dims[own.f] = ["obs_id"]
    tree = xr.DataTree()
    for group, variables in groups.items():
        # Densities of whole sites have no event dimensions.
        named = {var: dims[var] for var in variables if var in dims and group != "log_prior"}
        if group == "constant_data":
            named = dict.fromkeys(variables, ["obs_id"])
        if group in ("posterior", "prior"):
            # A user-defined prior may have sites with the names of the package's and other shapes.
            shapes = {var: tuple(len(coords[dim]) for dim in named[var]) for var in named}
            named = {var: named[var] for var in named if np.shape(variables[var])[2:] == shapes[var]}
        used = {dim: coords[dim] for var in named for dim in named[var] if dim in coords}
        tree[group] = arviz_base.from_dict({group: variables}, coords=used, dims=named)[group]
    part_details(tree, Sites(equations))
    tree.attrs = {
        "inference_library": "bayes_greybox",
        "inference_library_version": importlib.metadata.version("bayes-greybox"),
        "python_version": platform.python_version(),
    }
    return tree


def part_details(tree: xr.DataTree, sites: Sites) -> None:
    """Move the details among the draws to groups of their own, in place; older files have them among the others."""
    for source, details in DETAILS.items():
        if source not in tree.children:
            continue
        group = tree[source].dataset
        names = [str(name) for name in group]
        moved = {own[q] for e, own in sites.items() for q in sites.owned(e, names) if q in DETAILED}
        if moved:
            tree[details] = xr.DataTree(group[[name for name in names if name in moved]])
            tree[source] = xr.DataTree(group[[name for name in names if name not in moved]])


def drawn(tree: xr.DataTree, source: str) -> xr.Dataset:
    """Return all variables of a group of draws, details included."""
    group, details = tree[source].dataset, DETAILS.get(source, "")
    return group.assign(tree[details].dataset.data_vars) if details in tree.children else group


def row_dimension(equation: Equation) -> tuple[str, np.ndarray]:
    """Return the dimension of the rows of an equation, and the numbers of their samples."""
    rows = equation.rows
    return ("obs_id" if rows.operator is None else "row_id"), rows.sample


def data_table(data: Trajectories) -> dict[str, np.ndarray]:
    """Return all columns of the data under names that netCDF allows; see `rate_name` for derivatives."""
    columns = {**data.columns, **{name: data.derivatives[name] for name in data.output_names}}
    rates = {rate_name(name, columns): data.derivatives[name] for name in data.derivative_names}
    return {"t": data.time, "run": data.run, **columns, **rates}


def rate_name(state: str, columns: Container[str]) -> str:
    """Return the name of the derivative of a state: `e_rate`, changed if a column of the data is called so."""
    name = Sites([state])[state].rate
    while name in columns:
        name += "_"
    return name


def to_inferencedata(tree: xr.DataTree) -> Any:
    """Return the groups of a fit in the form that the functions of the installed `arviz` take.

    This is a `DataTree` for ArviZ 1 and later, and an `arviz.InferenceData` before. Arrays are shared, not copied.
    """
    import arviz  # some seconds, so not at the top

    # ArviZ 1 answers to the old name as well, with a warning and the class DataTree.
    kind = vars(arviz).get("InferenceData")
    if kind is None:
        return tree.copy()
    return kind(attrs=dict(tree.attrs), **{name: node.to_dataset() for name, node in tree.children.items()})
