"""Files of a folder whose names can be those of assets."""

from collections.abc import Sequence
from pathlib import Path

from bayes_greybox.data.reading.sources import TABLE_READERS
from bayes_greybox.running.errors import InputError


def files_of(folder: Path) -> list[Path]:
    """List the files of a fleet's folder by name, without hidden ones and those of editors.

    Raises:
        InputError: There is no such folder, or a name cannot be printed.
    """
    if not folder.is_dir():
        raise InputError(f'There is no folder "{folder}"; a fleet is a folder with a file for each asset.')
    files = sorted(f for f in folder.resolve().iterdir() if f.is_file() and not f.name.startswith((".", "~")))
    for file in files:
        if not file.name.isprintable() or "\udc80" <= max(file.name) <= "\udcff":
            raise InputError(f"The file {file.name!r} of the fleet has a name that cannot be printed: rename it.")
    return files


def data_files(folder: Path) -> list[Path]:
    """List the files of a fleet's folder that are read as measurements.

    Raises:
        InputError: There are none; see `files_of`.
    """
    tables = [file for file in files_of(folder) if file.suffix.lower() in TABLE_READERS]
    if not tables:
        raise InputError(f'"{folder}" has no data files ({", ".join(TABLE_READERS)}); each asset of a fleet has one.')
    return tables


def require_one_each(folder: Path, names: Sequence[str]) -> None:
    """Refuse two files of a folder with one name, without endings.

    Raises:
        InputError: Two are the same, see `alike`.
    """
    twice = alike(names)
    if twice is not None:
        both = " and ".join(repr(name) for name in dict.fromkeys(twice))
        raise InputError(f'"{folder}" has two files that are called {both}: assets are called as their files are.')


def alike(names: Sequence[str]) -> tuple[str, str] | None:
    """Return two names that are one, or would be where capitals do not count: many disks have one folder for both."""
    known: dict[str, str] = {}
    for name in names:
        if name.casefold() in known:
            return known[name.casefold()], name
        known[name.casefold()] = name
    return None
