"""The command discover."""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from bayes_greybox.cli.ending import DONE, NOT_CONVERGED, show
from bayes_greybox.cli.places import place_of
from bayes_greybox.cli.resuming import resumable
from bayes_greybox.config import Config
from bayes_greybox.missing_effects import find_missing_effects
from bayes_greybox.report.folders.record import study_record, write_json
from bayes_greybox.report.folders.writing import output_folder, staged
from bayes_greybox.report.terminal.study import study_tables
from bayes_greybox.running.stages import stage, stages


def study_configured(settings: Config, output: Path | None, progress: bool, quiet: bool, resume: bool) -> int:
    """Study what the simulation of a configuration misses, and write the results to a folder."""
    with ExitStack() as work:
        with stages(progress):
            with stage("Starting", said=False):
                folder = work.enter_context(output_folder(place_of(settings, "discover", output)))
                arguments = settings.study_arguments()
                model = settings.build_studied_model()
                train, test = settings.read_data()
                checkpoint = work.enter_context(resumable(folder, settings, resume))
            study = find_missing_effects(model, train, test, **arguments, progress=progress, checkpoint=checkpoint)
            study = replace(study, config=settings.text)
            with stage("Saving the study"), staged(folder) as place:
                # First, by itself: nothing that fails later may cost what was sampled.
                study.save(place / "study.nc")
                settings.copy_to(folder, place)
        if not quiet:
            show(*study_tables(study))
        with stages(progress):
            with stage("Writing the report"), staged(folder) as place:
                # Imported here because it is slow, and the verdict does not wait for it.
                from bayes_greybox.report.pages.study_page import study_html

                record = study_record(study, settings.sampling.model_dump())
                write_json(place / "summary.json", {"command": "discover", "config": settings.file, **record})
                study_html(study, place / "gap.html")
            if settings.output.figures:
                with stage("Drawing"):
                    from bayes_greybox.report.plots import save_figures, study_figures

                    save_figures(study_figures(study), folder / "figures")
        checkpoint.complete()
    show(folder if quiet else f"\nThe report is {folder / 'gap.html'}.")
    return DONE if study.fit is None or study.fit.verdict.ok else NOT_CONVERGED
