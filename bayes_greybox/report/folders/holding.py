"""Folders of results: whose they are, so that no command overwrites those of another, and copies of configurations."""

import json
import os
import re
from pathlib import Path

from bayes_greybox.running.errors import InputError

RECORD_FILE, CONFIG = "summary.json", "config.toml"
"""Files that every command writes."""

FILES_OF = {
    "fit": ("run.nc",), "discover": ("study.nc", "gap.html"), "compare": ("comparison.html",), "fleet": ("fleet.html",),
}  # fmt: skip
"""Files that one command writes."""


def command_of(folder: Path) -> str | None:
    """Return the command whose results a folder holds; None if another command would overwrite nothing there."""
    try:
        record = json.loads((folder / RECORD_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        record = None
    if isinstance(record, dict):
        if record.get("command") in FILES_OF:
            return record["command"]
        # Records of version 0.1.0 do not name their command.
        keys = {"fit": "coefficients", "discover": "effects", "compare": "comparison"}
        return next((command for command, key in keys.items() if key in record), None)
    # A run that was stopped has no record yet.
    if not (folder / CONFIG).is_file():
        return None
    return next(
        (command for command, names in FILES_OF.items() if any((folder / name).is_file() for name in names)), None
    )


def free_folder(folder: Path, command: str) -> Path:
    """Return the folder for the results of a command, or FOLDER-COMMAND, see `require_own`, if it holds another's."""
    if command_of(folder) in (None, command):
        return folder
    folder = folder if folder.name not in ("", "..") else folder.resolve()
    other = folder.with_name(f"{folder.name}-{command}")
    require_own(other, command)
    return other


def require_own(folder: Path, command: str) -> None:
    """Refuse a folder that holds the results of another command."""
    holds = command_of(folder)
    if holds not in (None, command):
        raise InputError(
            f'"{folder}" holds results of {holds}, which those of {command} would overwrite: choose another folder '
            "with --output, or remove those results."
        )


CONFIGURATION_ATTRIBUTE = "configuration_file"
"""Root attribute of a fit that holds the text of the configuration file that asked for it."""


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
    schema = re.match(r"#:schema[^\n]*\n", text)
    at = schema.end() if schema else 0
    return text[:at] + end.join(lines) + text[at:]


def author_text(text: str) -> str:
    """Return the text of a copy without the lines that `copy_of` put above it."""
    origin = r"^(?:# A copy of [^\n]*\n)?copied_from[ \t]*=[^\n]*\n(?:asset[ \t]*=[^\n]*\n)?(?:\r?\n)?"
    return re.sub(origin, "", text, count=1, flags=re.MULTILINE)


def _path(origin: Path, folder: Path) -> str:
    """Return a relative path where both lie in one tree, which can then be moved; an absolute one elsewhere."""
    whole, home = origin.resolve(), folder.resolve()
    shared = [a for a, b in zip(whole.parts, home.parts, strict=False) if a == b]
    path = os.path.relpath(whole, home) if len(shared) > 1 else str(whole)
    return path.replace(os.sep, "/")
