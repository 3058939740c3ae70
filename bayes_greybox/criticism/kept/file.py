"""Saved fits with the results of model criticism, so that their pages need not compute them again."""

import json
import os
from importlib.metadata import version
from zlib import crc32

import numpy as np
import xarray as xr

from bayes_greybox.inference.kept import netcdf
from bayes_greybox.inference.kept.damage import made_of
from bayes_greybox.inference.kept.packing import Packer, Unpacker, as_group, group_arrays
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.remembering import recall, remember
from bayes_greybox.physics.simulation.fmu.given import FMU
from bayes_greybox.physics.simulation.protocol import RightHandSide

from ..bands import Band
from ..checks.checks import Checks, checks
from ..checks.loo_pit import LooPit
from ..checks.whiteness import Whiteness
from ..free_run import FreeRun
from ..trade_off import plain_trade_offs
from ..trial import Trial, trial

RESULTS = {"trial": trial, "checks": checks, "plain_trade_offs": plain_trade_offs}
"""Functions whose results a file holds, by name in its group."""

RESULTS_FORMAT = 1
"""Version of the group; other versions are not read, and results are computed again, the trial on the training data."""

CLASSES = (Band, FreeRun, Trial, Checks, LooPit, Whiteness)
"""Classes in the group."""


def save_checked(
    posterior: Posterior,
    path: str | os.PathLike[str],
    attributes: dict[str, str] | None = None,
    groups: dict[str, xr.Dataset] | None = None,
) -> None:
    """Write a posterior with the results that were computed; see `netcdf.save`."""
    netcdf.save(posterior, path, attributes, {**(groups or {}), **kept_results(posterior)})


def save_found(posterior: Posterior, saved: str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """Write a posterior like `save_checked`, with arrays copied from a file that lacks later results."""
    netcdf.add(saved, path, kept_results(posterior))


def load_checked(path: str | os.PathLike[str]) -> Posterior:
    """Read a saved fit with the results in its file.

    InputError is raised as by `netcdf.read`, for a simulation that was a function, and for the file of a study whose
    model was not sampled.
    """
    tree = netcdf.read(path)
    netcdf.require_sampled(tree, path)
    with made_of(path):
        return checked_of(tree)


def checked_of(tree: xr.DataTree, simulation: RightHandSide | FMU | None = None) -> Posterior:
    """Return the posterior of the groups of a file, with the results in them; see `netcdf.posterior_of`."""
    results = tree.children.get(netcdf.TRIED)
    posterior = netcdf.posterior_of(tree, simulation)
    # Files of earlier layouts hold these as text, and they are computed again.
    for name in ("checks", "plain_trade_offs"):
        posterior.idata.attrs.pop(name, None)
    if results is not None:
        restore_results(posterior, results.to_dataset())
    return posterior


def kept_results(posterior: Posterior) -> dict[str, xr.Dataset]:
    """Return groups of a file with the results that were computed."""
    packer = Packer(CLASSES)
    made = {name: recall(posterior, function) for name, function in RESULTS.items()}
    packed = {name: packer.pack(result, name) for name, result in made.items() if result is not None}
    if not packed:
        return {}
    record = {"format": RESULTS_FORMAT, "version": version("bayes-greybox"), "of": draws_sum(posterior), **packed}
    return {netcdf.TRIED: as_group(json.dumps(record), packer.arrays)}


def restore_results(posterior: Posterior, group: xr.Dataset) -> None:
    """Restore results from a group of the file that belongs to these draws; those of another version only a trial."""
    text, arrays = group_arrays(group)
    record, unpacker = json.loads(text), Unpacker(CLASSES, arrays)
    if record["format"] != RESULTS_FORMAT or record["of"] != draws_sum(posterior):
        return
    for name, function in RESULTS.items():
        if name in record and (function is trial or record["version"] == version("bayes-greybox")):
            remember(posterior, function, unpacker.unpack(record[name]))


def draws_sum(posterior: Posterior) -> int:
    """Return a check sum of all draws."""
    group, total = posterior.idata["posterior"].dataset, 0
    for name in sorted(map(str, group.data_vars)):
        total = crc32(np.ascontiguousarray(group[name].to_numpy()).tobytes(), total)
    return total
