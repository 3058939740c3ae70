"""Files of studies and of a fleet of them in folders, and assets studied side by side or one after another."""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bayes_greybox.discovery.fleet.shared import Fleet, fleet_of
from bayes_greybox.inference.kept.netcdf import versions
from bayes_greybox.missing_effects import Study
from bayes_greybox.report.folders.holding import CONFIG, RECORD_FILE, command_of
from bayes_greybox.report.folders.record import write_json
from bayes_greybox.report.folders.writing import staged
from bayes_greybox.report.words.asked import STUDY_FILE
from bayes_greybox.report.words.fleet import fleet_sentence
from bayes_greybox.running.plain_values import plain_rows, plain_values
from bayes_greybox.running.stages import announce, stage
from bayes_greybox.running.tasks import run_tasks

STUDY, STUDY_PAGE = STUDY_FILE, "gap.html"
"""Names of a study's file and of its page."""

MARK, EARLIER = "asset.json", "earlier-"
"""File that marks an asset's study as whole, and prefix of results that a later run set aside as it failed."""

ASSETS, FLEET_PAGE = "assets", "fleet.html"
"""Folder of the assets' folders, and the page of all."""


def report_into(folder: Path, study: Study, record: Mapping[str, Any], figures: bool) -> None:
    """Write a study's record, for summary.json, and page to a folder, and its figures where they are wanted."""
    with stage("Writing the report"), staged(folder) as part:
        # Imported here because it is slow, and the verdict does not wait for it.
        from bayes_greybox.report.pages.study_page import study_html

        write_json(part / RECORD_FILE, {"command": "discover", **record})
        study_html(study, part / STUDY_PAGE)
    if figures:
        with stage("Drawing"):
            from bayes_greybox.report.plots import save_figures, study_figures

            save_figures(study_figures(study), folder / "figures")


def set_aside(folder: Path) -> None:
    """Rename the record and page of an earlier run in an asset's folder, because a later run failed."""
    for name in (RECORD_FILE, STUDY_PAGE):
        with suppress(OSError):
            (folder / name).replace(folder / f"{EARLIER}{name}")


def put_back(folder: Path) -> None:
    """Undo `set_aside`: the reason of the failure may be gone."""
    for name in (RECORD_FILE, STUDY_PAGE):
        if not (folder / name).exists():
            with suppress(OSError):
                (folder / f"{EARLIER}{name}").replace(folder / name)


def remove_results(folder: Path) -> None:
    """Remove the files that a study wrote to a folder, and the folder if it is empty then.

    Nothing is removed where the folder holds no study, or one with a configuration of its own.
    """
    copied = False
    with suppress(OSError):
        copied = "copied_from" in (folder / CONFIG).read_text(encoding="utf-8")
    if (folder / CONFIG).exists() and not copied:
        return
    put_back(folder)
    if command_of(folder) != "discover":
        return
    names = [*_figures(folder / RECORD_FILE), STUDY, STUDY_PAGE, RECORD_FILE, MARK]
    names += [*(f"{EARLIER}{name}" for name in (RECORD_FILE, STUDY_PAGE)), *([CONFIG] if copied else [])]
    for name in names:
        with suppress(OSError):
            (folder / name).unlink()
    for place in (folder / "figures", folder):
        with suppress(OSError):
            place.rmdir()


def _figures(record: Path) -> list[str]:
    """Return the paths of a study's figures, if any were drawn."""
    try:
        content = json.loads(record.read_text(encoding="utf-8"))
        ends = ["", *(f"_{row['equation']}" for row in content["hypotheses"])]
        # Those of `report.plots.study_figures`.
        names = [f"{name}{end}" for name in ("gap_map", "gap_time", "ranking", "rounds") for end in ends]
        names += ["added_coefficients", *(f"free_run_{row['variable']}" for row in content["gap"])]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [f"figures/{name}.png" for name in dict.fromkeys(names)]


@dataclass(frozen=True)
class AssetResult:
    """Result of an asset's study, as a worker sends it: its record, and its file unless it lies in a folder already."""

    record: Mapping[str, Any]
    study_file: bytes = b""


def studied_together(
    function: Callable[..., AssetResult],
    tasks: Mapping[str, Sequence[Any]],
    order: Sequence[str],
    known: Mapping[str, AssetResult] | None = None,
    failed: Mapping[str, str] | None = None,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
) -> tuple[Fleet, dict[str, AssetResult]]:
    """Study assets and put their results together, in order; one that cannot be studied costs itself alone.

    `function`, of a module, studies one asset, `tasks` are its arguments by asset, see `running.tasks.run_tasks`.
    `known` are results of assets that were studied before, `failed` the reasons of assets that are not to be tried.
    """
    results, reasons = dict(known or {}), dict(failed or {})
    with stage("Studying assets", len(order)) as line:
        line.advance(len(results) + len(reasons))
        for done in run_tasks(function, tasks, workers=workers, scheduler=scheduler) if tasks else ():
            if done.failed:
                reasons[done.name] = done.failed
            else:
                results[done.name] = done.result
            announce(f"{done.name}: {done.failed or done.result.record['sentence']}")
            line.advance(1)
    results = {name: results[name] for name in order if name in results}
    records = {name: each.record for name, each in results.items()}
    return fleet_of(records, {name: reasons[name] for name in order if name in reasons}), results


def write_fleet(fleet: Fleet, folder: Path) -> None:
    """Write assets.csv, summary.json and the page of a fleet, which leads to those of the assets in `ASSETS`/NAME."""
    with stage("Writing the report"), staged(folder) as part:
        # Imported here because it is slow, and studies do not wait for it.
        from bayes_greybox.report.pages.fleet_page import fleet_html

        fleet.table().to_csv(part / "assets.csv")
        record = {
            "command": "fleet",
            "sentence": fleet_sentence(fleet),
            "assets": plain_rows(fleet.table()),
            "shared": [asdict(each) for each in fleet.shared],
            "versions": versions(),
        }
        write_json(part / RECORD_FILE, plain_values(record))
        pages = {each.asset: f"{ASSETS}/{each.asset}/{STUDY_PAGE}" for each in fleet.studied}
        # The page of an earlier study may have been removed since.
        pages = {name: page for name, page in pages.items() if (folder / page).is_file()}
        fleet_html(fleet, part / FLEET_PAGE, pages)
