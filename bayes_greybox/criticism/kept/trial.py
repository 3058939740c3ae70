"""How a fit does on data, in its saved file: its page needs neither the data nor to integrate again."""

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

FORMAT = 1
"""Of the group; of another one nothing is read, and the trial is made again, on the training data."""

CLASSES = (Band, FreeRun, Trial)
"""Classes of what it holds."""


def kept_trial(posterior: Posterior) -> dict[str, xr.Dataset]:
    """Groups of a file with the trial of a posterior, where it was made.

    Args:
        posterior: Fitted model.
    """
    found = recall(posterior, trial)
    if found is None:
        return {}
    packer = Packer(CLASSES)
    record = {"format": FORMAT, "of": draws_sum(posterior), "trial": packer.pack(found, "trial")}
    return {TRIED: as_group(json.dumps(record), packer.arrays)}


def restore_trial(posterior: Posterior, group: xr.Dataset) -> None:
    """Have a posterior that was read from a file know the trial that the file has, if it is of its draws.

    Args:
        posterior: What was read.
        group: Of the file.
    """
    text, arrays = group_arrays(group)
    record = json.loads(text)
    if record["format"] == FORMAT and record["of"] == draws_sum(posterior):
        remember(posterior, trial, Unpacker(CLASSES, arrays).unpack(record["trial"]))
