"""The command next."""

from pathlib import Path

from bayes_greybox.cli.ending import DONE, show
from bayes_greybox.config import load_config
from bayes_greybox.data.errors import InputError
from bayes_greybox.missing_effects import Study, find_missing_effects, load
from bayes_greybox.report.terminal.tables import frame_table


def next_configured(
    file: Path, signals: list[str] | None, amplitudes: list[float] | None, batch: int, threshold: float | None,
    seed: int, progress: bool, quiet: bool,
) -> int:  # fmt: skip
    """Rank what could be measured next, for a configuration, which is studied first, or for a saved study."""
    asked = {"signals": signals, "amplitudes": amplitudes, "threshold": threshold}
    # What is not given has the defaults of the study's own door.
    given = {name: value for name, value in asked.items() if value not in (None, [])}
    found = _study(file, progress).next_experiment(batch=batch, seed=seed, **given)
    show(found.sentence)
    if not quiet and len(found.table):
        table = found.table.head(10).set_index("candidate")
        show(frame_table("Expected information in bits, its Monte Carlo error, reach over the data's range", table))
    return DONE


def _study(file: Path, progress: bool) -> Study:
    if file.suffix == ".nc":
        found = load(file)
        if not isinstance(found, Study):
            raise InputError(f'"{file}" holds a fit and no study: give what discover wrote, study.nc.')
        return found
    settings = load_config(file)
    train, test = settings.read_data()
    arguments = {**settings.study_arguments(), "settle": False, "free_runs": False}
    return find_missing_effects(settings.build_studied_model(), train, test, **arguments, progress=progress)
