"""The folder of a comparison, which is read again without comparing anew."""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from bayes_greybox.criticism.kept.file import load_checked
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.report.folders.holding import author_text, copy_of
from bayes_greybox.report.pages.comparison_page import comparison_html
from bayes_greybox.report.plots import plot_comparison, save_figures
from bayes_greybox.running.errors import InputError

from .holding import CONFIG, RECORD_FILE
from .record import comparison_record, write_json
from .writing import staged

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
    """Write record, page, figure and configuration of a comparison, the result of `compare`.

    The record remembers where each fit is saved, by `files`. `sampling` is None for fits that were saved before,
    `config` the path and the text of the configuration file.

    Raises:
        InputError: A file cannot be written.
    """
    record = {"fits": {name: _whereabouts(file, folder) for name, file in files.items()}}
    record |= comparison_record(fits, table, sampling)
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


def _whereabouts(file: Path, folder: Path) -> dict[str, str]:
    """Return path and fingerprint of a fit; relative if it lies in the folder, so that the folder can be moved."""
    whole, home = file.resolve(), folder.resolve()
    path = whole.relative_to(home).as_posix() if whole.is_relative_to(home) else str(whole)
    return {"file": path, "sha256": _digest(file)}


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
