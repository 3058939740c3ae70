"""Statistics of all rows of a stream, in the file of a fit that holds only some of the rows."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from bayes_greybox.model.streams.statistics import RowStatistics
from bayes_greybox.running.errors import InputError

STATISTICS_GROUP = "row_statistics"
"""Group of a file with the triangular factors of all rows."""


def whole_record(whole: Mapping[str, RowStatistics]) -> dict[str, dict[str, Any]]:
    """Return the plain values of statistics by equation."""
    return {
        name: {
            **{field: getattr(each, field) for field in ("n_row", "n_white", "log_det", "target_scale", "noise_floor")},
            "ends": {column: ends.tolist() for column, ends in each.ends.items()},
        }
        for name, each in whole.items()
    }


def whole_group(whole: Mapping[str, RowStatistics]) -> xr.Dataset:
    """Return the arrays of statistics by equation."""
    arrays = {}
    for name, each in whole.items():
        for kind, factor in {"factor": each.factor, "plain": each.plain}.items():
            if factor is not None:
                arrays[f"{name}_{kind}"] = ((f"{name}_row", f"{name}_column"), np.ascontiguousarray(factor))
        arrays[f"{name}_term_scale"] = ((f"{name}_term",), each.term_scale)
    return xr.Dataset(arrays)


def whole_from(record: Mapping[str, Mapping[str, Any]], group: xr.Dataset) -> dict[str, RowStatistics]:
    """Return the statistics of a `whole_record` and a `whole_group`; raise InputError if no rows can have them."""
    statistics = {}
    for name, plain in record.items():
        factor, term_scale = (group[f"{name}_{what}"].to_numpy().astype(float) for what in ("factor", "term_scale"))
        ends = {column: np.array(both, float) for column, both in plain["ends"].items()}
        without = group[f"{name}_plain"].to_numpy().astype(float) if f"{name}_plain" in group else None
        # Files from before rows of paths were streamed have rates only.
        n_row, n_white, log_det = plain["n_row"], plain.get("n_white", plain["n_row"]), float(plain.get("log_det", 0.0))
        scales = (float(plain["target_scale"]), float(plain["noise_floor"]))
        numbers = np.concatenate([factor.ravel(), term_scale, [log_det], *ends.values()])
        counts = all(type(n) is int and n > 0 for n in (n_row, n_white))
        whole = counts and min(scales) > 0 and all(len(both) == 2 for both in ends.values())
        if not (whole and np.all(np.isfinite(numbers)) and np.all(term_scale > 0)):
            raise InputError(f"the file is damaged: its statistics of {name!r} are those of no rows.")
        statistics[name] = RowStatistics(n_row, ends, term_scale, *scales, factor, n_white, log_det, without)
    return statistics
