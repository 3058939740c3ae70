"""One self-contained netCDF file: posterior, data, model, settings, versions and seed."""

import dataclasses
import importlib.metadata
import json
import os
import platform
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np
import pandas as pd
import xarray as xr

from bayes_greybox.data.columns import derivative_label
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.posterior import SLAB, Posterior
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.priors import PRIORS
from bayes_greybox.model.streams.statistics import equations_of
from bayes_greybox.physics.simulation.fmu.given import FMU
from bayes_greybox.physics.simulation.protocol import RightHandSide
from bayes_greybox.running.compiling import keep_programs
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.whole_files import whole_file

from .damage import FILE_REMEDY, SEALS, damaged, made_of, put_end, require_end, require_sealed, seal, sum_of, take_end
from .draws import require_draws
from .groups import data_table, part_details, rate_name
from .model_record import describe, rebuild
from .packing import TEXT
from .unsummed import require_readable
from .whole import STATISTICS_GROUP, whole_from, whole_group, whole_record

SAMPLES_GROUP, SAMPLES_DIMENSION = "sensor_samples", "sample_id"
"""Group of the sensors' samples, if the data are a path through them, and its dimension."""

BEFORE_GROUP, BEFORE_DIMENSION = "earlier_rows", "earlier_id"
"""Groups, numbered back in time, of earlier rows of the runs, in which hidden states start, and their dimension."""

STUDIED = "missing_effects"
"""Group of a file with the results of a study, and root attribute that holds the study's record."""

TRIED = "trial"
"""Group of a file with results of model criticism."""

RECORD_ATTRIBUTE = "bayes_greybox"
"""Root attribute that holds everything but arrays, as JSON text (netCDF attributes have no bool, None or dict)."""

FILE_FORMAT, ALL_ROWS_FORMAT = 5, 4
"""Version of the file's layout, and that of files with all their rows.

Version 5 holds some of many rows and the statistics of all, which an older reader would ignore. Version 4 has the
details of the draws in groups of their own, where an older reader would not find them. Version 3 may have outputs,
draws of exact paths, and samples that a sensor clipped. In version 1 `measure="empirical"` means what is now called
"unweighted", also on rows with correlated noise.
"""


def versions() -> dict[str, str]:
    """Return the versions of Python and the packages that produce a result."""
    packages = ("bayes-greybox", "numpyro", "jax", "arviz-base", "numpy", "xarray")
    return {"python": platform.python_version(), **{name: importlib.metadata.version(name) for name in packages}}


def save(
    posterior: Posterior, path: str | os.PathLike, attributes: Mapping[str, str] | None = None,
    groups: Mapping[str, xr.Dataset] | None = None,
) -> None:  # fmt: skip
    """Write a posterior to a netCDF file that `load_checked` and `arviz.from_netcdf` open.

    Further root attributes and groups, `STUDIED` and `TRIED`, come from the caller. InputError is raised if the
    destination cannot be written.
    """
    record = {
        "format": ALL_ROWS_FORMAT if posterior.whole is None else FILE_FORMAT,
        "model": describe(posterior.model, posterior.data),
        "sampling": dataclasses.asdict(posterior.sampling),
        "data": posterior.data.metadata(),
        "versions": versions(),
    }
    tree = posterior.idata.copy()
    if type(posterior.model.prior) not in PRIORS.values() and (slab := _slab_group(posterior)):
        tree[SLAB] = xr.DataTree(slab)
    if (samples := posterior.data.samples) is not None:
        record["samples"] = samples.metadata()
        tree[SAMPLES_GROUP] = _data_group(samples, SAMPLES_DIMENSION)
    earlier = posterior.data.before
    while earlier is not None:
        record.setdefault("before", []).append(earlier.metadata())
        tree[f"{BEFORE_GROUP}_{len(record['before'])}"] = _data_group(earlier, BEFORE_DIMENSION)
        earlier = earlier.before
    if posterior.whole is not None:
        record["all_rows"] = whole_record(posterior.whole)
        tree[STATISTICS_GROUP] = xr.DataTree(whole_group(posterior.whole))
    tree.attrs = {**posterior.idata.attrs, **(attributes or {}), RECORD_ATTRIBUTE: json.dumps(record)}
    for name, group in (groups or {}).items():
        tree[name] = xr.DataTree(group)
    write(tree, path, (RECORD_ATTRIBUTE, *(attributes or {})))


def save_unsampled(path: str | os.PathLike, attributes: Mapping[str, str], groups: Mapping[str, xr.Dataset]) -> None:
    """Write attributes and groups of a study whose extended model was not sampled; see `save`."""
    tree = xr.DataTree(children={name: xr.DataTree(group) for name, group in groups.items()})
    tree.attrs = {**attributes, RECORD_ATTRIBUTE: json.dumps({"format": ALL_ROWS_FORMAT, "versions": versions()})}
    write(tree, path, (RECORD_ATTRIBUTE, *attributes))


def write(tree: xr.DataTree, path: str | os.PathLike, texts: Sequence[str] = (RECORD_ATTRIBUTE,)) -> None:
    """Write groups to a netCDF file beside its destination, then rename it, so that no incomplete file is left.

    `texts` are the root attributes that get a check sum. InputError is raised if the destination cannot be written.
    """
    packed = {f"/{name}": [TEXT] for name, group in tree.children.items() if TEXT in group.attrs}
    tree = tree.copy()
    tree.attrs = {**tree.attrs, SEALS: seal(tree, {"/": list(texts), **packed})}
    encoding = {node.path: _compressed(node.data_vars) for node in tree.subtree if node.data_vars}
    with _written(path) as part:
        tree.to_netcdf(part, engine="h5netcdf", encoding=encoding)


def add(saved: str | os.PathLike, path: str | os.PathLike, groups: Mapping[str, xr.Dataset]) -> None:
    """Write the file that `save` would with other groups of `as_group`, copying the rest of a file of the posterior.

    InputError is raised if the destination cannot be written.
    """
    with _written(path) as part:
        take_end(saved, part)
        for name, group in groups.items():
            with h5py.File(part, "a") as file:
                file.pop(name, None)
            group.to_netcdf(part, mode="a", group=name, engine="h5netcdf", encoding=_compressed(group.data_vars))
        with h5netcdf.File(part, "a") as file:
            seals = json.loads(str(file.attrs[SEALS]))
            seals |= {
                f"/{name}": {TEXT: sum_of(each.attrs[TEXT])} for name, each in groups.items() if TEXT in each.attrs
            }
            file.attrs[SEALS] = json.dumps(seals)


def read(path: str | os.PathLike) -> xr.DataTree:
    """Read the groups of a file that `save` or `save_unsampled` wrote.

    Raises:
        InputError: The file does not exist, is no file of the package, is damaged, or a newer version wrote it.
    """
    keep_programs()
    path = Path(path)
    if not path.is_file():
        raise InputError(f"There is no file {str(path)!r}.")
    try:
        # A Python file is always closed at the end; a file that HDF5 opens may stay open after an error.
        with path.open("rb") as raw:
            if not require_end(raw.read(), path):
                require_readable(path)
            raw.seek(0)
            # Other files, and broken attributes, fail here: h5netcdf would leave a broken object behind.
            with h5py.File(raw, "r") as file:
                dict(file.attrs)
            raw.seek(0)
            # Arrays without named dimensions get some, without a warning; `require_draws` refuses them.
            with xr.open_datatree(raw, engine="h5netcdf", phony_dims="access") as opened:
                tree = opened.load()
    except InputError:
        raise
    except Exception as error:
        # Only HDF5 and its readers run here, and a damaged file may make them raise anything.
        raise InputError(
            f"{str(path)!r} is not a readable netCDF file: it is damaged or of another kind; {FILE_REMEDY}."
        ) from error
    if RECORD_ATTRIBUTE not in tree.attrs:
        raise InputError(
            f"{str(path)!r} is a netCDF file, but not a fit saved by bayes_greybox; use arviz.from_netcdf."
        )
    with made_of(path):
        version = json.loads(tree.attrs[RECORD_ATTRIBUTE])["format"]
    if type(version) is not int:
        raise damaged(path, f"{version!r} is no version of a layout")
    if version > FILE_FORMAT:
        raise InputError(
            f"{str(path)!r} was saved by a bayes_greybox that is newer than this one: upgrade with pip install "
            "--upgrade bayes-greybox."
        )
    require_sealed(tree, path)
    return tree


def sampled(tree: xr.DataTree) -> bool:
    """Return True if the groups of a file have a posterior among them."""
    return "model" in json.loads(tree.attrs[RECORD_ATTRIBUTE])


def require_sampled(tree: xr.DataTree, path: str | os.PathLike) -> None:
    """Require a posterior among the groups of a file, not a study whose model was not sampled, or raise InputError."""
    if not sampled(tree):
        raise InputError(
            f"{str(path)!r} holds a study whose extended model was not sampled (settle=False), so there is no fit in "
            "it: bg.load and bayes-greybox report show the study; sample its model with study.model.fit(study.train)."
        )


def posterior_of(tree: xr.DataTree, simulation: RightHandSide | FMU | None = None) -> Posterior:
    """Return the posterior of the groups of a file, which become its own.

    `simulation` is the function of the simulation, if the model had one; InputError is raised if it is missing.
    """
    record = json.loads(tree.attrs.pop(RECORD_ATTRIBUTE))
    for name in (STUDIED, TRIED):
        if name in tree.children:
            del tree[name]
    data, earlier = _read_data(tree["constant_data"].dataset, record["data"]), None
    if SAMPLES_GROUP in tree.children:
        data = dataclasses.replace(data, samples=_read_data(_taken(tree, SAMPLES_GROUP), record["samples"]))
    for number, metadata in reversed(list(enumerate(record.get("before", ()), 1))):
        read = _read_data(_taken(tree, f"{BEFORE_GROUP}_{number}"), metadata)
        earlier = dataclasses.replace(read, before=earlier)
    data = dataclasses.replace(data, before=earlier)
    gp = record["model"]["discrepancy"]
    correlated = any(not data.row_noise(name).local for name in record["model"]["dictionary"])
    if record["format"] < 2 and correlated and gp is not None and gp["measure"] == "empirical":
        gp["measure"] = "unweighted"
    model = rebuild(record["model"], simulation)
    if record["format"] < 4:
        part_details(tree, model.sites)
    sampling = Sampling(**record["sampling"])
    require_draws(tree, model, data)
    if "all_rows" not in record:
        return Posterior(model, data, sampling, tree)
    whole = whole_from(record["all_rows"], _taken(tree, STATISTICS_GROUP))
    # Raised here, so that statistics of another model are reported with the file's name.
    equations_of(model, data, whole)
    return Posterior(model, data, sampling, tree, whole=whole)


def _data_group(data: Trajectories, dimension: str) -> xr.DataTree:
    return xr.DataTree(xr.Dataset({name: (dimension, values) for name, values in data_table(data).items()}))


def _taken(tree: xr.DataTree, name: str) -> xr.Dataset:
    """Take a group out of a file."""
    group = tree[name].to_dataset()
    del tree[name]
    return group


def _read_data(table: xr.Dataset, metadata: Mapping[str, Any]) -> Trajectories:
    time_name = metadata["time_name"]
    for name, values in table.variables.items():
        if values.dtype.kind not in "biuf" or values.ndim != 1 or not np.all(np.isfinite(values.to_numpy())):
            raise InputError(f"the file is damaged: its column {str(name)!r} is not one of finite numbers.")
    # Older files have no outputs.
    measured = (*metadata["states"], *metadata["inputs"], *metadata.get("outputs", ()))
    names = {time_name: "t", "run": "run", **{name: name for name in measured}}
    names |= {derivative_label(s, time_name): rate_name(s, measured) for s in metadata["derivatives"]}
    frame = pd.DataFrame({column: table[name].to_numpy() for column, name in names.items()})
    return Trajectories.from_frame(frame, **metadata)


def _slab_group(posterior: Posterior) -> xr.Dataset:
    """Return scales and log odds of θ at the draws, for equations whose patterns the sampler summed over."""
    group, variables = posterior.idata["posterior"].dataset, {}
    for name, own in posterior.sites.items():
        if (slab := posterior.slab(name)) is not None:
            for variable, value in ((own.theta_sd, slab.sd), (own.log_odds, slab.log_odds)):
                variables[variable] = group[own.theta].copy(data=np.asarray(value).reshape(group[own.theta].shape))
    return xr.Dataset(variables)


def _compressed(variables: Iterable[Any]) -> dict[str, dict[str, Any]]:
    return {str(name): {"zlib": True, "complevel": 1} for name in variables}


@contextmanager
def _written(path: str | os.PathLike) -> Iterator[Path]:
    """Yield a path to write a file to, which then gets its check sum and its name; turn errors into an `InputError`."""
    try:
        with whole_file(path) as part:
            yield part
            put_end(part)
    except (OSError, RuntimeError) as error:
        # HDF5 reports a full disk in either class.
        reason = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)
        raise InputError(f"Cannot write {str(Path(path))!r}: {reason}. Choose a writable folder with room.") from error
