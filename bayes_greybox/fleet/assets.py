"""The assets of a fleet: the files of a folder, each with the configuration that it is studied under."""

from dataclasses import dataclass
from pathlib import Path

from bayes_greybox.config import Config, load_config
from bayes_greybox.data.errors import InputError
from bayes_greybox.data.reading.sources import READERS

CONFIGURATION = ".toml"
"""Ending of files that are configurations of their own."""


@dataclass(frozen=True)
class Asset:
    """One machine, plant or patient.

    Attributes:
        name: Its file's, without the ending.
        config: Path of the configuration.
        data: File that is read in place of the configuration's own; None where it has its own.
    """

    name: str
    config: Path
    data: Path | None = None

    def settings(self) -> Config:
        """Its configuration.

        Raises:
            InputError: It cannot be read, or reads no file that another one could stand for.
        """
        settings = load_config(self.config)
        return settings if self.data is None else settings.of_asset(self.data)


def assets_of(folder: Path, config: Path | None) -> list[Asset]:
    """The assets of a folder, by name.

    Args:
        folder: Of data files, all studied under one configuration, or of configurations; other files are passed over.
        config: The configuration of data files; None: every asset has its own.

    Raises:
        InputError: There is no such folder, nothing to study in it, two files of one name, or a configuration that no
            file can be studied under.
    """
    if not folder.is_dir():
        raise InputError(f'There is no folder "{folder}"; a fleet is a folder with a file for each asset.')
    files = sorted(f for f in folder.resolve().iterdir() if f.is_file() and not f.name.startswith((".", "~")))
    for file in files:
        if not file.name.isprintable() or "\udc80" <= max(file.name) <= "\udcff":
            raise InputError(f"The file {file.name!r} of the fleet has a name that cannot be printed: rename it.")
    own = [f for f in files if f.suffix == CONFIGURATION]
    if config is None:
        assets = [Asset(f.stem, f) for f in own]
        if not assets:
            raise InputError(
                f'"{folder}" has no configuration files (*.toml): put one for each asset there, or give the one that '
                f"all data files are studied under: bayes-greybox discover CONFIG --fleet {folder}"
            )
    else:
        assets = [Asset(f.stem, config.resolve(), f) for f in files if f.suffix.lower() in READERS]
        if not assets:
            raise InputError(f'"{folder}" has no data files ({", ".join(READERS)}); each asset of a fleet has one.')
        # What is wrong with the configuration is no fault of any asset's.
        assets[0].settings().build_studied_model()
    names = [asset.name for asset in assets]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f'"{folder}" has two files that are called {twice!r}: assets are called as their files are.')
    return assets
