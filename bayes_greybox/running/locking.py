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

log = logging.getLogger(__name__)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder; InputError if it is locked already. On a file system without locks nothing is locked."""
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
            if error.errno in (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS):
                log.warning("no other process must write to %s, whose file system has no locks", folder)
                return handle
            os.close(handle)
            if not isinstance(error, BlockingIOError | PermissionError):
                raise
            owner = ""
            with suppress(OSError):
                owner = path.read_text(encoding="utf-8").strip()
            raise InputError(
                f'"{folder}" is being written to by another process{owner and f" ({owner})"}: wait until it is done, '
                "stop it, or choose another folder."
            ) from None
        os.close(handle)


def _take(handle: int) -> None:
    if fcntl is not None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return
    import msvcrt

    msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
