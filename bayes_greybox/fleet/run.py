"""A fleet's studies: each asset's results in a folder of its own, those of all together above them."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.records import plain_rows, plain_values
from bayes_greybox.data.tasks import run_tasks
from bayes_greybox.discovery.fleet import Fleet, fleet_of
from bayes_greybox.inference.kept.netcdf import versions
from bayes_greybox.report.folders.holding import RECORD
from bayes_greybox.report.folders.record import write_json
from bayes_greybox.report.folders.writing import output_folder, staged
from bayes_greybox.report.words.fleet import fleet_sentence
from bayes_greybox.running.stages import announce, stage, stages

from .assets import Asset
from .study import PAGE, study_into

ASSETS, MARK, FLEET_PAGE = "assets", "asset.json", "fleet.html"
"""Folder of the assets' folders, what says in one that its study is whole, and the page of all."""


def study_fleet(
    assets: list[Asset],
    place: Path,
    sampling: Mapping[str, int | None],
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: bool = True,
) -> Fleet:
    """Study all assets, or those that were not studied before, and write what they say together.

    Args:
        assets: The assets.
        place: Folder for the results.
        sampling: Settings that stand in place of the configurations' own; None: they stand.
        workers: Processes of this machine; see `data.tasks.run_tasks`.
        scheduler: Address of a Dask scheduler, whose workers see the same files.
        progress: Whether to show what is being done.

    Returns:
        The fleet.

    Raises:
        InputError: The folder cannot be written to; no scheduler answers. What one asset lacks costs that asset alone.
    """
    with output_folder(place) as folder, stages(progress):
        records: dict[str, dict[str, Any]] = {}
        failed: dict[str, str] = {}
        tasks: dict[str, tuple] = {}
        for asset in assets:
            own = folder.resolve() / ASSETS / asset.name
            try:
                mark = _mark(asset, sampling)
            except (InputError, OSError) as error:
                failed[asset.name] = str(error)
                continue
            before = _studied(own, mark)
            if before is None:
                tasks[asset.name] = (asset, str(own), dict(sampling), mark)
            else:
                records[asset.name] = before
        with stage("Studying assets", len(assets)) as line:
            line.advance(len(records) + len(failed))
            for done in run_tasks(study_asset, tasks, workers=workers, scheduler=scheduler) if tasks else ():
                if done.failed:
                    failed[done.name] = done.failed
                else:
                    records[done.name] = done.result
                announce(f"{done.name}: {done.failed or done.result['sentence']}")
                line.advance(1)
        order = [asset.name for asset in assets]
        fleet = fleet_of({n: records[n] for n in order if n in records}, {n: failed[n] for n in order if n in failed})
        with stage("Writing the report"), staged(folder) as part:
            from bayes_greybox.report.pages.fleet_page import fleet_html

            fleet.table().to_csv(part / "assets.csv")
            write_json(part / RECORD, _record(fleet))
            pages = {name: f"{ASSETS}/{name}/{PAGE}" for name in records}
            fleet_html(fleet, part / FLEET_PAGE, pages)
    return fleet


def study_asset(asset: Asset, place: str, sampling: Mapping[str, int | None], mark: str) -> dict[str, Any]:
    """One asset's study, on whatever machine; its record.

    Args:
        asset: The asset.
        place: Its folder.
        sampling: Settings in place of the configuration's own.
        mark: What its results are of.
    """
    folder = Path(place)
    settings = asset.settings().with_sampling(**sampling)
    study_into(settings, folder, progress=False)
    text = (folder / RECORD).read_bytes()
    with staged(folder) as part:
        # Last, and of this very record: results of another run in this folder are not taken for this one's.
        write_json(part / MARK, {"of": mark, "record": hashlib.sha256(text).hexdigest()})
    return json.loads(text)


def _record(fleet: Fleet) -> dict[str, Any]:
    return plain_values(
        {
            "command": "fleet",
            "sentence": fleet_sentence(fleet),
            "assets": plain_rows(fleet.table()),
            "shared": [asdict(each) for each in fleet.shared],
            "versions": versions(),
        }
    )


def _mark(asset: Asset, sampling: Mapping[str, int | None]) -> str:
    """What an asset's results are of: its configuration, data and catalogues, the sampler's settings, this version."""
    settings = asset.settings().with_sampling(**sampling)
    digest = hashlib.sha256(settings.text.encode())
    folder = settings.origin.parent
    for file in (*settings.data.files(folder), *settings.study.files(folder)):
        # One that is not there is the study's to refuse.
        digest.update(hashlib.sha256(file.read_bytes() if file.is_file() else b"").digest())
    digest.update(json.dumps([settings.sampling.model_dump(), versions()], sort_keys=True).encode())
    return digest.hexdigest()


def _studied(folder: Path, mark: str) -> dict[str, Any] | None:
    """The record of a study that was done before and is of the same."""
    try:
        said, text = json.loads((folder / MARK).read_text(encoding="utf-8")), (folder / RECORD).read_bytes()
        if said != {"of": mark, "record": hashlib.sha256(text).hexdigest()}:
            return None
        return json.loads(text)
    except (OSError, ValueError):
        return None
