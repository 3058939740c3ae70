"""The file of a study: its tables, maps, free runs and equations, beside the extended model's posterior if it has one.

Everything that pages, equations and free runs need is kept to the last bit, so that a study that was read shows the
same. Rows, products and posteriors of hypotheses, on which it was weighed, are not kept.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import xarray as xr

from bayes_greybox.criticism.bands import Band
from bayes_greybox.criticism.kept.file import checked_of, save_checked
from bayes_greybox.data.trajectories import Trajectories
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
from bayes_greybox.running.errors import InputError

from .answer.amendment import Amendment, Remainder
from .answer.coefficients import Coefficients
from .answer.explained import Component, Explained
from .answer.free_runs import FreePath
from .answer.where import GapMap, GapTrace
from .decision.reasons import Reason
from .regressors.columns import Column, EvaluatedColumns
from .sensor_errors.channels import ChannelSuspect
from .study import StudyResult


def kept_amendment(amendment: Amendment) -> Amendment:
    """Return an amendment with the parts that equations, free runs and predictions need."""
    statistics, after, f = amendment.statistics, amendment.after, amendment.discrepancy
    used = {*statistics.of_kind("free"), *after.indices, *after.inner.ravel().tolist(), *(f.indices if f else ())}
    place = {index: k for k, index in enumerate(sorted(used))}

    def moved(indices: Sequence[int]) -> tuple[int, ...]:
        return tuple(place[int(index)] for index in indices)

    columns = [statistics.columns[index] for index in place]
    about = {each.name: getattr(statistics, each.name) for each in fields(EvaluatedColumns)}
    kept = EvaluatedColumns(**{**about, "columns": columns})
    inner = np.array([moved(draw.tolist()) for draw in after.inner], int).reshape(after.inner.shape)
    no_errors = {"suspects": (), "suspect_draws": np.zeros((len(after.draws), 0))}
    return replace(
        amendment,
        statistics=kept,
        after=after._replace(indices=moved(after.indices), inner=inner, **no_errors),
        discrepancy=None if f is None else replace(f, statistics=kept, indices=moved(f.indices)),
        corrected=lost,
        # A file cannot hold the code of a kind of rows of the user's own.
        rows=amendment.rows if type(amendment.rows) in ROW_KINDS.values() else None,
    )


def lost(data: Trajectories) -> Trajectories:
    """Refuse to remove errors of sensors: a file holds their sizes, not the function that does so."""
    raise InputError(
        "A study that was read from a file knows its sensors' errors, not how rows lose them: run find_missing_effects "
        "again to put other data right."
    )


STUDY_FORMAT = 2
"""Layout of the group; of a later one the fit alone is read."""

STUDY_CLASSES = (
    Amendment, Band, BoundEffect, ChannelSuspect, Coefficients, Column, Component, Effect, EvaluatedColumns, Explained,
    FreePath, GapMap, GapTrace, HiddenState, HilbertBasis, InnerParameter, Reason, Remainder, *ROW_KINDS.values(),
)  # fmt: skip
"""Classes of the values in a file."""


def save_study(study: StudyResult, path: str | os.PathLike[str], record: Mapping[str, Any]) -> None:
    """Write a study to a netCDF file, with the posterior of its extended model if there is one.

    Raises:
        InputError: The destination cannot be written.
    """
    packer = Packer(STUDY_CLASSES, leave_out=("corrected",))
    # The data first, which others refer to.
    ordered = {
        each.name: getattr(study, each.name)
        for each in fields(StudyResult)
        if each.name not in ("base", "model", "fit")
    }
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
    """Return whether the groups of a file hold a whole study, and not a fit alone.

    Raises:
        InputError: The study is in an earlier layout.
    """
    if netcdf.STUDIED not in tree.children:
        return False
    layout = json.loads(group_arrays(tree[netcdf.STUDIED].dataset)[0])["format"]
    if layout < STUDY_FORMAT:
        raise InputError(
            f"The file holds a study in layout {layout}, and this version reads layout {STUDY_FORMAT}: run the study "
            "again (find_missing_effects, or bayes-greybox discover) and save it."
        )
    return layout == STUDY_FORMAT


def study_of(tree: xr.DataTree, simulation: RightHandSide | FMU | None = None) -> StudyResult:
    """Return the study that the groups of a file hold.

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
    study = StudyResult(**{**values, **models, "fit": fit})
    require_kinds(study)
    return study
