"""The folder of a run: checked before the work, filled after it, nothing in it ever half-written."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bayes_greybox.data.errors import InputError


@contextmanager
def output_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A folder that can be written to, made where it is missing, for as long as the work for it lasts.

    If the work fails, the folders that were made for it and are still empty go again.

    Args:
        path: The folder.

    Yields:
        The folder.

    Raises:
        InputError: If it cannot be made or written to; raised before any work.
    """
    folder = Path(path)
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        _remove_empty(missing)
        raise _unwritable(folder, error) from None
    try:
        yield folder
    except BaseException:
        _remove_empty(missing)
        raise


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """A place beside the final one: files written to it move to `folder` when the block ends, or vanish.

    Args:
        folder: Where the files go, from the same file system; files of the same names are replaced.

    Yields:
        The place to write to.

    Raises:
        InputError: If a file cannot be written.
    """
    place = None
    try:
        place = Path(tempfile.mkdtemp(prefix=".part-", dir=folder))
        yield place
        for file in sorted(file for file in place.rglob("*") if file.is_file()):
            target = folder / file.relative_to(place)
            target.parent.mkdir(parents=True, exist_ok=True)
            # A rename within one file system: readers see the old file or the new one, never a part of it.
            os.replace(file, target)
    except OSError as error:
        raise _unwritable(folder, error) from error
    finally:
        if place is not None:
            shutil.rmtree(place, ignore_errors=True)


def _unwritable(folder: Path, error: OSError) -> InputError:
    reason = error.strerror or str(error)
    return InputError(f'Cannot write to the folder "{folder}" ({reason}); choose another one.')


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return
