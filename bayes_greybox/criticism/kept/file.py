"""Saved fits with the results of model criticism: checks, trade-offs and trials."""

import os

import xarray as xr

from bayes_greybox.inference.kept import netcdf
from bayes_greybox.inference.kept.damage import made_of
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.physics.simulation.fmu.given import FMU
from bayes_greybox.physics.simulation.protocol import RightHandSide

from .checks import kept_checks, kept_trade_offs, restore_checks, restore_trade_offs
from .trial import kept_trial, restore_trial


def save_checked(
    posterior: Posterior,
    path: str | os.PathLike[str],
    attributes: dict[str, str] | None = None,
    groups: dict[str, xr.Dataset] | None = None,
) -> None:
    """Write a posterior with its checks and its trial, if they were made; see `netcdf.save`."""
    texts, tried = _results(posterior)
    netcdf.save(posterior, path, {**(attributes or {}), **texts}, {**(groups or {}), **tried})


def save_found(posterior: Posterior, saved: str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """Write a posterior like `save_checked`, with arrays copied from a file without its trial; see `netcdf.add`."""
    netcdf.add(saved, path, *_results(posterior))


def load_checked(path: str | os.PathLike[str], simulation: RightHandSide | FMU | None = None) -> Posterior:
    """Read a saved fit with its checks and its trial, if the file has them.

    `simulation` is the function of the simulation, if the model had one. InputError is raised as by `netcdf.read`, if
    the function is missing, and for the file of a study whose model was not sampled.
    """
    tree = netcdf.read(path)
    netcdf.require_sampled(tree, path)
    with made_of(path):
        return checked_of(tree, simulation)


def checked_of(tree: xr.DataTree, simulation: RightHandSide | FMU | None = None) -> Posterior:
    """Return the posterior of the groups of a file, with its checks and its trial; see `netcdf.posterior_of`."""
    tried = tree.children.get(netcdf.TRIED)
    posterior = netcdf.posterior_of(tree, simulation)
    restore_checks(posterior)
    restore_trade_offs(posterior)
    if tried is not None:
        restore_trial(posterior, tried.to_dataset())
    return posterior


def _results(posterior: Posterior) -> tuple[dict[str, str], dict[str, xr.Dataset]]:
    """Return attributes and groups of a file with the results of model criticism."""
    return {**kept_checks(posterior), **kept_trade_offs(posterior)}, kept_trial(posterior)
