"""Folders that one process at a time writes to.

The system holds the lock and gives it back when a process ends, however it ends: no file that a dead process left can
block a living one. The file only says whose lock it is, which packages for locks do not tell.
"""

import errno
import logging
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import InputError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

LOCK = ".lock"
"""File in the folder, while it is locked."""

NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)
"""What file systems say that have no locks."""

log = logging.getLogger(__name__)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder; on a file system without locks nothing is held.

    Args:
        folder: The folder, which is there.

    Raises:
        InputError: Another process holds it, or this one already.
        OSError: The folder cannot be written to.
    """
    handle = _held(folder)
    try:
        yield
    finally:
        # Removed while it is held, so that nobody takes a lock on a file without a name; Windows removes none that is
        # open, and leaves it.
        with suppress(OSError):
            (folder / LOCK).unlink()
        os.close(handle)


def _held(folder: Path) -> int:
    """The open file on which the lock is."""
    path = folder / LOCK
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _take(handle)
            # Between opening and taking it another process may have removed the file with its own lock.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(handle), os.stat(path)):
                    os.truncate(handle, 0)
                    os.write(handle, f"{os.getpid()} on {socket.gethostname()}".encode())
                    return handle
        except OSError as error:
            if error.errno in NO_LOCKS:
                log.warning("no other process must write to %s, whose file system has no locks", folder)
                return handle
            said = _holder(path)
            os.close(handle)
            if isinstance(error, BlockingIOError | PermissionError):
                raise InputError(
                    f'"{folder}" is being written to by another process{said}: wait until it is done, stop it, or '
                    "choose another folder."
                ) from None
            raise
        os.close(handle)


def _take(handle: int) -> None:
    if fcntl is not None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return
    import msvcrt

    msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]


def _holder(path: Path) -> str:
    try:
        said = path.read_text(encoding="utf-8").strip()
    except OSError:
        return ""
    return f" ({said})" if said else ""
