"""A fleet's studies: each asset's results in a folder of its own, those of all together above them."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayes_greybox.discovery.fleet.shared import Fleet
from bayes_greybox.inference.kept.netcdf import versions
from bayes_greybox.report.folders.holding import RECORD_FILE
from bayes_greybox.report.folders.record import write_json
from bayes_greybox.report.folders.writing import output_folder, staged
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.stages import stages
from bayes_greybox.running.tasks import LOST

from .assets import Asset
from .reporting import MARK, put_back, set_aside
from .study import study_into
from .together import ASSETS, Told, studied_together, write_fleet


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
        InputError: The folder cannot be written to; no scheduler answers, or it was lost: what is done is kept. What
            one asset lacks costs that asset alone.
    """
    with output_folder(place) as folder, stages(progress):
        known: dict[str, Told] = {}
        failed: dict[str, str] = {}
        tasks: dict[str, tuple] = {}
        for asset in assets:
            own = folder.resolve() / ASSETS / asset.name
            try:
                mark = _mark(asset, sampling)
            except (InputError, OSError) as error:
                failed[asset.name] = str(error)
                continue
            put_back(own)
            before = _studied(own, mark)
            if before is None:
                tasks[asset.name] = (asset, str(own), dict(sampling), mark)
            else:
                known[asset.name] = Told(before)
        order = [asset.name for asset in assets]
        fleet, _ = studied_together(study_asset, tasks, order, known, failed, workers=workers, scheduler=scheduler)
        if any(each.sentence == LOST for each in fleet.failed):
            raise InputError("The Dask scheduler was lost. What is done is kept: give the same command again.")
        for each in fleet.failed:
            set_aside(folder / ASSETS / each.asset)
        write_fleet(fleet, folder)
    return fleet


def study_asset(asset: Asset, place: str, sampling: Mapping[str, int | None], mark: str) -> Told:
    """One asset's study, on whatever machine, with its results in its folder.

    Args:
        asset: The asset.
        place: Its folder.
        sampling: Settings in place of the configuration's own.
        mark: What its results are of.
    """
    folder = Path(place)
    settings = asset.settings().with_sampling(**sampling)
    study_into(settings, folder, progress=False)
    text = (folder / RECORD_FILE).read_bytes()
    with staged(folder) as part:
        # Last, and of this very record: results of another run in this folder are not taken for this one's.
        write_json(part / MARK, {"of": mark, "record": hashlib.sha256(text).hexdigest()})
    return Told(json.loads(text))


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
        said, text = json.loads((folder / MARK).read_text(encoding="utf-8")), (folder / RECORD_FILE).read_bytes()
        if said != {"of": mark, "record": hashlib.sha256(text).hexdigest()}:
            return None
        return json.loads(text)
    except (OSError, ValueError):
        return None
