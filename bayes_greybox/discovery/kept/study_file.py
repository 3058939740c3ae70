"""The file of a study: its tables, maps, free runs and equations, beside the amended model's posterior if there is one.

Everything that pages, equations and free runs need is kept to the last bit, so that a study that was read shows the
same. Rows, products and posteriors of hypotheses, on which it was weighed, are not kept.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import xarray as xr

from bayes_greybox.criticism.bands import Band
from bayes_greybox.criticism.kept.file import checked_of, save_checked
from bayes_greybox.discovery.answer.amendment import Amendment, Remainder
from bayes_greybox.discovery.answer.coefficients import Coefficients
from bayes_greybox.discovery.answer.explained import Component, Explained
from bayes_greybox.discovery.answer.gap.free_runs import FreePath
from bayes_greybox.discovery.answer.where import GapMap, GapTrace
from bayes_greybox.discovery.decision.reasons import Reason
from bayes_greybox.discovery.regressors.clouds import Cloud
from bayes_greybox.discovery.regressors.columns import Column, Nearer
from bayes_greybox.discovery.sensor_errors.channels import ChannelSuspect
from bayes_greybox.discovery.sensor_errors.memory import Memory
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.inference.kept import netcdf
from bayes_greybox.inference.kept.kinds import require_kinds
from bayes_greybox.inference.kept.model_record import describe, rebuild
from bayes_greybox.inference.kept.packing import Packer, Unpacker, as_group, group_arrays
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.rows.kinds import ROW_KINDS
from bayes_greybox.physics.catalogue.effects import BoundEffect, Effect
from bayes_greybox.physics.catalogue.inner_parameter import InnerParameter
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.simulation.fmu.given import FMU
from bayes_greybox.physics.simulation.protocol import RightHandSide

from .files_of_before import add_codes
from .known_columns import Features, KnownColumns, kept_amendment, lost

STUDY_FORMAT = 1
"""Format of the group; of another one the fit alone is read."""

STUDY_CLASSES = (
    Amendment, Band, BoundEffect, ChannelSuspect, Cloud, Coefficients, Column, Component, Effect, Explained,
    Features, FreePath, GapMap, GapTrace, HiddenState, HilbertBasis, InnerParameter, KnownColumns, Memory, Nearer,
    Reason, Remainder, *ROW_KINDS.values(),
)  # fmt: skip
"""Classes of the values in a file."""

MODELS = ("base", "model", "fit")
"""Attributes of a study that are kept as models."""


def save_study(study: StudyResult, path: str | os.PathLike[str], record: Mapping[str, Any]) -> None:
    """Write a study to a netCDF file, with the posterior of its amended model if there is one.

    Args:
        study: The study.
        path: Destination.
        record: The study as plain values, for other programs.

    Raises:
        InputError: The destination cannot be written.
    """
    packer = Packer(STUDY_CLASSES, leave_out=("corrected",))
    # The data first, which others refer to.
    ordered = {each.name: getattr(study, each.name) for each in fields(StudyResult) if each.name not in MODELS}
    ordered["amendments"] = {name: kept_amendment(each) for name, each in study.amendments.items()}
    values = {name: packer.pack(value, name) for name, value in ordered.items()}
    models = {"base": describe(study.base, study.train), "model": describe(study.model, study.corrected)}
    same = study.fit is not None and study.fit.data is study.corrected
    text = json.dumps({"format": STUDY_FORMAT, "models": models, "values": values, "same_data": same}, default=float)
    group, plain = as_group(text, packer.arrays), {netcdf.STUDIED: json.dumps(record, default=float)}
    if study.fit is None:
        netcdf.save_unsampled(path, plain, {netcdf.STUDIED: group})
    else:
        save_checked(study.fit, path, plain, {netcdf.STUDIED: group})


def holds_study(tree: xr.DataTree) -> bool:
    """Return whether the groups of a file hold a whole study, and not a fit alone, as do files of version 0.1.0."""
    if netcdf.STUDIED not in tree.children:
        return False
    return json.loads(group_arrays(tree[netcdf.STUDIED].dataset)[0])["format"] == STUDY_FORMAT


def study_of(tree: xr.DataTree, simulation: RightHandSide | FMU | None = None) -> StudyResult:
    """Return the study that the groups of a file hold.

    Args:
        tree: Groups from `netcdf.read`, for which `holds_study` is true.
        simulation: The simulation's function, if the model had one.

    Raises:
        InputError: A function is needed.
    """
    text, arrays = group_arrays(tree[netcdf.STUDIED].to_dataset())
    record, unpacker = json.loads(text), Unpacker(STUDY_CLASSES, arrays)
    values: dict[str, Any] = {name: unpacker.unpack(value) for name, value in record["values"].items()}
    models = {name: rebuild(each, simulation) for name, each in record["models"].items()}
    tree.attrs.pop(netcdf.STUDIED, None)
    fit = None
    if netcdf.sampled(tree):
        read = checked_of(tree, simulation)
        fit = replace(read, data=values["corrected"]) if record["same_data"] else read
        fit.memory.update(read.memory)
    values["amendments"] = {name: replace(each, corrected=lost) for name, each in values["amendments"].items()}
    add_codes(values)
    study = StudyResult(**{**values, **models, "fit": fit})
    require_kinds(study)
    return study
