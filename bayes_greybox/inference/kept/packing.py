"""Results as text and arrays, and back, for objects other than draws.

Values become JSON, with a tag for each kind that JSON lacks; arrays get names, under which the file holds them. Only
classes that the caller lists are created again, so that a file can do nothing but fill their fields.
"""

import dataclasses
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from itertools import chain, count
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.terms import Term

from .kinds import require_kinds

KIND = "~"
"""Key of a tagged value; names of columns, states and settings begin with a letter."""

TERM = ("name", "unit", "states", "sign", "prior", "fixed", "bounds", "parameter")
"""Attributes of a term that are stored beside its formula."""

MOST_INLINE_NUMBERS = 8
"""Largest array that is stored in the text."""

TEXT = "packed"
"""Attribute of a group that holds the text; the variables of the group are the arrays."""


def as_group(text: str, arrays: Mapping[str, np.ndarray]) -> xr.Dataset:
    """Return JSON text and the arrays of a `Packer` as a group of a file."""
    variables = {name: (_dimensions(each.shape), each) for name, each in arrays.items()}
    return xr.Dataset(variables, attrs={TEXT: text})


def group_arrays(group: xr.Dataset) -> tuple[str, dict[str, np.ndarray]]:
    """Return text and arrays of a group from `as_group`."""
    # Coordinates included: in older files an array with the name of another's dimension became a coordinate.
    return str(group.attrs[TEXT]), {str(name): group[name].to_numpy() for name in group.variables}


def _dimensions(shape: tuple[int, ...]) -> tuple[str, ...]:
    """Return dimensions named by size, which arrays share; equal sizes within an array are numbered."""
    alike = len(set(shape)) < len(shape)
    return tuple(f"size_{size}_{k}" if alike else f"size_{size}" for k, size in enumerate(shape))


class Packer:
    """Turns values into JSON and named arrays.

    Args:
        classes: Dataclasses and named tuples that may occur.
        leave_out: Names of fields that are not stored and get their default back.
    """

    def __init__(self, classes: Iterable[type], leave_out: Collection[str] = ()) -> None:
        self.arrays: dict[str, np.ndarray] = {}
        self._leave_out = leave_out
        self._names = {each: each.__name__ for each in classes}
        self._data: list[Trajectories] = []

    def pack(self, value: Any, place: str) -> Any:
        """Return a value in the form of JSON, the inverse of `Unpacker.unpack`.

        Values are numbers, texts, arrays, tables, data, terms, the listed classes, and tuples, lists and mappings of
        these; other classes raise TypeError. Arrays are named after their place.
        """
        if value is None or isinstance(value, bool | int | float | str):
            return value
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, np.ndarray):
            return self._array(value, place)
        if isinstance(value, pd.DataFrame):
            return self._table(value, place)
        if isinstance(value, Trajectories):
            return self._measurements(value, place)
        if isinstance(value, Term):
            attributes = {name: self.pack(getattr(value, name), place) for name in TERM}
            return {KIND: "term", "expression": value.text, **attributes}
        if type(value) in self._names:
            return {KIND: self._names[type(value)], **self._fields(value, place)}
        if isinstance(value, Mapping):
            if all(isinstance(key, str) for key in value):
                return {key: self.pack(each, f"{place}.{key}") for key, each in value.items()}
            items = enumerate(value.items())
            pairs = [[self.pack(key, place), self.pack(each, f"{place}.{k}")] for k, (key, each) in items]
            return {KIND: "pairs", "of": pairs}
        if isinstance(value, tuple | list):
            of = [self.pack(each, f"{place}.{k}") for k, each in enumerate(value)]
            return of if isinstance(value, list) else {KIND: "tuple", "of": of}
        raise TypeError(f"{type(value).__name__} at {place} is no kind of value that a file can hold.")

    def _fields(self, value: Any, place: str) -> dict[str, Any]:
        fields = getattr(value, "_fields", None) or [each.name for each in dataclasses.fields(value) if each.init]
        kept = [name for name in fields if name not in self._leave_out]
        return {name: self.pack(getattr(value, name), f"{place}.{name}") for name in kept}

    def _array(self, value: np.ndarray, place: str) -> dict[str, Any]:
        about = {"dtype": value.dtype.str, "shape": list(value.shape)}
        if value.size <= MOST_INLINE_NUMBERS:
            return {KIND: "numbers", "of": value.ravel().tolist(), **about}
        # netCDF is sure to allow letters, digits and underscores; a derivative is called d(y)/dt.
        stem = re.sub(r"\W+", "_", place).strip("_")
        names = chain([stem], (f"{stem}_{further}" for further in count(1)))
        name = next(each for each in names if each not in self.arrays)
        # It has no booleans.
        self.arrays[name] = value.astype(np.int8) if value.dtype == bool else value
        return {KIND: "array", "name": name, **about}

    def _table(self, value: pd.DataFrame, place: str) -> dict[str, Any]:
        levels = range(0 if isinstance(value.index, pd.RangeIndex) else value.index.nlevels)
        return {
            KIND: "table",
            "index": [self._column(value.index.get_level_values(k), value.index.names[k], place) for k in levels],
            "columns": [self._column(value[name], name, place) for name in value],
            "rows": len(value),
        }

    def _column(self, values: Any, name: Any, place: str) -> dict[str, Any]:
        return {"name": name, "dtype": str(values.dtype), "of": [self.pack(each, place) for each in values.tolist()]}

    def _measurements(self, value: Trajectories, place: str) -> dict[str, Any]:
        for number, known in enumerate(self._data):
            if known is value:
                return {KIND: "same data", "number": number}
        samples = self.pack(value.samples, f"{place}.samples")
        before = self.pack(value.before, f"{place}.before")
        self._data.append(value)
        frame = value.to_frame()
        columns = {str(name): self._array(frame[name].to_numpy(), f"{place}.{name}") for name in frame}
        return {KIND: "data", "columns": columns, "about": value.metadata(), "samples": samples, "before": before}


class Unpacker:
    """Turns JSON and named arrays back into values; the arguments are those of `Packer`."""

    def __init__(self, classes: Iterable[type], arrays: Mapping[str, np.ndarray]) -> None:
        self._data: list[Trajectories] = []
        self._readers: dict[str, Callable[[dict[str, Any]], Any]] = {
            "numbers": lambda value: np.array(value["of"], np.dtype(value["dtype"])).reshape(value["shape"]),
            "array": lambda value: np.asarray(arrays[value["name"]]).astype(np.dtype(value["dtype"])),
            "tuple": lambda value: tuple(self.unpack(each) for each in value["of"]),
            "pairs": lambda value: {self.unpack(key): self.unpack(each) for key, each in value["of"]},
            "term": self._term,
            "table": self._table,
            "data": self._measurements,
            "same data": lambda value: self._data[value["number"]],
            **{each.__name__: self._made(each) for each in classes},
        }

    def unpack(self, value: Any) -> Any:
        """Return the value that `Packer.pack` turned into this."""
        if isinstance(value, list):
            return [self.unpack(each) for each in value]
        if not isinstance(value, dict):
            return value
        if KIND not in value:
            return {key: self.unpack(each) for key, each in value.items()}
        return self._readers[value[KIND]](value)

    def _made(self, kind: type) -> Callable[[dict[str, Any]], Any]:
        def read(value: dict[str, Any]) -> Any:
            made = kind(**{key: self.unpack(each) for key, each in value.items() if key != KIND})
            require_kinds(made)
            return made

        return read

    def _term(self, value: dict[str, Any]) -> Term:
        # Files of earlier versions have no settings of coefficients.
        return Term(value["expression"], **{name: self.unpack(value[name]) for name in TERM if name in value})

    def _table(self, value: dict[str, Any]) -> pd.DataFrame:
        columns = {each["name"]: self._column(each) for each in value["columns"]}
        table = pd.DataFrame(columns, index=pd.RangeIndex(value["rows"]))
        levels, names = [self._column(each) for each in value["index"]], [each["name"] for each in value["index"]]
        if len(levels) > 1:
            table.index = pd.MultiIndex.from_arrays(levels, names=names)
        elif levels:
            table.index = pd.Index(levels[0], name=names[0])
        return table

    def _column(self, value: dict[str, Any]) -> pd.Series:
        return pd.Series([self.unpack(each) for each in value["of"]], dtype=value["dtype"])

    def _measurements(self, value: dict[str, Any]) -> Trajectories:
        # Files of earlier versions have no rows before.
        samples, before = self.unpack(value["samples"]), self.unpack(value.get("before"))
        table = pd.DataFrame({name: self.unpack(column) for name, column in value["columns"].items()})
        data = dataclasses.replace(Trajectories.from_frame(table, **value["about"]), samples=samples, before=before)
        self._data.append(data)
        return data
