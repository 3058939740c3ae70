"""The command fit."""

import time
from contextlib import ExitStack

from bayes_greybox.config import Config
from bayes_greybox.criticism.kept.file import save_found
from bayes_greybox.criticism.trial import trial, try_on
from bayes_greybox.report.folders.holding import CONFIGURATION_ATTRIBUTE
from bayes_greybox.report.folders.record import run_record, write_json
from bayes_greybox.report.folders.writing import output_folder, staged
from bayes_greybox.report.terminal.fit import fit_tables
from bayes_greybox.running.stages import stage, stages

from .ending import DONE, NOT_CONVERGED, show
from .folders import place_of, resumable
from .options import Run


def fit_configured(settings: Config, run: Run) -> int:
    """Fit the model of a configuration, and write the results to a folder."""
    with ExitStack() as work:
        with stages(run.progress):
            with stage("Starting", said=False):
                folder = work.enter_context(output_folder(place_of(settings.folder, "fit", run.output)))
                train, test = settings.read_rows()
                model = settings.build_model()
                checkpoint = work.enter_context(resumable(folder, settings, run.resume))
            start = time.perf_counter()
            result = model.fit(train, **settings.sampling.model_dump(), progress=run.progress, checkpoint=checkpoint)
            seconds = time.perf_counter() - start
            result.idata.attrs[CONFIGURATION_ATTRIBUTE] = settings.text
        try:
            with stages(run.progress), stage("Predicting held-out data"):
                held_out = None if test is None else result.predict(test).nmse()
            if not run.quiet:
                show(*fit_tables(result, held_out))
        finally:
            # After the answer, but whatever failed: no draws are lost.
            with stages(run.progress), stage("Saving the fit"), staged(folder) as place:
                result.save(place / "run.nc")
                settings.copy_to(folder, place)
        with stages(run.progress):
            with stage("Checking the model"):
                checked = result.checks()
            with stage("Following the model by itself"):
                # Its page shows them; the file keeps them.
                tried = trial(result) if test is None else try_on(result, test)
            with stage("Writing the record"), staged(folder) as place:
                save_found(result, folder / "run.nc", place / "run.nc")
                record = run_record(result, settings.sampling.model_dump(), seconds, held_out, tried)
                write_json(place / "summary.json", {"command": "fit", "config": settings.file, **record})
            if settings.output.figures:
                with stage("Drawing"):
                    # Imported here because it is slow, and the verdict does not wait for it.
                    from bayes_greybox.report.plots import fit_figures, save_figures

                    save_figures(fit_figures(result), folder / "figures")
        checkpoint.complete()
    show(*([folder] if run.quiet else ["", str(checked), f"Results are in {folder}."]))
    return DONE if result.verdict.mixed else NOT_CONVERGED
