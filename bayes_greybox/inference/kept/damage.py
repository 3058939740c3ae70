"""Files that were damaged or changed since they were saved: one sentence that names the file and the remedy.

Texts of a file are sealed when it is written, as HDF5 sums arrays that are compressed but no attributes. Files of
earlier versions have no seals, and so may those that another program wrote anew; what is made of them is checked part
by part (see `kinds` and `draws`), and whatever still cannot be made is the file's fault.
"""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zlib import crc32

import xarray as xr

from bayes_greybox.running.errors import InputError

SEALS = "bayes_greybox_seals"
"""Root attribute with a sum of each text that the package wrote: {path of the group: {attribute: CRC-32}}."""

END = b"\nbayes_greybox crc32 "
"""What stands after the last byte of HDF5, which heeds nothing there, with the sum of all bytes before it.

HDF5 itself may never come back from an attribute of a damaged file. A program that changes a file drops its end.
"""

REMEDY = "take another copy of the file, or fit and save again"

FAULTS = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
"""What Python raises where values are not what the code that wrote them would have written."""


def damaged(path: str | os.PathLike[str], what: str) -> InputError:
    """The error for a damaged file.

    Args:
        path: The file.
        what: What is wrong, to follow a colon.
    """
    return InputError(f"{str(path)!r} is damaged, or was changed since it was saved: {what}; {REMEDY}.")


@contextmanager
def made_of(path: str | os.PathLike[str]) -> Iterator[None]:
    """Where objects are made of what a file says.

    Args:
        path: The file.

    Raises:
        InputError: With the file's name, whatever was refused, and whatever the values of the file cannot become.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{str(path)!r}: {error}") from error
    except FAULTS as error:
        what = (
            f"it lacks {error}"
            if isinstance(error, KeyError)
            else "what it says of its model or data makes no sense here, unless another version of the package wrote it"
        )
        raise damaged(path, what) from error


def put_end(path: str | os.PathLike[str]) -> None:
    """Write the sum of a file's bytes behind them.

    Args:
        path: A file that is whole.
    """
    with open(path, "r+b") as file:
        total = _sum_of_bytes(file.read())
        file.write(END + total)


def take_end(path: str | os.PathLike[str], copy: str | os.PathLike[str]) -> None:
    """Copy a file without what `put_end` wrote behind it.

    Args:
        path: The file.
        copy: Where to.
    """
    raw = Path(path).read_bytes()
    own = len(END) + 8
    Path(copy).write_bytes(raw[:-own] if raw[-own:].startswith(END) else raw)


def require_end(raw: bytes, path: str | os.PathLike[str]) -> bool:
    """Refuse a file whose bytes are not those that were written, if it says which these were.

    Args:
        raw: All of it.
        path: The file.

    Returns:
        Whether it says so.

    Raises:
        InputError: A byte was changed.
    """
    content, said = raw[: -len(END) - 8], raw[-len(END) - 8 :]
    if not said.startswith(END):
        return False
    if said.removeprefix(END) != _sum_of_bytes(content):
        raise damaged(path, "its bytes are not those that were written")
    return True


def _sum_of_bytes(content: bytes) -> bytes:
    return f"{crc32(content):08x}".encode()


def seal(tree: xr.DataTree, names: dict[str, list[str]]) -> str:
    """Sums of texts.

    Args:
        tree: Groups of a file.
        names: Attributes by path of their group.
    """
    return json.dumps({path: sums({name: tree[path].attrs[name] for name in own}) for path, own in names.items()})


def sums(texts: Mapping[str, Any]) -> dict[str, int]:
    """The sum of each text of a group.

    Args:
        texts: By attribute.
    """
    return {name: _sum(text) for name, text in texts.items()}


def require_sealed(tree: xr.DataTree, path: str | os.PathLike[str]) -> None:
    """Refuse a file whose texts are not those that were written; its seals are taken off.

    Args:
        tree: Groups of the file.
        path: The file.

    Raises:
        InputError: A text was changed.
    """
    text = tree.attrs.pop(SEALS, None)
    if text is None:
        return
    with made_of(path):
        for place, sums in dict(json.loads(text)).items():
            # Whoever leaves out a group leaves out its text.
            attributes = tree[place].attrs if place == "/" or place.strip("/") in tree.children else {}
            for name, known in sums.items():
                if name in attributes and _sum(attributes[name]) != known:
                    raise damaged(path, f"its text {name!r} is not what was written")


def _sum(text: Any) -> int:
    return crc32(str(text).encode("utf-8", "surrogatepass"))
