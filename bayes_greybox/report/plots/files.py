"""Figures to files, none of them ever half-written."""

import os
from collections.abc import Mapping
from pathlib import Path

from matplotlib.figure import Figure

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.whole_files import whole_file

from .style import laid_out

COMPRESSION = 3
"""Of files, from 1 to 9: at 6, which is usual, they are a tenth smaller and take twice the time."""


def save_figures(figures: Mapping[str, Figure], folder: str | os.PathLike[str]) -> dict[str, Path]:
    """Write each figure as `folder/name.png`, beside its final name first and then renamed.

    Args:
        figures: figures by name; a name is a file name without its ending.
        folder: where to; made where it is missing.

    Returns:
        The path of each figure.

    Raises:
        InputError: a name is not a plain file name, or the folder cannot be written to.
    """
    target = Path(folder)
    for name in figures:
        if not name or name.startswith(".") or set(name) & set('/\\:*?"<>|\0'):
            raise InputError(f"{name!r} cannot name a figure's file; use letters, digits, '-' and '_'.")
    try:
        target.mkdir(parents=True, exist_ok=True)
        return {name: _save(figure, target / f"{name}.png") for name, figure in figures.items()}
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"Cannot write figures to {str(target)!r} ({reason}); choose another folder.") from error


def _save(figure: Figure, path: Path) -> Path:
    with whole_file(path) as part, laid_out(figure):
        figure.savefig(part, format="png", dpi=150, pil_kwargs={"compress_level": COMPRESSION})
    return path
