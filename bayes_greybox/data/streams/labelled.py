"""netCDF files and Zarr stores, a slice of their one dimension at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError

from .asked import CHUNK_ROWS, PART_ROWS, Asked
from .whole_runs import Piece, WholeRuns

INSTALL_DISTRIBUTED = 'install it with pip install ".[distributed]" in the checkout'


@dataclass(frozen=True)
class LabelledRows:
    """Variables over one dimension; a part is a range of it.

    Attributes:
        pieces: Store, dimension, first row and row behind the last of each part.
        asked: What is read of them.
    """

    pieces: tuple[tuple[str, str, int, int], ...]
    asked: Asked

    @property
    def where(self) -> str:
        """The stores."""
        stores = list(dict.fromkeys(piece[0] for piece in self.pieces))
        return f'"{stores[0]}"' + (f" and {len(stores) - 1} more" if len(stores) > 1 else "")

    @property
    def n_part(self) -> int:
        """Parts."""
        return len(self.pieces)

    @property
    def paths(self) -> list[str]:
        """The store of each part."""
        return [piece[0] for piece in self.pieces]

    def whole_runs(self) -> WholeRuns:
        """The stores with whole runs in each chunk."""
        return WholeRuns(self)

    def chunks(self, part: int) -> Iterator[Trajectories]:
        """The rows of a part, some at a time."""
        dimension = self.pieces[part][1]
        for first, piece in self._slices(part):
            kept = self.asked.usable(piece.reset_coords().to_dataframe())
            if not kept.all():
                piece = piece.isel({dimension: kept})
            if kept.any():
                yield from self.asked.formed(piece, f'"{self.paths[part]}"', first, int((~kept).sum()))

    def tables(self, part: int) -> Iterator[Piece]:
        """The rows of a part as they lie in the store, some at a time."""
        for first, piece in self._slices(part):
            # Stamps may be the dimension's own coordinate.
            frame = piece.reset_coords().to_dataframe().reset_index()[list(self.asked.columns)]
            yield Piece(first, frame, {str(name): dict(piece[name].attrs) for name in frame})

    def _slices(self, part: int) -> Iterator[tuple[int, Any]]:
        path, dimension, start, stop = self.pieces[part]
        with _opened(Path(path)) as dataset:
            lacking = [name for name in self.asked.columns if name not in dataset.variables]
            if lacking:
                raise InputError(f'"{path}" has no variable "{lacking[0]}", which other files of the stream have.')
            wanted = dataset[list(self.asked.columns)]
            for first in range(start, stop, CHUNK_ROWS):
                yield first, wanted.isel({dimension: slice(first, min(first + CHUNK_ROWS, stop))}).load()


def labelled_rows(stores: Sequence[Path], asked: Asked) -> LabelledRows:
    """The parts of some stores.

    Args:
        stores: Their paths.
        asked: What is to be read, still by the names that were given.

    Raises:
        InputError: A store that cannot be read, or has no such variable over one dimension.
    """
    pieces: list[tuple[str, str, int, int]] = []
    for path in stores:
        with _opened(path) as dataset:
            held = {str(name): array for name, array in dataset.variables.items() if array.ndim == 1}
            own = asked.among({name: array.dtype.kind for name, array in held.items()}, f'"{path}"')
            dimensions = {str(held[name].dims[0]) for name in own.columns}
            if len(dimensions) != 1:
                raise InputError(
                    f'The columns that are asked for lie along different dimensions of "{path}" '
                    f"({', '.join(sorted(dimensions))}): a stream has one row for each step of one dimension."
                )
            (dimension,) = dimensions
            n = int(dataset.sizes[dimension])
        asked = asked if pieces else own
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
        line = (str(error).strip().splitlines() or [type(error).__name__])[0].rstrip(".")
        kind = "zarr" if zarr else "nc"
        raise InputError(f'"{path}" cannot be read as {kind} ({line}); check the file.') from error
