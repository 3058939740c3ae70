"""Saved fits with what criticism found out about them: checks, and how they do on data."""

import os

import xarray as xr

from bayes_greybox.inference.kept import netcdf
from bayes_greybox.inference.kept.damage import made_of
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.physics.simulation.fmu.given import FMU
from bayes_greybox.physics.simulation.protocol import RightHandSide

from .checks import kept_checks, restore_checks
from .trade_off import kept_trade_offs, restore_trade_offs
from .trial import kept_trial, restore_trial


def save_checked(
    posterior: Posterior,
    path: str | os.PathLike[str],
    attributes: dict[str, str] | None = None,
    groups: dict[str, xr.Dataset] | None = None,
) -> None:
    """Write a posterior with its checks and its trial, where they were made.

    Args:
        posterior: What to save.
        path: Destination.
        attributes: Further root attributes of the file.
        groups: Further groups of the file.

    Raises:
        InputError: The destination cannot be written.
    """
    texts, tried = _found(posterior)
    netcdf.save(posterior, path, {**(attributes or {}), **texts}, {**(groups or {}), **tried})


def save_found(posterior: Posterior, saved: str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """`save_checked` of a posterior that was saved already, before its trial: what is in that file is copied.

    Args:
        posterior: What was saved, as it was then.
        saved: Its file.
        path: Destination, another file.

    Raises:
        InputError: The destination cannot be written.
    """
    netcdf.add(saved, path, *_found(posterior))


def load_checked(path: str | os.PathLike[str], simulation: RightHandSide | FMU | None = None) -> Posterior:
    """Read a saved fit with its checks and its trial, if they are in the file.

    Args:
        path: File.
        simulation: The simulation's function, if the model had one.

    Raises:
        InputError: Whatever `netcdf.read` refuses; the file of a study whose model was not sampled; a function is
            needed.
    """
    tree = netcdf.read(path)
    netcdf.require_sampled(tree, path)
    with made_of(path):
        return checked_of(tree, simulation)


def checked_of(tree: xr.DataTree, simulation: RightHandSide | FMU | None = None) -> Posterior:
    """The posterior that the groups of a file hold, with its checks and its trial, if they are there.

    Args:
        tree: What `netcdf.read` returned; its groups become the posterior's own.
        simulation: The simulation's function, if the model had one.

    Raises:
        InputError: A function is needed.
    """
    tried = tree.children.get(netcdf.TRIED)
    posterior = netcdf.posterior_of(tree, simulation)
    restore_checks(posterior)
    restore_trade_offs(posterior)
    if tried is not None:
        restore_trial(posterior, tried.to_dataset())
    return posterior


def _found(posterior: Posterior) -> tuple[dict[str, str], dict[str, xr.Dataset]]:
    """Attributes and groups of a file with what was found out about a posterior."""
    return {**kept_checks(posterior), **kept_trade_offs(posterior)}, kept_trial(posterior)
