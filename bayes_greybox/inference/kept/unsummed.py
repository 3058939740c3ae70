"""Files without the sum of their bytes, which earlier versions or other programs wrote.

HDF5 may never come back from what is damaged, or take the process with it. So another process reads all of such a file
first, and one that does not finish is refused.
"""

import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np

from .damage import damaged

PATIENCE = 30.0
"""Seconds that starting and reading may take, beside those that the file's size allows."""

SLOWEST = 2e6
"""Bytes a second that the slowest disk gives."""

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
"""What the other process runs; what it cannot read the reader of the file will say."""


def require_readable(path: str | os.PathLike[str], patience: float = PATIENCE) -> None:
    """Refuse a file that HDF5 does not come back from.

    Args:
        path: The file.
        patience: Seconds to wait.

    Raises:
        InputError: Reading does not end, or ends the process that reads.
    """
    # -I: whatever lies in the working folder is not imported.
    folders = dict.fromkeys(str(Path(str(package.__file__)).parents[1]) for package in (h5py, np))
    command = [sys.executable, "-I", "-c", READER, os.fspath(path), *folders]
    limit = patience + os.path.getsize(path) / SLOWEST
    try:
        done = subprocess.run(command, timeout=limit, capture_output=True, check=False)
    except subprocess.TimeoutExpired:
        raise damaged(path, f"HDF5 did not finish reading it in {limit:.0f} s") from None
    except OSError:
        # Inside another program there may be no Python to start: then nobody reads first.
        return
    # An exception of Python's ends with 1, and the reader of the file says what it is.
    if done.returncode not in (0, 1):
        raise damaged(path, "HDF5 cannot read it")
