"""Files without a check sum, which earlier versions or other programs wrote.

HDF5 may hang on a damaged file, or crash the process. So another process reads all of such a file first, and a file
that it does not finish is refused.
"""

import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np

from .damage import damaged

PATIENCE, SLOWEST_DISK = 30.0, 2e6
"""Seconds that reading may take, in addition to those for the size of the file; bytes a second of the slowest disk."""

READER = """
import sys
sys.path[:0] = sys.argv[2:]
import h5py

def read(name, item):
    dict(item.attrs)
    if isinstance(item, h5py.Dataset):
        item[()]

with h5py.File(sys.argv[1], "r") as file:
    dict(file.attrs)
    file.visititems(read)
"""
"""Program of the other process; exceptions are left to the reader of the file."""


def require_readable(path: str | os.PathLike[str], patience: float = PATIENCE) -> None:
    """Raise InputError for a file on which HDF5 hangs for `patience` seconds, or crashes."""
    # -I: nothing is imported from the working folder.
    folders = dict.fromkeys(str(Path(str(package.__file__)).parents[1]) for package in (h5py, np))
    command = [sys.executable, "-I", "-c", READER, os.fspath(path), *folders]
    limit = patience + os.path.getsize(path) / SLOWEST_DISK
    try:
        done = subprocess.run(command, timeout=limit, capture_output=True, check=False)
    except subprocess.TimeoutExpired:
        raise damaged(path, f"HDF5 did not finish reading it in {limit:.0f} s") from None
    except OSError:
        # Inside another program there may be no Python to start.
        return
    # A Python exception ends with 1, and the reader of the file will report it.
    if done.returncode not in (0, 1):
        raise damaged(path, "HDF5 cannot read it")
