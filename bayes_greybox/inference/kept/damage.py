"""Files that were damaged or changed since they were saved: one sentence that names the file and the remedy.

The texts of a file get check sums when it is written, because HDF5 has check sums of compressed arrays but not of
attributes. Files of earlier versions, and those that another program wrote, may have none. Objects read from them are
checked part by part (see `kinds` and `draws`), and any further failure is blamed on the file.
"""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zlib import crc32

import xarray as xr

from bayes_greybox.running.errors import InputError

SEALS = "bayes_greybox_seals"
"""Root attribute with the check sum of each text: {path of the group: {attribute: CRC-32}}."""

SUM_MARK = b"\nbayes_greybox crc32 "
"""Mark behind the last byte of HDF5, which ignores it, followed by the check sum of all bytes before.

HDF5 itself may hang on an attribute of a damaged file. A program that changes a file drops the mark.
"""

SUM_BYTES = len(SUM_MARK) + 8
FILE_REMEDY = "take another copy of the file, or fit and save again"

FAULTS = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""Exceptions that Python raises for values that the package would not have written."""


def damaged(path: str | os.PathLike[str], what: str) -> InputError:
    """Return the error for a damaged file; `what` is wrong with it, and follows a colon."""
    return InputError(f"{str(path)!r} is damaged, or was changed since it was saved: {what}; {FILE_REMEDY}.")


@contextmanager
def made_of(path: str | os.PathLike[str]) -> Iterator[None]:
    """Raise an InputError with the name of the file if no objects can be made from its values."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{str(path)!r}: {error}") from error
    except KeyError as error:
        raise damaged(path, f"it lacks {error}") from error
    except FAULTS as error:
        what = "what it says of its model or data makes no sense here, unless another version of the package wrote it"
        raise damaged(path, what) from error


def put_end(path: str | os.PathLike[str]) -> None:
    """Append the check sum of a complete file."""
    with open(path, "r+b") as file:
        file.write(SUM_MARK + _sum_of_bytes(file.read()))


def take_end(path: str | os.PathLike[str], copy: str | os.PathLike[str]) -> None:
    """Copy a file without the check sum that `put_end` appended."""
    raw = Path(path).read_bytes()
    Path(copy).write_bytes(raw[:-SUM_BYTES] if raw[-SUM_BYTES:].startswith(SUM_MARK) else raw)


def require_end(raw: bytes, path: str | os.PathLike[str]) -> bool:
    """Return True if the bytes of a file end with their check sum, False without one; raise InputError for another."""
    content, end = raw[:-SUM_BYTES], raw[-SUM_BYTES:]
    if not end.startswith(SUM_MARK):
        return False
    if end.removeprefix(SUM_MARK) != _sum_of_bytes(content):
        raise damaged(path, "its bytes are not those that were written")
    return True


def _sum_of_bytes(content: bytes) -> bytes:
    return f"{crc32(content):08x}".encode()


def seal(tree: xr.DataTree, names: dict[str, list[str]]) -> str:
    """Return the check sums of some attributes, given by path of their group, as JSON."""
    return json.dumps({path: {name: sum_of(tree[path].attrs[name]) for name in group} for path, group in names.items()})


def require_sealed(tree: xr.DataTree, path: str | os.PathLike[str]) -> None:
    """Compare the texts of a file with their check sums, and remove these; raise InputError if a text was changed."""
    text = tree.attrs.pop(SEALS, None)
    if text is None:
        return
    with made_of(path):
        for place, sums in dict(json.loads(text)).items():
            # A group may have been left out on purpose, with its text.
            attributes = tree[place].attrs if place == "/" or place.strip("/") in tree.children else {}
            for name, known in sums.items():
                if name in attributes and sum_of(attributes[name]) != known:
                    raise damaged(path, f"its text {name!r} is not what was written")


def sum_of(text: Any) -> int:
    """Return the check sum of a text."""
    return crc32(str(text).encode("utf-8", "surrogatepass"))
