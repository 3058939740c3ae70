"""Pages of what was saved before: a fit, several of them, or the folder of a comparison."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayes_greybox.criticism.checks.kept import load_checked
from bayes_greybox.criticism.cross_validation.compare import compare
from bayes_greybox.inference.posterior import Posterior

from .comparison_folder import PAGE, load_comparison
from .pages.comparison_page import comparison_html
from .pages.fit_page import fit_html
from .pages.page import require_place


def saved_html(
    files: Sequence[Path], path: Path | None, folds: Mapping[str, Any], progress: bool = False
) -> tuple[dict[str, Posterior], Path]:
    """Write the report of saved results.

    Args:
        files: One saved fit; several, which are compared; or one folder that `save_comparison` filled, which is shown
            as it is.
        path: Destination; None: beside the fit, in the folder, or for several fits in the current folder.
        folds: Arguments of `compare` for several fits.
        progress: Whether exact refits show their progress.

    Returns:
        The fits by name, and where the page is.

    Raises:
        InputError: Whatever `load`, `load_comparison` and `compare` refuse; the destination cannot be written.
    """
    if len(files) > 1:
        fits, page = load_fits(files), path or Path(PAGE)
        require_place(page)
        comparison_html(fits, compare(fits, **folds, progress=progress), page)
        return fits, page
    (file,) = files
    if file.is_dir():
        saved, page = load_comparison(file), path or file / PAGE
        comparison_html(saved.fits, saved.table, page, saved.config)
        return dict(saved.fits), page
    fit, page = load_checked(file), path or file.with_suffix(".html")
    fit_html(fit, page)
    return {file.stem: fit}, page


def load_fits(files: Sequence[Path]) -> dict[str, Posterior]:
    """Saved fits by names that tell them apart: of the file, of its folder where the file is a plain run.nc."""
    names = [file.resolve().parent.name if file.stem == "run" else file.stem for file in files]
    if len(set(names)) < len(names):
        names = [str(file) for file in files]
    return dict(zip(names, map(load_checked, files), strict=True))
