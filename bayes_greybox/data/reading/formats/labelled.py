"""xarray's data sets, and netCDF files: variables over shared dimensions, with units as attributes."""

from pathlib import Path
from typing import Any

from bayes_greybox.data.reading.table import Layout, Table
from bayes_greybox.running.errors import InputError


def read_netcdf(path: Path, layout: Layout) -> Table:
    """Read a netCDF file; its stamps stay numbers. `layout` is not used.

    Raises:
        InputError: A saved fit; no variables over one dimension or two.
    """
    import h5py
    import xarray as xr

    if h5py.is_hdf5(path):
        with h5py.File(path, "r") as file:
            if "posterior" in file:
                raise InputError(f'"{path}" is a saved fit, not a table; open it with bg.load.')
    with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
        return dataset_table(dataset, f'"{path}"')


def dataset_table(dataset: Any, where: str) -> Table:
    """Return the variables of an xarray Dataset that share most of its values.

    Variables over one dimension are columns. Where the longest have two, such as run and time, the dimensions are
    columns too, one row for each pair, so that one of them can tell the runs apart.
    """
    variables = {**dict(dataset.coords), **dict(dataset.data_vars)}
    usable = {name: array for name, array in variables.items() if 1 <= array.ndim <= 2}
    if not usable:
        raise InputError(f"{where} has no variable over one or two dimensions; select such with Dataset.sel.")
    data = {name: array for name, array in dataset.data_vars.items() if name in usable} or usable
    lengths = {frozenset(array.dims): array.size for array in data.values()}
    counts = {dims: sum(dims == frozenset(array.dims) for array in data.values()) for dims in lengths}
    shared = max(counts, key=lambda dims: (counts[dims], lengths[dims]))
    names = [name for name, array in usable.items() if set(array.dims) <= shared]
    # Rows of one run together, whatever the order in which a variable has its dimensions.
    order = sorted(shared, key=lambda dim: dataset.sizes[dim])
    frame = dataset[names].reset_coords().to_dataframe(dim_order=order).reset_index()
    dimensions = tuple(str(dim) for dim in order if dataset.sizes[dim] > 1) if len(shared) > 1 else ()
    # A single dimension without stamps is only a count.
    kept = [name for name in frame.columns if name in variables or (name in shared and len(shared) > 1)]
    units = {str(name): str(array.attrs["units"]) for name, array in variables.items() if "units" in array.attrs}
    others = [str(name) for name in dataset.data_vars if name not in names]
    remarks = (f"left out of {where}, being over other dimensions: {', '.join(others)}",) if others else ()
    return Table(frame[kept].rename(columns=str), where, units, remarks=remarks, dimensions=dimensions)
