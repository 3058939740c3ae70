"""A study's files in a folder: its record, its page and its figures."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayes_greybox.missing_effects import Study
from bayes_greybox.report.folders.holding import RECORD
from bayes_greybox.report.folders.record import write_json
from bayes_greybox.report.folders.writing import staged
from bayes_greybox.running.stages import stage

STUDY, PAGE = "study.nc", "gap.html"
"""Names of a study's file and of its page."""


def report_into(folder: Path, study: Study, record: Mapping[str, Any], figures: bool) -> None:
    """Write a study's record and page to a folder, and its figures where they are wanted.

    Args:
        folder: The folder.
        study: The study.
        record: What summary.json is to say.
        figures: Whether to draw.

    Raises:
        InputError: A file cannot be written.
    """
    with stage("Writing the report"), staged(folder) as part:
        # Imported here because it is slow, and the verdict does not wait for it.
        from bayes_greybox.report.pages.study_page import study_html

        write_json(part / RECORD, {"command": "discover", **record})
        study_html(study, part / PAGE)
    if figures:
        with stage("Drawing"):
            from bayes_greybox.report.plots import save_figures, study_figures

            save_figures(study_figures(study), folder / "figures")
