"""Studies of a configuration, and of a fleet: each asset's results in a folder of its own, those of all above them."""

import hashlib
import json
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from bayes_greybox.config import Config
from bayes_greybox.discovery.fleet.shared import Fleet
from bayes_greybox.fleet.assets import Asset
from bayes_greybox.inference.checkpoint import Checkpoint
from bayes_greybox.inference.kept.netcdf import versions
from bayes_greybox.missing_effects import Study, find_missing_effects
from bayes_greybox.report.folders.holding import RECORD_FILE
from bayes_greybox.report.folders.record import write_json
from bayes_greybox.report.folders.study_record import study_record
from bayes_greybox.report.folders.writing import output_folder, staged
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.stages import stage, stages
from bayes_greybox.running.tasks import SCHEDULER_LOST

from .reporting import ASSETS, MARK, STUDY, AssetResult, put_back, report_into, set_aside, studied_together, write_fleet


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
        write_json(part / MARK, {"of": mark, "record": hashlib.sha256(text).hexdigest()})
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
        stored = json.loads((folder / MARK).read_text(encoding="utf-8"))
        text = (folder / RECORD_FILE).read_bytes()
        if stored != {"of": mark, "record": hashlib.sha256(text).hexdigest()}:
            return None
        return json.loads(text)
    except (OSError, ValueError):
        return None


def study_into(
    settings: Config,
    place: Path,
    *,
    progress: bool = True,
    on_study: Callable[[Study], None] = lambda _: None,
    checkpoint_for: Callable[[Path], AbstractContextManager[Checkpoint]] | None = None,
) -> Study:
    """Study what the simulation of a configuration misses, and write the results to a folder.

    `on_study` is called with the study before its page is drawn. `checkpoint_for` returns the checkpoint in a folder
    for the draws, which is complete once all is written; None: none is kept.
    """
    with ExitStack() as work:
        # The verdict is shown once, by `on_study`.
        with stages(progress, answers=False):
            with stage("Starting", said=False):
                folder = work.enter_context(output_folder(place))
                arguments = settings.study_arguments()
                model = settings.build_studied_model()
                train, test = settings.read_data()
                checkpoint = None if checkpoint_for is None else work.enter_context(checkpoint_for(folder))
            study = find_missing_effects(model, train, test, **arguments, progress=progress, checkpoint=checkpoint)
            # An asset's folder has its name; a configuration may be that of many.
            name = place.name if place.parent.name == ASSETS else settings.origin.stem
            named = {**study.settings, "name": name, "configuration": settings.file}
            study = replace(study, config=settings.text, settings=named)
            with stage("Saving the study"), staged(folder) as part:
                # First, by itself: no later failure may cost the draws.
                study.save(part / STUDY)
                settings.copy_to(folder, part)
        on_study(study)
        with stages(progress):
            record = study_record(study, settings.sampling.model_dump())
            report_into(folder, study, {"config": settings.file, **record}, settings.output.figures)
        if checkpoint is not None:
            checkpoint.complete()
    return study
