"""The study of one configuration, with its results in a folder."""

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from pathlib import Path

from bayes_greybox.config import Config
from bayes_greybox.inference.checkpoint import Checkpoint
from bayes_greybox.missing_effects import Study, find_missing_effects
from bayes_greybox.report.folders.study_record import study_record
from bayes_greybox.report.folders.writing import output_folder, staged
from bayes_greybox.running.stages import stage, stages

from .reporting import STUDY, report_into


def study_into(
    settings: Config,
    place: Path,
    *,
    progress: bool = True,
    on_study: Callable[[Study], None] = lambda _: None,
    checkpoint_for: Callable[[Path], AbstractContextManager[Checkpoint]] | None = None,
) -> Study:
    """Study what the simulation of a configuration misses, and write the results to a folder.

    `on_study` is called with the study before its page is drawn. `checkpoint_for` returns the checkpoint in a folder
    for the draws, which is complete once all is written; None: none is kept.

    Raises:
        InputError: Data, model or folder cannot be used.
    """
    with ExitStack() as work:
        # The verdict is shown once, by `on_study`.
        with stages(progress, answers=False):
            with stage("Starting", said=False):
                folder = work.enter_context(output_folder(place))
                arguments = settings.study_arguments()
                model = settings.build_studied_model()
                train, test = settings.read_data()
                checkpoint = None if checkpoint_for is None else work.enter_context(checkpoint_for(folder))
            study = find_missing_effects(model, train, test, **arguments, progress=progress, checkpoint=checkpoint)
            study = replace(study, config=settings.text)
            with stage("Saving the study"), staged(folder) as part:
                # First, by itself: no later failure may cost the draws.
                study.save(part / STUDY)
                settings.copy_to(folder, part)
        on_study(study)
        with stages(progress):
            record = study_record(study, settings.sampling.model_dump())
            report_into(folder, study, {"config": settings.file, **record}, settings.output.figures)
        if checkpoint is not None:
            checkpoint.complete()
    return study
