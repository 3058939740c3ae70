"""The command next."""

from pathlib import Path
from typing import Any

from bayes_greybox.cli.ending import DONE, show
from bayes_greybox.config import load_config
from bayes_greybox.discovery.next_experiment.ranked import NextExperiment
from bayes_greybox.missing_effects import Study, find_missing_effects, load
from bayes_greybox.report.terminal.tables import frame_table
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.whole_files import write_text


def next_configured(
    file: Path, signals: list[str] | None, amplitudes: list[float] | None, batch: int | None, threshold: float | None,
    seed: int, progress: bool, quiet: bool, output: Path | None = None,
) -> int:  # fmt: skip
    """Rank what could be measured next, for a configuration, which is studied first, or for a saved study.

    Into a folder go the whole table, and figures of what each experiment would show under each explanation.
    """
    asked = {"signals": signals, "amplitudes": amplitudes, "batch": batch, "threshold": threshold}
    study, given = _study(file, progress)
    # What is not given has the defaults of the study's own door.
    given |= {name: value for name, value in asked.items() if value not in (None, [])}
    found = study.next_experiment(seed=seed, **given)
    show(found.sentence)
    if not quiet and len(found.table):
        show(_table(found))
    if output is not None:
        _written(found, output)
        show(output if quiet else f"\nTable and figures are in {output}.")
    return DONE


def _table(found: NextExperiment) -> Any:
    """The ten best, in a few narrow columns, so that numbers stand beside long names."""
    import pandas as pd

    best = found.table.head(10).set_index("candidate")
    bits = [f"{max(bits, 0.0):.2f}" for bits in best["information"]]
    table = pd.DataFrame({"bits": bits, "reach": [f"{each:.2g}" for each in best["reach"]]}, index=best.index)
    if any(best["said"]):
        table["mind"] = best["said"]
    return frame_table("Expected information in bits, and reach over the data's range", table, wrap=True)


def _written(found: NextExperiment, output: Path) -> None:
    from bayes_greybox.report.plots import next_experiment, save_figures

    figures = {}
    for place in range(len(found.responses)):
        suffix = f"_{place + 1}" if len(found.responses) > 1 else ""
        figures |= {f"{name}{suffix}": figure for name, figure in next_experiment(found, place).items()}
    save_figures(figures, output)
    write_text(output / "candidates.csv", found.table.to_csv(index=False))


def _study(file: Path, progress: bool) -> tuple[Study, dict[str, Any]]:
    """The study, and what its configuration asks of candidates."""
    if file.suffix == ".nc":
        found = load(file)
        if not isinstance(found, Study):
            raise InputError(f'"{file}" holds a fit and no study: give what discover wrote, study.nc.')
        return found, {}
    settings = load_config(file)
    train, test = settings.read_data()
    arguments = {**settings.study_arguments(), "settle": False, "free_runs": False}
    found = find_missing_effects(settings.build_studied_model(), train, test, **arguments, progress=progress)
    return found, settings.next.given()
