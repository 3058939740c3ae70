"""Assets studied side by side or one after another, and what they say together; that written to a folder."""

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

from .reporting import PAGE

ASSETS, FLEET_PAGE = "assets", "fleet.html"
"""Folder of the assets' folders, and the page of all."""


@dataclass(frozen=True)
class Told:
    """What came of an asset's study, as a worker sends it: plain values.

    Attributes:
        record: As in summary.json.
        kept: The study's file; empty where it lies in a folder already.
    """

    record: Mapping[str, Any]
    kept: bytes = b""


def studied_together(
    function: Callable[..., Told],
    tasks: Mapping[str, Sequence[Any]],
    order: Sequence[str],
    known: Mapping[str, Told] | None = None,
    failed: Mapping[str, str] | None = None,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
) -> tuple[Fleet, dict[str, Told]]:
    """Study assets, and put together what they say; one that cannot be studied costs itself alone.

    Args:
        function: Of a module: studies one asset.
        tasks: Its arguments by asset.
        order: Names of all assets.
        known: Those that were studied before.
        failed: Reasons of those that are not to be tried.
        workers: As for `data.tasks.run_tasks`.
        scheduler: As there.

    Raises:
        InputError: As there.
    """
    told, reasons = dict(known or {}), dict(failed or {})
    with stage("Studying assets", len(order)) as line:
        line.advance(len(told) + len(reasons))
        for done in run_tasks(function, tasks, workers=workers, scheduler=scheduler) if tasks else ():
            if done.failed:
                reasons[done.name] = done.failed
            else:
                told[done.name] = done.result
            announce(f"{done.name}: {done.failed or done.result.record['sentence']}")
            line.advance(1)
    told = {name: told[name] for name in order if name in told}
    fleet = fleet_of({name: each.record for name, each in told.items()}, {n: reasons[n] for n in order if n in reasons})
    return fleet, told


def write_fleet(fleet: Fleet, folder: Path) -> None:
    """Write what assets say together: assets.csv, summary.json and the page, which leads to those of the assets.

    Args:
        fleet: The fleet.
        folder: Its folder; each asset's results lie within, in `ASSETS`/NAME.

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
        pages = {each.asset: f"{ASSETS}/{each.asset}/{PAGE}" for each in fleet.studied}
        # Of a study of before its page may have been removed since.
        pages = {name: page for name, page in pages.items() if (folder / page).is_file()}
        fleet_html(fleet, part / FLEET_PAGE, pages)
