"""The assets of a fleet: the files of a folder, each with the configuration that it is studied under."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bayes_greybox.config import Config, load_config
from bayes_greybox.data.reading.sources import TABLE_READERS
from bayes_greybox.running.errors import InputError


@dataclass(frozen=True)
class Asset:
    """One machine, plant or patient: its file's name, its configuration, and data in place of that one's own."""

    name: str
    config: Path
    data: Path | None = None

    def settings(self) -> Config:
        """Return its configuration, refused if it reads no file that another one could replace."""
        settings = load_config(self.config)
        return settings if self.data is None else settings.of_asset(self.data)


def assets_of(folder: Path, config: Path | None) -> list[Asset]:
    """List the assets of a folder, by name: data files under one configuration, or configurations if that is None.

    Raises:
        InputError: There is no such folder, nothing to study in it, two files of one name, or a configuration under
            which no file can be studied.
    """
    if config is None:
        assets = [Asset(f.stem, f) for f in _files(folder) if f.suffix == ".toml"]
        if not assets:
            raise InputError(
                f'"{folder}" has no configuration files (*.toml): put one for each asset there, or give the one that '
                f"all data files are studied under: bayes-greybox discover CONFIG --fleet {folder}"
            )
    else:
        assets = [Asset(f.stem, config.resolve(), f) for f in data_files(folder)]
        # Errors in the configuration are no fault of any asset's.
        assets[0].settings().build_studied_model()
    require_one_each(folder, [asset.name for asset in assets])
    return assets


def _files(folder: Path) -> list[Path]:
    """List the files of a fleet's folder by name, without hidden ones and those of editors."""
    if not folder.is_dir():
        raise InputError(f'There is no folder "{folder}"; a fleet is a folder with a file for each asset.')
    files = sorted(f for f in folder.resolve().iterdir() if f.is_file() and not f.name.startswith((".", "~")))
    for file in files:
        if not file.name.isprintable() or "\udc80" <= max(file.name) <= "\udcff":
            raise InputError(f"The file {file.name!r} of the fleet has a name that cannot be printed: rename it.")
    return files


def data_files(folder: Path) -> list[Path]:
    """List the files of a fleet's folder that are read as measurements, of which there must be one."""
    tables = [file for file in _files(folder) if file.suffix.lower() in TABLE_READERS]
    if not tables:
        raise InputError(f'"{folder}" has no data files ({", ".join(TABLE_READERS)}); each asset of a fleet has one.')
    return tables


def require_one_each(folder: Path, names: Sequence[str]) -> None:
    """Refuse two files of a folder with one name, without endings, see `alike`."""
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
