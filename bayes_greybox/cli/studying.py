"""The commands discover, on one configuration or on a folder of assets, and next."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayes_greybox.cli.ending import BAD_INPUT, DONE, NOT_CONVERGED, show
from bayes_greybox.cli.folders import place_of, resumable
from bayes_greybox.cli.options import Run
from bayes_greybox.config import Config, load_config
from bayes_greybox.discovery.next_experiment.ranked import NextExperiment
from bayes_greybox.fleet.assets import assets_of
from bayes_greybox.fleet.reporting import FLEET_PAGE, STUDY_PAGE
from bayes_greybox.fleet.run import study_fleet, study_into
from bayes_greybox.missing_effects import Study, find_missing_effects, load
from bayes_greybox.report.terminal.study import fleet_tables, study_tables
from bayes_greybox.report.terminal.tables import frame_table
from bayes_greybox.report.words.asked import STUDY_FILE
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.whole_files import write_text


def study_configured(settings: Config, run: Run) -> int:
    """Study what the simulation of a configuration misses, and write the results to a folder."""
    folder = place_of(settings.folder, "discover", run.output)
    study = study_into(
        settings, folder, progress=run.progress,
        on_study=lambda study: None if run.quiet else show(*study_tables(study, str(folder / STUDY_FILE))),
        checkpoint_for=lambda folder: resumable(folder, settings, run.resume),
    )  # fmt: skip
    show(folder if run.quiet else f"\nThe report is {folder / STUDY_PAGE}.")
    return DONE if study.fit is None or study.fit.verdict.mixed else NOT_CONVERGED


def study_folder(
    config: Path | None, folder: Path, sampling: Mapping[str, int | None], tasks: Mapping[str, Any], run: Run
) -> int:
    """Study every asset of a folder, and write their common results; `tasks` says on how many workers, or where."""
    place = Path("runs") / (folder.resolve().name or "fleet")
    place = place.with_name(f"{place.name}-fleet") if place.resolve() == folder.resolve() else place
    place = place_of(place, "fleet", run.output)
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


def next_configured(file: Path, options: Mapping[str, Any], seed: int, run: Run) -> int:
    """Rank what could be measured next, for a configuration, which is studied first, or for a saved study.

    A folder gets the whole table, and figures of the expected records under each hypothesis.
    """
    study, settings = _study(file, run.progress)
    # Options that are not given have the defaults of `Study.next_experiment`.
    settings |= {name: value for name, value in options.items() if value not in (None, [])}
    ranked = study.next_experiment(seed=seed, **settings)
    show(ranked.sentence)
    if not run.quiet and len(ranked.table):
        show(_table(ranked))
    if run.output is not None:
        _write(ranked, run.output)
        show(run.output if run.quiet else f"\nTable and figures are in {run.output}.")
    return DONE


def _table(ranked: NextExperiment) -> Any:
    """Return the ten best, in a few narrow columns, so that numbers stand beside long names."""
    import pandas as pd

    best = ranked.table.head(10).set_index("candidate")
    bits = [f"{max(bits, 0.0):.2f}" for bits in best["information"]]
    table = pd.DataFrame({"bits": bits, "reach": [f"{each:.2g}" for each in best["reach"]]}, index=best.index)
    if any(best["said"]):
        table["mind"] = best["said"]
    return frame_table("Expected information in bits, and reach over the data's range", table, wrap=True)


def _write(ranked: NextExperiment, output: Path) -> None:
    from bayes_greybox.report.plots import next_experiment, save_figures

    figures = {}
    for place in range(len(ranked.responses)):
        suffix = f"_{place + 1}" if len(ranked.responses) > 1 else ""
        figures |= {f"{name}{suffix}": figure for name, figure in next_experiment(ranked, place).items()}
    save_figures(figures, output)
    write_text(output / "candidates.csv", ranked.table.to_csv(index=False))


def _study(file: Path, progress: bool) -> tuple[Study, dict[str, Any]]:
    """Return the study, and the settings of candidates in its configuration."""
    if file.suffix == ".nc":
        study = load(file)
        if not isinstance(study, Study):
            raise InputError(f'"{file}" holds a fit and no study: give what discover wrote, study.nc.')
        return study, {}
    settings = load_config(file)
    train, test = settings.read_data()
    arguments = {**settings.study_arguments(), "settle": False, "free_runs": False}
    study = find_missing_effects(settings.build_studied_model(), train, test, **arguments, progress=progress)
    return study, settings.next.given()
