"""An oscillator measured row by row, in memory, in files and in chunks, for tests of streams."""

import os
import signal

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import bayes_greybox as bg
from bayes_greybox.data.streams.row_stream import RowStream

NAMES = {"states": ["y", "ydot"], "derivatives": {"ydot": "a"}, "time": "t"}


def frame(n=3000, seed=0):
    """Rows of y″ = −y³ − 0.2 ẏ³ + noise, and a column that nobody asks for."""
    rng = np.random.default_rng(seed)
    y, v = rng.uniform(-1, 1, n), rng.uniform(-0.7, 0.7, n)
    a = -(y**3) - 0.2 * v**3 + 0.01 * rng.standard_normal(n)
    return pd.DataFrame({"t": np.arange(n) * 1e-3, "y": y, "ydot": v, "other": y + v, "a": a})


def written(folder, kind, table, units, group=300, name="rows"):
    """A file of rows: Parquet in groups, or netCDF or Zarr with units and something of another length."""
    path = folder / f"{name}.{kind}"
    if kind == "parquet":
        table.to_parquet(path, row_group_size=group)
        return path
    dataset = xr.Dataset({n: ("row", table[n].to_numpy(), {"units": units[n]} if n in units else {}) for n in table})
    dataset["elsewhere"] = ("elsewhere_row", np.zeros(3))
    if kind == "nc":
        dataset.to_netcdf(path, engine="h5netcdf")
    else:
        pytest.importorskip("zarr")
        dataset.to_zarr(path, consolidated=False)
    return path


def model(**further):
    """The oscillator's own terms and two that are not in it."""
    return bg.GreyBox(dictionary={"ydot": ["y", "ydot", "y**3", "ydot**3"]}, **further)


def chunk(i):
    """One of ten chunks, from a function that a worker finds."""
    return bg.read(frame(2000, seed=i), **NAMES)


def deadly_chunk(mark, home, i):
    """That chunk; the process that is first to ask for the sixth is killed and leaves a mark, unless it is the home."""
    if i == 5 and os.getpid() != home:
        try:
            mark.open("x").close()
        except FileExistsError:
            return chunk(i)
        os.kill(os.getpid(), signal.SIGKILL)
    return chunk(i)


def chunks(**further):
    """Twenty thousand rows in chunks."""
    return RowStream.from_chunks(chunk, 10, **further)


def together():
    """The same rows in memory."""
    return bg.read([frame(2000, seed=i) for i in range(10)], **NAMES)
