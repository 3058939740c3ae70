"""Results that were saved before: the folder of a comparison, and pages of fits, of studies and of folders."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from bayes_greybox.criticism.cross_validation.compare import compare
from bayes_greybox.criticism.kept.file import checked_of, load_checked
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.discovery.study_file import holds_study, study_of
from bayes_greybox.inference.kept import netcdf
from bayes_greybox.inference.kept.damage import made_of
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.report.folders.holding import CONFIG, FILES_OF, RECORD_FILE, author_text, command_of, copy_of
from bayes_greybox.report.folders.record import comparison_record, write_json
from bayes_greybox.report.folders.writing import staged
from bayes_greybox.report.pages.comparison_page import comparison_html
from bayes_greybox.report.pages.fit_page import fit_html
from bayes_greybox.report.pages.page import require_place
from bayes_greybox.report.pages.study_page import study_html
from bayes_greybox.report.plots import plot_comparison, save_figures
from bayes_greybox.running.errors import InputError


def saved_html(
    files: Sequence[Path], path: Path | None, folds: Mapping[str, Any], progress: bool = False
) -> tuple[dict[str, Posterior], Path]:
    """Write the report of saved results, and return the fits by name, and where the page is.

    It is that of one saved fit or study, of several fits, compared by the arguments `folds`, or of one folder as it is.
    By default it lies beside the file, in the folder, or for several fits in the current folder.

    Raises:
        InputError: Whatever `load`, `load_comparison` and `compare` refuse; a study among several files; a folder
            without results; the destination cannot be written.
    """
    if len(files) > 1:
        _require_fits(files)
        fits, page = load_fits(files), path or Path(COMPARISON_PAGE)
        require_place(page)
        comparison_html(fits, compare(fits, **folds, progress=progress), page)
        return fits, page
    (file,) = files
    if not file.is_dir():
        return _file_html(file, path or file.with_suffix(".html"))
    command = command_of(file)
    if command == "compare":
        saved, page = load_comparison(file), path or file / COMPARISON_PAGE
        comparison_html(saved.fits, saved.table, page, saved.config)
        return dict(saved.fits), page
    if command == "fleet":
        raise InputError(
            f'"{file}" holds a fleet: its page is {FILES_OF["fleet"][0]}, and each of its assets has a folder.'
        )
    result = next((file / name for name in FILES_OF.get(command or "", ()) if name.endswith(".nc")), None)
    if result is None or not result.is_file():
        lacks = f"its {result.name} is missing" if result else "there is no summary.json of theirs in it"
        raise InputError(
            f'"{file}" is not a folder that fit, discover or compare wrote: {lacks}. Name such a folder, or saved '
            "results (*.nc)."
        )
    config = file / CONFIG
    text = author_text(config.read_text(encoding="utf-8")) if config.is_file() else None
    return _file_html(result, path, text)


def load_fits(files: Sequence[Path]) -> dict[str, Posterior]:
    """Return saved fits by distinct names: of the file, or of its folder where the file is a plain run.nc."""
    names = [file.resolve().parent.name if file.stem == "run" else file.stem for file in files]
    if len(set(names)) < len(names):
        names = [str(file) for file in files]
    return dict(zip(names, map(load_checked, files), strict=True))


def _file_html(file: Path, path: Path | None, config: str | None = None) -> tuple[dict[str, Posterior], Path]:
    """Write the page of a saved fit or study; by default where the command that saved it puts its own."""
    tree = netcdf.read(file)
    with made_of(file):
        result = study_of(tree) if holds_study(tree) else checked_of(tree)
    if isinstance(result, StudyResult):
        page = path or file.with_name("gap.html")
        study_html(result, page, config)
        return {} if result.fit is None else {file.stem: result.fit}, page
    page = path or file.with_suffix(".html")
    fit_html(result, page, config)
    return {file.stem: result}, page


def _require_fits(files: Sequence[Path]) -> None:
    """Refuse studies among several files, whose fits alone could be compared."""
    for file in files:
        tree = netcdf.read(file)
        with made_of(file):
            if not holds_study(tree):
                continue
        raise InputError(
            f'"{file}" holds a study, and report shows one study at a time: name it alone, or compare the fits '
            "in these files with bayes-greybox compare."
        )


COMPARISON_PAGE = "comparison.html"


@dataclass(frozen=True)
class SavedComparison:
    """A comparison as its folder holds it: fits by name, result of `compare`, text of the configuration, if any."""

    fits: Mapping[str, Posterior]
    table: pd.DataFrame
    config: str | None


def save_comparison(
    folder: Path,
    fits: Mapping[str, Posterior],
    table: pd.DataFrame,
    files: Mapping[str, Path],
    *,
    sampling: Mapping[str, Any] | None = None,
    config: tuple[str | Path, str] | None = None,
    figures: bool = True,
) -> None:
    """Write record, page, figure and configuration of a comparison, whose table is that of `compare`.

    The record remembers path and fingerprint of each fit, by `files`. `sampling` is None for fits that were saved
    before, `config` the path and the text of the configuration file. What cannot be written is refused.
    """
    whereabouts, home = {}, folder.resolve()
    for name, file in files.items():
        # Relative if it lies in the folder, so that the folder can be moved.
        whole = file.resolve()
        path = whole.relative_to(home).as_posix() if whole.is_relative_to(home) else str(whole)
        whereabouts[name] = {"file": path, "sha256": _digest(file)}
    record = {"fits": whereabouts, **comparison_record(fits, table, sampling)}
    named = {} if config is None else {"config": Path(config[0]).name}
    # The record first, by itself: nothing that fails later may cost the comparison.
    with staged(folder) as place:
        write_json(place / RECORD_FILE, {"command": "compare", **named, **record})
        if config is not None:
            text = copy_of(config[1], Path(config[0]), folder)
            (place / CONFIG).write_text(text, encoding="utf-8", newline="")
    with staged(folder) as place:
        comparison_html(fits, table, place / COMPARISON_PAGE, None if config is None else config[1])
    if figures:
        save_figures({"comparison": plot_comparison(table)}, folder / "figures")


def load_comparison(folder: Path) -> SavedComparison:
    """Read what `save_comparison` wrote.

    Raises:
        InputError: Not the folder of a comparison; a fit is no longer where it was, or no longer the same.
    """
    try:
        record = json.loads((folder / RECORD_FILE).read_text(encoding="utf-8"))
        table = _table(record)
        files = {str(name): (folder / entry["file"], entry["sha256"]) for name, entry in record["fits"].items()}
        if set(files) != set(table.index):
            raise KeyError("fits")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f'"{folder}" is not a folder that compare wrote: its {RECORD_FILE} is missing or holds no comparison. Name '
            "such a folder, or saved fits (*.nc)."
        ) from error
    fits = {}
    for name, (file, digest) in files.items():
        if not file.is_file():
            raise InputError(
                f'The fit {name!r} of this comparison was "{file}" and is no longer there: put it back, or compare '
                "the fits again where they are now."
            )
        if _digest(file) != digest:
            raise InputError(
                f'"{file}" has changed since it was compared in "{folder}": compare the fits again (bayes-greybox '
                "compare)."
            )
        fits[name] = load_checked(file)
    config = folder / CONFIG
    text = author_text(config.read_text(encoding="utf-8")) if "config" in record and config.is_file() else None
    return SavedComparison(fits, table, text)


def _digest(file: Path) -> str:
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def _table(record: Mapping[str, Any]) -> pd.DataFrame:
    table = pd.DataFrame(record["comparison"]).set_index("model").astype({"worst_k": float, "refits": int})
    # JSON knows no infinity: k of a model without any fold left to judge is −∞, of one beyond judging +∞.
    beyond = {name: math.inf if name in record["unreliable"] else -math.inf for name in table.index}
    table["worst_k"] = table["worst_k"].fillna(pd.Series(beyond))
    table.attrs |= {"notes": record["notes"], "versions": record["versions"], **record["scheme"]}
    return table
