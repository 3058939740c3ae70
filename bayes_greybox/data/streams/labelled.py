"""netCDF files and Zarr stores, a slice of their one dimension at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayes_greybox.data.reading.table import first_line
from bayes_greybox.running.errors import InputError

from .asked import CHUNK_ROWS, PART_ROWS, Asked
from .whole_runs import FileRows, Piece

INSTALL_DISTRIBUTED = 'install it with pip install ".[distributed]" in the checkout'


@dataclass(frozen=True)
class LabelledRows(FileRows):
    """Variables over one dimension; a part is a store, the dimension, its first row and the row behind its last."""

    pieces: tuple[tuple[str, str, int, int], ...]
    asked: Asked

    def tables(self, part: int) -> Iterator[Piece]:
        """Yield the rows of a part as they lie in the store, some at a time."""
        path, dimension, start, stop = self.pieces[part]
        columns = list(self.asked.columns)
        with _opened(Path(path)) as dataset:
            lacking = [name for name in columns if name not in dataset.variables]
            if lacking:
                raise InputError(f'"{path}" has no variable "{lacking[0]}", which other files of the stream have.')
            for first in range(start, stop, CHUNK_ROWS):
                some = dataset[columns].isel({dimension: slice(first, min(first + CHUNK_ROWS, stop))}).load()
                # Stamps may be the dimension's own coordinate.
                frame = some.reset_coords().to_dataframe().reset_index()[columns]
                yield Piece(first, frame, {str(name): dict(some[name].attrs) for name in frame})


def labelled_rows(stores: Sequence[Path], asked: Asked) -> LabelledRows:
    """Divide stores into parts; `asked` still has the names that the user gave.

    Raises:
        InputError: A store that cannot be read, or has no such variable over one dimension.
    """
    pieces: list[tuple[str, str, int, int]] = []
    for path in stores:
        with _opened(path) as dataset:
            variables = {str(name): array for name, array in dataset.variables.items() if array.ndim == 1}
            here = asked.among({name: array.dtype.kind for name, array in variables.items()}, f'"{path}"')
            dimensions = {str(variables[name].dims[0]) for name in here.columns}
            if len(dimensions) != 1:
                raise InputError(
                    f'The columns that are asked for lie along different dimensions of "{path}" '
                    f"({', '.join(sorted(dimensions))}): a stream has one row for each step of one dimension."
                )
            (dimension,) = dimensions
            n = int(dataset.sizes[dimension])
        asked = asked if pieces else here
        pieces += [(str(path), dimension, start, min(start + PART_ROWS, n)) for start in range(0, n, PART_ROWS)]
    if not pieces:
        raise InputError(f'"{stores[0]}" has no rows.')
    return LabelledRows(tuple(pieces), asked)


def _opened(path: Path) -> Any:
    import xarray as xr

    if not path.exists():
        raise InputError(f'There is no file "{path}".')
    zarr = path.suffix.lower() == ".zarr"
    try:
        if zarr:
            # Without Dask, which would make a task of each of its chunks.
            return xr.open_zarr(path, chunks=None, consolidated=False, decode_times=False)
        return xr.open_dataset(path, engine="h5netcdf", decode_times=False, cache=False)
    except ImportError as error:
        raise InputError(f'Reading "{path}" needs zarr; {INSTALL_DISTRIBUTED}.') from error
    except Exception as error:
        kind = "zarr" if zarr else "nc"
        raise InputError(f'"{path}" cannot be read as {kind} ({first_line(error)}); check the file.') from error
