"""Commands and the folders of their results, so that none overwrites those of another."""

import json
from pathlib import Path

from bayes_greybox.running.errors import InputError

RECORD_FILE, CONFIG = "summary.json", "config.toml"
"""Files that every command writes."""

FILES_OF = {
    "fit": ("run.nc",), "discover": ("study.nc", "gap.html"), "compare": ("comparison.html",), "fleet": ("fleet.html",),
}  # fmt: skip
"""Files that one command writes."""

KEY_OF = {"fit": "coefficients", "discover": "effects", "compare": "comparison"}
"""Key of the record that one command alone has; records of version 0.1.0 do not name it."""


def command_of(folder: Path) -> str | None:
    """Return the command whose results a folder, which need not exist, holds; None where another overwrites nothing."""
    try:
        record = json.loads((folder / RECORD_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        record = None
    if isinstance(record, dict):
        if record.get("command") in FILES_OF:
            return record["command"]
        return next((command for command, key in KEY_OF.items() if key in record), None)
    # A run that was stopped has no record yet.
    if not (folder / CONFIG).is_file():
        return None
    return next(
        (command for command, names in FILES_OF.items() if any((folder / name).is_file() for name in names)), None
    )


def free_folder(folder: Path, command: str) -> Path:
    """Return the folder for the results of a command, or FOLDER-COMMAND if it holds those of another command.

    Raises:
        InputError: FOLDER-COMMAND holds another command's results, too.
    """
    if command_of(folder) in (None, command):
        return folder
    folder = folder if folder.name not in ("", "..") else folder.resolve()
    other = folder.with_name(f"{folder.name}-{command}")
    require_own(other, command)
    return other


def require_own(folder: Path, command: str) -> None:
    """Refuse a folder that holds the results of another command.

    Raises:
        InputError: It holds those of another command.
    """
    holds = command_of(folder)
    if holds not in (None, command):
        raise InputError(
            f'"{folder}" holds results of {holds}, which those of {command} would overwrite: choose another folder '
            "with --output, or remove those results."
        )
