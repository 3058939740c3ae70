"""The folder of a run: checked before the work, filled after it, nothing in it ever half-written."""

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.locking import locked
from bayes_greybox.running.whole_files import PART_PREFIX, put, remove_parts

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Numbers of errors that more room would mend."""


@contextmanager
def output_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a folder that can be written to, made where it is missing, and locked while the work for it lasts.

    What a killed process left half-written is removed. If the work fails, the folders that were made for it and are
    still empty go again.

    Raises:
        InputError: If it cannot be made or written to, has no room, or another process writes to it; raised before
            any work.
    """
    folder = Path(path)
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    with ExitStack() as held:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            held.enter_context(locked(folder))
            remove_parts(folder)
            with tempfile.TemporaryFile(dir=folder, prefix=PART_PREFIX) as trial:
                # About what a fit and its figures take: a disk must have room for it before hours of work.
                trial.write(bytes(4_000_000))
                trial.flush()
                os.fsync(trial.fileno())
        except OSError as error:
            held.close()
            _remove_empty(missing)
            raise _unwritable(folder, error) from None
        try:
            yield folder
        except BaseException:
            held.close()
            _remove_empty(missing)
            raise


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """Yield a place beside the final one, whose files replace those in `folder` when the block ends, or vanish.

    Raises:
        InputError: If a file cannot be written.
    """
    place = None
    try:
        place = Path(tempfile.mkdtemp(prefix=PART_PREFIX, dir=folder))
        yield place
        for file in sorted(file for file in place.rglob("*") if file.is_file()):
            target = folder / file.relative_to(place)
            target.parent.mkdir(parents=True, exist_ok=True)
            put(file, target)
    except OSError as error:
        raise _unwritable(folder, error) from error
    except InputError as error:
        # Of what was to be written to the place, whose name nobody knows.
        if isinstance(error.__cause__, OSError | RuntimeError):
            raise _unwritable(folder, error.__cause__) from error
        raise
    finally:
        if place is not None:
            shutil.rmtree(place, ignore_errors=True)


def _unwritable(folder: Path, error: Exception) -> InputError:
    number = getattr(error, "errno", None)
    # HDF5 puts pages of its own behind the number.
    reason = os.strerror(number) if number else str(error)
    remedy = "make room, or choose another one" if number in FULL else "choose another one"
    return InputError(f'Cannot write to the folder "{folder}" ({reason}); {remedy}.')


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return
