"""The command discover, on one configuration or on a folder of assets."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayes_greybox.config import Config
from bayes_greybox.fleet.assets import assets_of
from bayes_greybox.fleet.reporting import STUDY_PAGE
from bayes_greybox.fleet.run import study_fleet, study_into
from bayes_greybox.fleet.together import FLEET_PAGE
from bayes_greybox.report.folders.holding import free_folder, require_own
from bayes_greybox.report.terminal.study import fleet_tables, study_tables
from bayes_greybox.running.errors import InputError

from .ending import BAD_INPUT, DONE, NOT_CONVERGED, show
from .folders import Run, place_of, resumable


def study_configured(settings: Config, run: Run) -> int:
    """Study what the simulation of a configuration misses, and write the results to a folder."""
    folder = place_of(settings, "discover", run.output)
    study = study_into(
        settings, folder, progress=run.progress,
        on_study=lambda study: None if run.quiet else show(*study_tables(study)),
        checkpoint_for=lambda folder: resumable(folder, settings, run.resume),
    )  # fmt: skip
    show(folder if run.quiet else f"\nThe report is {folder / STUDY_PAGE}.")
    return DONE if study.fit is None or study.fit.verdict.mixed else NOT_CONVERGED


def study_folder(
    config: Path | None, folder: Path, sampling: Mapping[str, int | None], tasks: Mapping[str, Any], run: Run
) -> int:
    """Study every asset of a folder, and write their common results; `tasks` says on how many workers, or where."""
    if run.output is not None:
        require_own(run.output, "fleet")
        place = run.output
    else:
        place = Path("runs") / (folder.resolve().name or "fleet")
        place = place.with_name(f"{place.name}-fleet") if place.resolve() == folder.resolve() else place
        place = free_folder(place, "fleet")
    if place.resolve() == folder.resolve():
        raise InputError(f'Results in "{place}" would lie among the files of the fleet: choose another --output.')
    assets = assets_of(folder, config)
    fleet = study_fleet(assets, place, sampling, **tasks, progress=run.progress)
    if not run.quiet:
        show(*fleet_tables(fleet))
    show(place if run.quiet else f"\nThe report is {place / FLEET_PAGE}.")
    if not fleet.studied:
        return BAD_INPUT
    return DONE if fleet.converged else NOT_CONVERGED
