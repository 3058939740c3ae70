"""The trial of a fit on data in its saved file: its page needs neither the data nor another integration."""

import json

import xarray as xr

from bayes_greybox.inference.kept.netcdf import TRIED
from bayes_greybox.inference.kept.packing import Packer, Unpacker, as_group, group_arrays
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.remembering import recall, remember

from ..bands import Band
from ..free_run import FreeRun
from ..trial import Trial, trial
from .checks import draws_sum

TRIAL_FORMAT = 1
"""Version of the group; other versions are not read, and the trial is made again, on the training data."""

TRIAL_CLASSES = (Band, FreeRun, Trial)
"""Classes in the group."""


def kept_trial(posterior: Posterior) -> dict[str, xr.Dataset]:
    """Return groups of a file with the trial of a posterior, if it was made."""
    made = recall(posterior, trial)
    if made is None:
        return {}
    packer = Packer(TRIAL_CLASSES)
    record = {"format": TRIAL_FORMAT, "of": draws_sum(posterior), "trial": packer.pack(made, "trial")}
    return {TRIED: as_group(json.dumps(record), packer.arrays)}


def restore_trial(posterior: Posterior, group: xr.Dataset) -> None:
    """Restore the trial from a group of the file, if it belongs to these draws."""
    text, arrays = group_arrays(group)
    record = json.loads(text)
    if record["format"] == TRIAL_FORMAT and record["of"] == draws_sum(posterior):
        remember(posterior, trial, Unpacker(TRIAL_CLASSES, arrays).unpack(record["trial"]))
