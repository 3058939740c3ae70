"""Pages of what was saved before: a fit, several of them, a study, or the folder of a command."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayes_greybox.criticism.cross_validation.compare import compare
from bayes_greybox.criticism.kept.file import checked_of, load_checked
from bayes_greybox.discovery.kept.study_file import holds_study, study_of
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.inference.kept import netcdf
from bayes_greybox.inference.kept.damage import made_of
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.report.folders.holding import author_text
from bayes_greybox.report.pages.comparison_page import comparison_html
from bayes_greybox.report.pages.fit_page import fit_html
from bayes_greybox.report.pages.page import require_place
from bayes_greybox.report.pages.study_page import study_html
from bayes_greybox.running.errors import InputError

from .comparison import COMPARISON_PAGE, load_comparison
from .holding import CONFIG, FILES_OF, command_of


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


def _is_study(file: Path) -> bool:
    tree = netcdf.read(file)
    with made_of(file):
        return holds_study(tree)


def _require_fits(files: Sequence[Path]) -> None:
    """Refuse studies among several files, whose fits alone could be compared."""
    studies = [str(file) for file in files if _is_study(file)]
    if studies:
        raise InputError(
            f'"{studies[0]}" holds a study, and report shows one study at a time: name it alone, or compare the fits '
            "in these files with bayes-greybox compare."
        )
