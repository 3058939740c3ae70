"""Files that exist as a whole or not at all, whatever ends the process that writes them."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PART_PREFIX = ".part-"
"""Beginning of the names of unfinished files and folders, and of no others."""


@contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a path beside a file to write to: it is renamed when the block ends, or removed if the block fails.

    An earlier file of that name stays until then. The content is on the disk before the name is, so that even a machine
    that loses its power leaves the old file or the new one.
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
    """Rename a file that was written on the same file system to its destination, and replace any file there."""
    with part.open("rb+") as written:
        os.fsync(written.fileno())
    # A rename within one file system: readers see the old file or the new one, never a part of it.
    os.replace(part, path)
    # The name goes to the disk too, where systems allow it.
    with suppress(OSError):
        handle = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write all of a text or nothing of it, in UTF-8 and with its own line ends."""
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8", newline="")


def remove_parts(folder: Path) -> None:
    """Remove what killed processes left unfinished in a folder and in those in it; nobody may still write to it."""
    for part in [*folder.glob(f"{PART_PREFIX}*"), *folder.glob(f"*/{PART_PREFIX}*")]:
        if part.is_dir():
            shutil.rmtree(part, ignore_errors=True)
        else:
            with suppress(OSError):
                part.unlink()
