"""Locks on folders, so that one process at a time writes to them.

The system holds the lock and releases it when a process ends, however it ends: no file that a dead process left can
block a living one. The file only names the owner of the lock, which packages for locks do not.
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
"""Name of the file in a locked folder."""

NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)
"""Error numbers of file systems without locks."""

log = logging.getLogger(__name__)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder that exists; on a file system without locks nothing is locked.

    Raises:
        InputError: Another process holds it, or this one already.
        OSError: The folder cannot be written to.
    """
    handle = _lock(folder)
    try:
        yield
    finally:
        # Removed under the lock, so that nobody locks a file without a name; Windows keeps files that are open.
        with suppress(OSError):
            (folder / LOCK).unlink()
        os.close(handle)


def _lock(folder: Path) -> int:
    """Take the lock, and return its open file."""
    path = folder / LOCK
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _take(handle)
            # Between opening and locking, another process may have removed the file with its own lock.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(handle), os.stat(path)):
                    os.truncate(handle, 0)
                    os.write(handle, f"{os.getpid()} on {socket.gethostname()}".encode())
                    return handle
        except OSError as error:
            if error.errno in NO_LOCKS:
                log.warning("no other process must write to %s, whose file system has no locks", folder)
                return handle
            owner = _owner(path)
            os.close(handle)
            if isinstance(error, BlockingIOError | PermissionError):
                raise InputError(
                    f'"{folder}" is being written to by another process{owner}: wait until it is done, stop it, or '
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


def _owner(path: Path) -> str:
    try:
        owner = path.read_text(encoding="utf-8").strip()
    except OSError:
        return ""
    return f" ({owner})" if owner else ""
