"""Assets studied side by side or one after another, and their common results in a folder."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bayes_greybox.discovery.fleet.shared import Fleet, fleet_of
from bayes_greybox.inference.kept.netcdf import versions
from bayes_greybox.report.folders.holding import RECORD_FILE
from bayes_greybox.report.folders.record import write_json
from bayes_greybox.report.folders.writing import staged
from bayes_greybox.report.words.fleet import fleet_sentence
from bayes_greybox.running.plain_values import plain_rows, plain_values
from bayes_greybox.running.stages import announce, stage
from bayes_greybox.running.tasks import run_tasks

from .reporting import STUDY_PAGE

ASSETS, FLEET_PAGE = "assets", "fleet.html"
"""Folder of the assets' folders, and the page of all."""


@dataclass(frozen=True)
class AssetResult:
    """Result of an asset's study, as a worker sends it: its record, and its file where it lies in no folder already."""

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

    `function`, of a module, studies one asset, `tasks` are its arguments by asset. `known` are results of assets that
    were studied before, `failed` the reasons of assets that are not to be tried.

    Raises:
        InputError: As for `running.tasks.run_tasks`.
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
    """Write assets.csv, summary.json and the page of a fleet, which leads to those of the assets in `ASSETS`/NAME.

    Raises:
        InputError: A file cannot be written.
    """
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
