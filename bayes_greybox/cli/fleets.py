"""The command discover on a folder of assets."""

from collections.abc import Mapping
from pathlib import Path

from bayes_greybox.cli.ending import BAD_INPUT, DONE, NOT_CONVERGED, show
from bayes_greybox.fleet.assets import assets_of
from bayes_greybox.fleet.run import study_fleet
from bayes_greybox.fleet.together import FLEET_PAGE
from bayes_greybox.report.folders.holding import free_folder, require_own
from bayes_greybox.report.terminal.fleet import fleet_tables
from bayes_greybox.running.errors import InputError


def study_folder(
    config: Path | None, folder: Path, output: Path | None, sampling: Mapping[str, int | None],
    workers: int | None, scheduler: str | None, progress: bool, quiet: bool,
) -> int:  # fmt: skip
    """Study every asset of a folder, and write what they say together."""
    place = Path("runs") / (folder.resolve().name or "fleet")
    if output is not None:
        require_own(output, "fleet")
        place = output
    elif place.resolve() == folder.resolve():
        place = place.with_name(f"{place.name}-fleet")
    place = free_folder(place, "fleet") if output is None else place
    if place.resolve() == folder.resolve():
        raise InputError(f'Results in "{place}" would lie among the files of the fleet: choose another --output.')
    assets = assets_of(folder, config)
    fleet = study_fleet(assets, place, sampling, workers=workers, scheduler=scheduler, progress=progress)
    if not quiet:
        show(*fleet_tables(fleet))
    show(place if quiet else f"\nThe report is {place / FLEET_PAGE}.")
    if not fleet.studied:
        return BAD_INPUT
    return DONE if fleet.converged else NOT_CONVERGED
