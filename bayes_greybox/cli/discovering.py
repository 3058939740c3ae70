"""The command discover."""

from pathlib import Path

from bayes_greybox.cli.ending import DONE, NOT_CONVERGED, show
from bayes_greybox.cli.places import place_of
from bayes_greybox.cli.resuming import resumable
from bayes_greybox.config import Config
from bayes_greybox.fleet.reporting import PAGE
from bayes_greybox.fleet.study import study_into
from bayes_greybox.report.terminal.study import study_tables


def study_configured(settings: Config, output: Path | None, progress: bool, quiet: bool, resume: bool) -> int:
    """Study what the simulation of a configuration misses, and write the results to a folder."""
    folder = place_of(settings, "discover", output)
    study = study_into(
        settings,
        folder,
        progress=progress,
        found=lambda study: None if quiet else show(*study_tables(study)),
        kept=lambda folder: resumable(folder, settings, resume),
    )
    show(folder if quiet else f"\nThe report is {folder / PAGE}.")
    return DONE if study.fit is None or study.fit.verdict.mixed else NOT_CONVERGED
