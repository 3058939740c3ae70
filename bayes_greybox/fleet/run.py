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
from bayes_greybox.running.tasks import SCHEDULER_LOST

from .assets import Asset
from .reporting import ASSET_MARK, put_back, set_aside
from .study import study_into
from .together import ASSETS, AssetResult, studied_together, write_fleet


def study_fleet(
    assets: list[Asset],
    place: Path,
    sampling: Mapping[str, int | None],
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: bool = True,
) -> Fleet:
    """Study all assets that were not studied before, and write the results of all together to a folder.

    Sampling settings take the place of the configurations' own; None: they stay. The workers of a Dask scheduler must
    see the same files; see `running.tasks.run_tasks`.

    Raises:
        InputError: The folder cannot be written to; no scheduler answers, or it was lost: finished studies are kept.
            Errors in one asset cost that asset alone.
    """
    with output_folder(place) as folder, stages(progress):
        known: dict[str, AssetResult] = {}
        failed: dict[str, str] = {}
        tasks: dict[str, tuple] = {}
        for asset in assets:
            asset_folder = folder.resolve() / ASSETS / asset.name
            try:
                mark = _mark(asset, sampling)
            except (InputError, OSError) as error:
                failed[asset.name] = str(error)
                continue
            put_back(asset_folder)
            before = _studied(asset_folder, mark)
            if before is None:
                tasks[asset.name] = (asset, str(asset_folder), dict(sampling), mark)
            else:
                known[asset.name] = AssetResult(before)
        order = [asset.name for asset in assets]
        fleet, _ = studied_together(study_asset, tasks, order, known, failed, workers=workers, scheduler=scheduler)
        if any(each.sentence == SCHEDULER_LOST for each in fleet.failed):
            raise InputError("The Dask scheduler was lost. What is done is kept: give the same command again.")
        for each in fleet.failed:
            set_aside(folder / ASSETS / each.asset)
        write_fleet(fleet, folder)
    return fleet


def study_asset(asset: Asset, place: str, sampling: Mapping[str, int | None], mark: str) -> AssetResult:
    """Study one asset, on whatever machine, and write its results, which `mark` identifies, to its folder."""
    folder = Path(place)
    study_into(asset.settings().with_settings("sampling", **sampling), folder, progress=False)
    text = (folder / RECORD_FILE).read_bytes()
    with staged(folder) as part:
        # Last, and with the digest of this record: results of another run in this folder are not taken for this one's.
        write_json(part / ASSET_MARK, {"of": mark, "record": hashlib.sha256(text).hexdigest()})
    return AssetResult(json.loads(text))


def _mark(asset: Asset, sampling: Mapping[str, int | None]) -> str:
    """Return a digest of configuration, data, catalogues, the sampler's settings and this version."""
    settings = asset.settings().with_settings("sampling", **sampling)
    digest = hashlib.sha256(settings.text.encode())
    folder = settings.origin.parent
    for file in (*settings.data.files(folder), *settings.study.files(folder)):
        # The study itself refuses a missing file.
        digest.update(hashlib.sha256(file.read_bytes() if file.is_file() else b"").digest())
    digest.update(json.dumps([settings.sampling.model_dump(), versions()], sort_keys=True).encode())
    return digest.hexdigest()


def _studied(folder: Path, mark: str) -> dict[str, Any] | None:
    """Return the record of an earlier study with this mark."""
    try:
        stored, text = (
            json.loads((folder / ASSET_MARK).read_text(encoding="utf-8")),
            (folder / RECORD_FILE).read_bytes(),
        )
        if stored != {"of": mark, "record": hashlib.sha256(text).hexdigest()}:
            return None
        return json.loads(text)
    except (OSError, ValueError):
        return None
