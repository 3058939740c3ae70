"""The assets of a fleet: the files of a folder, each with the configuration that it is studied under."""

from dataclasses import dataclass
from pathlib import Path

from bayes_greybox.config import Config, load_config
from bayes_greybox.running.errors import InputError

from .files import data_files, files_of, require_one_each

CONFIGURATION_SUFFIX = ".toml"
"""Ending of files that are configurations of their own."""


@dataclass(frozen=True)
class Asset:
    """One machine, plant or patient: its file's name, its configuration, and data in place of that one's own."""

    name: str
    config: Path
    data: Path | None = None

    def settings(self) -> Config:
        """Return its configuration.

        Raises:
            InputError: It cannot be read, or reads no file that another one could replace.
        """
        settings = load_config(self.config)
        return settings if self.data is None else settings.of_asset(self.data)


def assets_of(folder: Path, config: Path | None) -> list[Asset]:
    """List the assets of a folder, by name: data files under one configuration, or configurations if that is None.

    Raises:
        InputError: There is no such folder, nothing to study in it, two files of one name, or a configuration under
            which no file can be studied.
    """
    if config is None:
        assets = [Asset(f.stem, f) for f in files_of(folder) if f.suffix == CONFIGURATION_SUFFIX]
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
