"""Copies of configuration files beside results: the author's text, below a line that says where its paths start."""

import json
import os
import re
from pathlib import Path

CONFIGURATION_ATTRIBUTE = "configuration_file"
"""Root attribute of a fit that holds the text of the configuration file that asked for it."""

_SCHEMA = re.compile(r"\A#:schema[^\n]*\n")
_ORIGIN = re.compile(
    r"^(?:# A copy of [^\n]*\n)?copied_from[ \t]*=[^\n]*\n(?:asset[ \t]*=[^\n]*\n)?(?:\r?\n)?", re.MULTILINE
)


def copy_of(text: str, origin: Path, folder: Path, asset: Path | None = None) -> str:
    """Return a copy that can be run where it lies: its relative paths start where those of the original do.

    Every character of the author's text is kept. `asset` is a file that is read in place of the original's own data.
    """
    end = "\r\n" if "\r\n" in text else "\n"
    lines = [
        f"# A copy of {origin.name}, written by bayes-greybox. Relative paths start from the folder of this file:",
        f"copied_from = {json.dumps(_path(origin, folder), ensure_ascii=False)}",
        *([] if asset is None else [f"asset = {json.dumps(_path(asset, folder), ensure_ascii=False)}"]),
        "",
        "",
    ]
    # Editors look for a schema in the first line only.
    schema = _SCHEMA.match(text)
    at = schema.end() if schema else 0
    return text[:at] + end.join(lines) + text[at:]


def author_text(text: str) -> str:
    """Return the text of a copy without the lines that `copy_of` put above it."""
    return _ORIGIN.sub("", text, count=1)


def _path(origin: Path, folder: Path) -> str:
    """Return a relative path where both lie in one tree, which can then be moved; an absolute one elsewhere."""
    whole, home = origin.resolve(), folder.resolve()
    shared = [a for a, b in zip(whole.parts, home.parts, strict=False) if a == b]
    path = os.path.relpath(whole, home) if len(shared) > 1 else str(whole)
    return path.replace(os.sep, "/")
