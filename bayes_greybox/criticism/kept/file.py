"""Saved fits with the results of model criticism: checks, trade-offs and trials."""

import json
import os

import xarray as xr

from bayes_greybox.inference.kept import netcdf
from bayes_greybox.inference.kept.damage import made_of
from bayes_greybox.inference.kept.packing import Packer, Unpacker, as_group, group_arrays
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.remembering import recall, remember
from bayes_greybox.physics.simulation.fmu.given import FMU
from bayes_greybox.physics.simulation.protocol import RightHandSide

from ..bands import Band
from ..free_run import FreeRun
from ..trial import Trial, trial
from .checks import draws_sum, kept_checks, kept_trade_offs, restore_checks, restore_trade_offs

TRIAL_FORMAT = 1
"""Version of the group; other versions are not read, and the trial is made again, on the training data."""

TRIAL_CLASSES = (Band, FreeRun, Trial)
"""Classes in the group."""


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


def load_checked(path: str | os.PathLike[str]) -> Posterior:
    """Read a saved fit with its checks and its trial, if the file has them.

    InputError is raised as by `netcdf.read`, for a simulation that was a function, and for the file of a study whose
    model was not sampled.
    """
    tree = netcdf.read(path)
    netcdf.require_sampled(tree, path)
    with made_of(path):
        return checked_of(tree)


def checked_of(tree: xr.DataTree, simulation: RightHandSide | FMU | None = None) -> Posterior:
    """Return the posterior of the groups of a file, with its checks and its trial; see `netcdf.posterior_of`."""
    tried = tree.children.get(netcdf.TRIED)
    posterior = netcdf.posterior_of(tree, simulation)
    restore_checks(posterior)
    restore_trade_offs(posterior)
    if tried is not None:
        restore_trial(posterior, tried.to_dataset())
    return posterior


def kept_trial(posterior: Posterior) -> dict[str, xr.Dataset]:
    """Return groups of a file with the trial of a posterior, if it was made."""
    made = recall(posterior, trial)
    if made is None:
        return {}
    packer = Packer(TRIAL_CLASSES)
    record = {"format": TRIAL_FORMAT, "of": draws_sum(posterior), "trial": packer.pack(made, "trial")}
    return {netcdf.TRIED: as_group(json.dumps(record), packer.arrays)}


def restore_trial(posterior: Posterior, group: xr.Dataset) -> None:
    """Restore the trial from a group of the file, if it belongs to these draws."""
    text, arrays = group_arrays(group)
    record = json.loads(text)
    if record["format"] == TRIAL_FORMAT and record["of"] == draws_sum(posterior):
        remember(posterior, trial, Unpacker(TRIAL_CLASSES, arrays).unpack(record["trial"]))


def _results(posterior: Posterior) -> tuple[dict[str, str], dict[str, xr.Dataset]]:
    """Return attributes and groups of a file with the results of model criticism."""
    return {**kept_checks(posterior), **kept_trade_offs(posterior)}, kept_trial(posterior)
