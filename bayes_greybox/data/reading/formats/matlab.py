"""MATLAB files: vectors of one length, matrices whose columns are measurements, structures of such."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.reading.table import Layout, Table
from bayes_greybox.running.errors import InputError

MATLAB_REMEDY = (
    'in MATLAB, save its columns as vectors, S = table2struct(T, ToScalar=true); save("run.mat", "-struct", "S"), or '
    'write text, writetable(T, "run.csv")'
)


def read_mat(path: Path, layout: Layout) -> Table:
    """Read a MATLAB file of any version, unless it has nothing but objects (tables, timetables) or text.

    Variables of one length are a table: vectors under their names, columns of a matrix X as X_1, X_2, …, fields of a
    structure S as S.name. It is that of the longest ones of which there are two columns or more, as a time and a
    measurement; those of other lengths, such as settings, are tables beside it (see `Table.holding`).
    """
    import h5py
    import scipy.io

    if h5py.is_hdf5(path):
        # Version 7.3, which SciPy does not read.
        with h5py.File(path, "r") as file:
            content = dict(_hdf5(file))
            objects = any(item.attrs.get("MATLAB_object_decode") is not None for item in file.values())
    else:
        content = scipy.io.loadmat(path, struct_as_record=False, squeeze_me=False)
        objects = any(type(value).__name__ == "MatlabOpaque" for value in content.values())
    arrays = dict(_arrays({name: value for name, value in content.items() if not name.startswith("__")}))
    if not arrays:
        held = "tables or other objects" if objects else "no numbers in vectors or matrices"
        raise InputError(f'"{path}" holds {held}, which cannot be read: {MATLAB_REMEDY}.')
    every = {n: _table_of_length(n, arrays, path) for n in {max(values.shape) for values in arrays.values()}}
    first, *others = sorted(every, key=lambda n: (len(every[n].frame.columns) > 1, n), reverse=True)
    sizes = {name: " by ".join(str(n) for n in values.shape if n > 1) for name, values in arrays.items()}
    apart = [f"{name} ({size})" for name, size in sizes.items() if first not in arrays[name].shape]
    hint = f" Of other lengths than these are {', '.join(apart)}." if apart else ""
    return replace(every[first], others=tuple(every[n] for n in others), hint=hint)


def _table_of_length(n: int, arrays: Mapping[str, np.ndarray], path: Path) -> Table:
    columns: dict[str, np.ndarray] = {}
    groups, remarks = {}, []
    for name, values in ((name, values) for name, values in arrays.items() if n in values.shape):
        # Signals may lie along rows; a square matrix is taken as it is.
        upright = values if values.shape[0] == n else values.T
        if upright.shape[1] == 1:
            columns[name] = upright[:, 0]
            continue
        parts = {f"{name}_{i + 1}": upright[:, i] for i in range(upright.shape[1])}
        columns |= parts
        groups[name] = tuple(parts)
        remarks.append(f"the {'columns' if upright is values else 'rows'} of {name} are {', '.join(parts)}")
    return Table(pd.DataFrame(columns), f'"{path}"', remarks=tuple(remarks), groups=groups)


def _hdf5(group: Any) -> list[tuple[str, Any]]:
    """Return variables of a file of version 7.3; it stores matrices transposed, and text as letters."""
    import h5py

    variables: list[tuple[str, Any]] = []
    for name, item in group.items():
        if name.startswith("#") or item.attrs.get("MATLAB_object_decode") is not None:
            continue
        if isinstance(item, h5py.Group):
            variables.append((name, dict(_hdf5(item))))
        elif item.attrs.get("MATLAB_class") not in (b"char", b"cell", "char", "cell"):
            variables.append((name, np.asarray(item).T))
    return variables


def _arrays(content: Mapping[str, Any], prefix: str = "") -> list[tuple[str, np.ndarray]]:
    """Return numbers in vectors and matrices, those of structures under S.name."""
    arrays: list[tuple[str, np.ndarray]] = []
    for name, value in content.items():
        if isinstance(value, Mapping):
            arrays += _arrays(value, f"{prefix}{name}.")
            continue
        values = np.asarray(value)
        if values.dtype == object and values.size == 1 and hasattr(values.item(), "_fieldnames"):
            fields = {field: getattr(values.item(), field) for field in values.item()._fieldnames}
            arrays += _arrays(fields, f"{prefix}{name}.")
        elif values.dtype.kind in "biuf" and values.size > 1 and values.ndim <= 2:
            arrays.append((prefix + name, values.reshape(len(values), -1)))
    return arrays
