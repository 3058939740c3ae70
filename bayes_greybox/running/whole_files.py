"""Files that are whole or not there, whatever ends the process that writes them."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PART_PREFIX = ".part-"
"""How names begin of what is not whole yet, and of nothing else."""


@contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A place beside a file to write it to: it is renamed when the block ends, or vanishes if that fails.

    What was in a file of that name stays until then. The content is on the disk before the name is, so that a machine
    that loses its power leaves the old file or the new one too.

    Args:
        path: The file.

    Yields:
        A path in the same folder where nothing is yet.

    Raises:
        OSError: The file cannot be written.
    """
    path = Path(path)
    part = path.with_name(f"{PART_PREFIX}{secrets.token_hex(8)}")
    try:
        yield part
        put(part, path)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def put(part: Path, path: Path) -> None:
    """Give a file that was written beside its destination its name.

    Args:
        part: The file, on the same file system.
        path: Its destination; a file that is there is replaced.

    Raises:
        OSError: It cannot be.
    """
    with part.open("rb+") as written:
        os.fsync(written.fileno())
    # A rename within one file system: readers see the old file or the new one, never a part of it.
    os.replace(part, path)
    _sync_folder(path.parent)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write all of a text or nothing of it, in UTF-8 and with the ends of lines that it has.

    Args:
        path: The file.
        text: Its content.

    Raises:
        OSError: The file cannot be written.
    """
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8", newline="")


def remove_parts(folder: Path) -> None:
    """Remove what killed processes left in a folder and in the folders in it, none of which is being written to.

    Args:
        folder: The folder.
    """
    for pattern in (f"{PART_PREFIX}*", f"*/{PART_PREFIX}*"):
        for left in list(folder.glob(pattern)):
            if left.is_dir():
                shutil.rmtree(left, ignore_errors=True)
            else:
                with suppress(OSError):
                    left.unlink()


def _sync_folder(folder: Path) -> None:
    """Have the name on the disk too, where systems let one ask for that."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
