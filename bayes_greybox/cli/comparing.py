"""The command compare: models of a file, or fits that were saved."""

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from bayes_greybox.config import Config
from bayes_greybox.criticism.cross_validation.compare import compare
from bayes_greybox.criticism.cross_validation.folds import FUTURE_START, check_scheme, require_divisible
from bayes_greybox.report.folders.holding import require_own
from bayes_greybox.report.folders.saved import load_fits, save_comparison
from bayes_greybox.report.folders.writing import output_folder, staged
from bayes_greybox.report.terminal.fit import comparison_tables
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.stages import announce, stage, stages

from .ending import exit_code, show
from .folders import complete, place_of, resumable
from .options import Run


def compare_configured(settings: Config, run: Run) -> int:
    """Fit the models of a configuration file, compare them, and fill the folder."""
    if len(settings.models) < 2:
        raise InputError(
            f"compare needs two or more models, and {settings.file} has {len(settings.models)}: add tables "
            'such as [models.laplace] with prior = { kind = "laplace" }.'
        )
    check_scheme(settings.compare.scheme, settings.compare.block, settings.compare.start or FUTURE_START)
    with output_folder(place_of(settings.folder, "compare", run.output)) as folder:
        train, _ = settings.read_data()
        models = {name: settings.build_model(name) for name in settings.models}
        for name, model in models.items():
            # Errors of the last model are better reported before the first is sampled.
            try:
                model.on(train).designs(train)
                require_divisible(train, model.equations, settings.compare.scheme)
            except InputError as error:
                raise InputError(f"[models.{name}] {error}") from error
        fits = {}
        with stages(run.progress):
            for name, model in models.items():
                announce(f"Model {name}")
                sampling = settings.sampling.model_dump()
                with resumable(folder, settings, run.resume, name) as checkpoint:
                    fits[name] = model.fit(train, **sampling, progress=run.progress, checkpoint=checkpoint)
                    # Each as soon as it is there: a later failure costs no finished fit.
                    with staged(folder) as place:
                        fits[name].save(place / f"{name}.nc")
            with stage("Comparing"):
                table = compare(fits, **settings.compare.given(), progress=run.progress)
            with stage("Writing the report"):
                files = {name: folder / f"{name}.nc" for name in fits}
                about = {"config": (settings.origin, settings.text), "figures": settings.output.figures}
                save_comparison(folder, fits, table, files, sampling=settings.sampling.model_dump(), **about)
        complete(folder, models)
    return _compared(fits, table, folder, run.quiet)


def compare_saved(files: Sequence[Path], folds: dict[str, Any], run: Run) -> int:
    """Compare saved fits; results are written if a folder is given."""
    fits = load_fits(files)
    if run.output is not None:
        require_own(run.output, "compare")
    with nullcontext() if run.output is None else output_folder(run.output) as folder, stages(run.progress):
        with stage("Comparing"):
            table = compare(fits, **folds, progress=run.progress)
        if folder is not None:
            with stage("Writing the report"):
                save_comparison(folder, fits, table, dict(zip(fits, files, strict=True)))
    return _compared(fits, table, folder, run.quiet)


def _compared(fits: dict[str, Any], table: Any, folder: Path | None, quiet: bool) -> int:
    if not quiet:
        show(*comparison_tables(fits, table), *([] if folder is None else [f"Results are in {folder}."]))
    elif folder is not None:
        show(folder)
    return exit_code(fits)
