"""Fleets in Python: find_missing_effects_of_fleet, and FleetStudy, its result."""

import inspect
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from bayes_greybox.data.reading.door import read as read_file
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.fleet.shared import Fleet
from bayes_greybox.discovery.subject import check_settings
from bayes_greybox.fleet.reporting import ASSETS, AssetResult, studied_together, write_fleet
from bayes_greybox.greybox import GreyBox
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.missing_effects import Study, find_missing_effects, load
from bayes_greybox.physics.catalogue.effect_tables import nearest
from bayes_greybox.physics.catalogue.loading import load_catalogue, located
from bayes_greybox.report.folders.holding import require_own
from bayes_greybox.report.folders.study_record import study_record
from bayes_greybox.report.folders.writing import output_folder, staged
from bayes_greybox.report.words.fleet import fleet_sentence
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import is_finite
from bayes_greybox.running.stages import stages

from .assets import alike, data_files, require_one_each
from .reporting import STUDY, remove_results, report_into, set_aside

Measured = Trajectories | str | os.PathLike[str]
"""Measurements of an asset, or the file that they are read from where they are studied."""

SAMPLER_SETTINGS = ("draws", "tune", "chains", "seed")

FORBIDDEN, MOST_BYTES = '/\\<>:"|?*', 255
"""Characters that the name of a folder cannot have on every system, and its most bytes."""


@dataclass(frozen=True, repr=False)
class FleetStudy:
    """Effects that many assets lack under one description, each and together.

    The coefficient of an effect is pooled over the assets that surely lack it, from each one's posterior mean b and
    standard deviation s:

        b_i ~ N(β_i, s_i²),   β_i ~ N(μ, τ²),   p(μ) ∝ 1,   τ = 0 or τ ~ HalfNormal(r/3), evenly

    with r the RMS of the b_i, or the smallest s_i where that is larger

    (Gelman et al. 2013, Bayesian Data Analysis, 3rd ed., section 5.4). Nothing is pooled where nonlinear parameters or
    units differ.

    Attributes:
        failed: Reason why an asset could not be studied, by asset.
    """

    failed: Mapping[str, str]
    _fleet: Fleet
    _studies: "_Studies"

    @property
    def studies(self) -> Mapping[str, Study]:
        """Studies by asset, as `bg.load` reads them, each when it is first asked for; without those that failed."""
        return self._studies

    @property
    def sentence(self) -> str:
        """A sentence with the number of assets that lack each effect, and whether that is one cause."""
        return fleet_sentence(self._fleet)

    @property
    def assets(self) -> pd.DataFrame:
        """Assets, the largest gap first: verdict, lacks, may_lack, gap, left, sentence, converged; failed ones last.

        `may_lack` are effects that were added to an asset's model though its study is not sure of them (*one of*, or a
        probability below 0.9). `gap` and `left` are the unexplained shares before and after, of held-out data where
        there are any.
        """
        return self._fleet.table()

    @property
    def coefficients(self) -> pd.DataFrame:
        """Pooled coefficients by (equation, slug, expression), effects that most assets lack first.

        `mean`, `sd`, `lower`, `upper` are of μ, `between`, `between_lower`, `between_upper` the median and interval of
        τ, and `same` is P(τ = 0): one coefficient for all. They are NaN where nothing is pooled; intervals hold 90 %.
        `assets` are those that surely lack the effect, `possible` those that may, and `likely` the probability of it in
        each of the possible to whose model it was added. In `expression` nonlinear parameters that differ are names.
        """
        pooled = ("mean", "sd", "lower", "upper", "between", "between_lower", "between_upper", "same")
        rows = [
            {
                "equation": each.equation, "slug": each.slug, "expression": each.expression, "name": each.name,
                "assets": each.assets, "possible": each.possible, "likely": dict(each.likely),
                **{key: getattr(each.whole, key, float("nan")) for key in pooled}, "unit": each.unit,
            }
            for each in self._fleet.shared
        ]  # fmt: skip
        keys = ["equation", "slug", "expression"]
        columns = [*keys, "name", "assets", "possible", *pooled, "unit", "likely"]
        return pd.DataFrame(rows, columns=columns).set_index(keys)

    @property
    def by_asset(self) -> pd.DataFrame:
        """Coefficients by (equation, slug, expression, asset), of effects that the asset surely lacks.

        `expression` and `unit` are the asset's own. `mean` and `sd` are of its own data, `pooled_mean` and `pooled_sd`
        of all data together, NaN where nothing is pooled.
        """
        rows = []
        for each in self._fleet.shared:
            none = (float("nan"),) * len(each.assets)
            whole = (none, none) if each.whole is None else (each.whole.each, each.whole.each_sd)
            estimates = zip(each.expressions, each.assets, each.mean, each.sd, *whole, each.units, strict=True)
            rows += [(each.equation, each.slug, *values) for values in estimates]
        keys = ["equation", "slug", "expression", "asset"]
        columns = [*keys, "mean", "sd", "pooled_mean", "pooled_sd", "unit"]
        return pd.DataFrame(rows, columns=columns).set_index(keys)

    def to_html(self, path: str | os.PathLike[str]) -> None:
        """Write the report of all assets as one self-contained page; `save` writes those of the assets too.

        Raises:
            InputError: The destination cannot be written.
        """
        # Matplotlib is imported only where a page is wanted.
        from bayes_greybox.report.pages.fleet_page import fleet_html

        fleet_html(self._fleet, path)

    def save(self, folder: str | os.PathLike[str], *, figures: bool = False, progress: bool = True) -> None:
        """Write the files of `bayes-greybox discover --fleet`: fleet.html, assets.csv, summary.json and assets/NAME.

        Studies that another fleet left in assets/NAME are removed. Files that are no study's stay, and earlier results
        of an asset that failed in this fleet are kept under other names.

        Args:
            folder: Folder for the results.
            figures: If true, each asset's figures are drawn as files too; its page, gap.html, has them anyway.
            progress: If true, progress is shown.

        Raises:
            InputError: The folder cannot be written to, or holds results of another command.
        """
        require_own(Path(folder), "fleet")
        with output_folder(folder) as place, stages(progress):
            for own in (place / ASSETS).glob("*"):
                if own.name in self.failed:
                    # Results of an earlier run are none of this one's, and may be all there is.
                    set_aside(own)
                elif own.name not in self._studies.results:
                    remove_results(own)
            for name, result in self._studies.results.items():
                with staged(place) as part:
                    own = part / ASSETS / name
                    own.mkdir(parents=True)
                    (own / STUDY).write_bytes(result.study_file)
                report_into(place / ASSETS / name, self._studies.read(name), result.record, figures)
            write_fleet(self._fleet, place)

    def __repr__(self) -> str:
        """Return the sentence, and all assets by their gap."""
        with pd.option_context("display.width", 160, "display.max_columns", 40, "display.max_colwidth", 60):
            table = self.assets[["verdict", "lacks", "may_lack", "gap", "left"]].round(3).to_string()
        reasons = [f"{name} could not be studied: {reason}" for name, reason in self.failed.items()]
        return "\n".join([f"FleetStudy: {self.sentence}", table, *reasons])


def find_missing_effects_of_fleet(
    model: GreyBox | Mapping[str, GreyBox],
    train: Mapping[str, Measured] | str | os.PathLike[str],
    test: Mapping[str, Measured] | float | None = None,
    *,
    read: Callable[[Path], Trajectories] = read_file,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: bool = True,
    **settings: Any,
) -> FleetStudy:
    """Find what one simulation lacks of many machines: each one's study, and whether the missing effects are one cause.

    Each asset is studied by `find_missing_effects`, independently of the others; then coefficients are pooled, see
    `FleetStudy`. Results do not depend on where or in which order assets are studied. Nothing is kept before
    all are done; if a Dask scheduler is lost, the finished studies are returned. `bayes-greybox discover --fleet`
    keeps each study, and goes on where it was.

    Args:
        model: The simulation, and terms whose coefficients are to be learned; for all assets, or one for each by name.
        train: Measurements by asset, or files of these, or a folder with a file for each asset. A file is read where
            the asset is studied, and one that cannot be read costs that asset alone.
        test: Held-out data by asset, for some or all; or the share at the end of each asset's that is held out.
        read: Function from the path of a file to its measurements, such as
            `functools.partial(bg.read, time="t", states=["y"], inputs=["F"])`.
        workers: Processes of this machine, each of which studies one asset at a time; if left out assets are studied
            here, one after another. A script with workers needs `if __name__ == "__main__":`.
        scheduler: Address of a Dask scheduler in the place of workers, such as "tcp://host:8786".
        progress: If true, progress is shown.
        **settings: Arguments of `find_missing_effects` but for its checkpoints: catalogue, roles, seed,
            effects_at_most, odds, settle, free_runs, interpolation, draws, tune, chains.

    Raises:
        InputError: There are no assets, or no measurements; a name cannot be a folder's; an asset has no model, or
            held-out data belong to none; a setting is unknown, or a catalogue or sampling cannot be used; there is no
            Dask, or no scheduler answers. Data that cannot be used cost their asset alone: see `FleetStudy.failed`.
    """
    assets = _by_name(train)
    models = {name: _model_of(model, name) for name in assets}
    held_out = _held_out(test, assets)
    settings = _checked(settings)
    tasks = {name: (models[name], each, held_out.get(name), read, settings) for name, each in assets.items()}
    with stages(progress):
        # By default assets are studied here: a script that starts processes has to be written for it.
        workers = workers if scheduler is not None else workers or 1
        fleet, results = studied_together(_study, tasks, list(assets), workers=workers, scheduler=scheduler)
    failed = {each.asset: each.sentence for each in fleet.failed}
    return FleetStudy(failed, fleet, _Studies(results, models))


class _Studies(Mapping[str, Study]):
    """Studies by asset, read from the workers' results when they are asked for."""

    def __init__(self, results: Mapping[str, AssetResult], models: Mapping[str, GreyBox]) -> None:
        self.results, self._models = results, models
        self._kept: dict[str, Study] = {}

    def __getitem__(self, name: str) -> Study:
        return self._kept.setdefault(name, self.read(name))

    def read(self, name: str) -> Study:
        """Read one study without keeping it, unless it was asked for before: many may exceed the memory."""
        if name in self._kept:
            return self._kept[name]
        content, simulation = self.results[name].study_file, self._models[name].simulation
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / STUDY
            file.write_bytes(content)
            return load(file, None if isinstance(simulation, Mapping) else simulation)

    def __iter__(self) -> Iterator[str]:
        return iter(self.results)

    def __len__(self) -> int:
        return len(self.results)


def _study(
    model: GreyBox, train: Measured, test: Measured | float | None, read: Callable[[Path], Trajectories],
    settings: Mapping[str, Any],
) -> AssetResult:  # fmt: skip
    """Study one asset, on whatever machine."""
    data = train if isinstance(train, Trajectories) else read(Path(train))
    held_out = read(Path(test)) if isinstance(test, str | os.PathLike) else test
    if isinstance(held_out, int | float):
        data, held_out = data.split(1.0 - held_out)
    study = find_missing_effects(model, data, held_out, progress=False, **settings)
    sampling = {key: settings[key] for key in SAMPLER_SETTINGS}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / STUDY
        study.save(file)
        # Plain values as in a file: a worker may be another machine.
        return AssetResult(json.loads(json.dumps(study_record(study, sampling))), file.read_bytes())


def _by_name(train: Any) -> dict[str, Measured]:
    """Return measurements by asset."""
    if isinstance(train, str | os.PathLike):
        files = data_files(Path(train))
        require_one_each(Path(train), [file.stem for file in files])
        return {file.stem: file for file in files}
    if not isinstance(train, Mapping):
        raise InputError(
            f"train is {type(train).__name__}, which says no names of assets: give data by asset, such as "
            "train={'pump 1': data}, or a folder of files."
        )
    if not train:
        raise InputError("A fleet needs an asset: give measurements by name, such as {'pump 1': data}.")
    for name in train:
        if not isinstance(name, str) or not name.isprintable() or name in ("", ".", "..") or set(name) & set(FORBIDDEN):
            raise InputError(f"The asset name {name!r} cannot be a folder's: give text without {' '.join(FORBIDDEN)}.")
        if len(name.encode()) > MOST_BYTES:
            raise InputError(f"The asset name {name!r} is too long for a folder's: give {MOST_BYTES} bytes at most.")
    twice = alike(list(train))
    if twice is not None:
        raise InputError(
            f"The asset names {twice[0]!r} and {twice[1]!r} are one folder where capitals do not count: rename one."
        )
    return _located("train", train)


def _model_of(model: Any, name: str) -> GreyBox:
    if isinstance(model, Mapping):
        if name not in model:
            raise InputError(f"There is no model for {name!r}: give one for each asset, or one for all.")
        model = model[name]
    if not isinstance(model, GreyBox):
        raise InputError(f"The model of {name!r} is {type(model).__name__}: give a GreyBox, or one for each asset.")
    return model


def _held_out(test: Any, assets: Mapping[str, Measured]) -> Mapping[str, Measured | float]:
    if test is None:
        return {}
    if isinstance(test, Mapping):
        if other := [name for name in test if name not in assets]:
            raise InputError(f"test has data of {other[0]!r}, which is no asset: give names that train has.")
        return _located("test", test)
    if not is_finite(test):
        raise InputError(
            f"test is {type(test).__name__}, which does not say of which asset: give data by asset, such as "
            "test={'pump 1': data}, or a share of all, such as test=0.3."
        )
    if not 0 < test < 1:
        raise InputError(f"test={test!r} is no share of the data to hold out: give one between 0 and 1.")
    return dict.fromkeys(assets, float(test))


def _located(what: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return measurements, or files by absolute paths, because a worker may run in another folder."""
    for name, each in given.items():
        if not isinstance(each, Trajectories | str | os.PathLike):
            raise InputError(
                f"{what} has {type(each).__name__} for {name!r}: give Trajectories, as bg.read and "
                "Trajectories.from_arrays make them, or the path of a file."
            )
    return {name: each if isinstance(each, Trajectories) else Path(each).absolute() for name, each in given.items()}


def _checked(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return all settings of a study; errors in these are no fault of any asset's."""
    usual = {
        name: each.default
        for name, each in inspect.signature(find_missing_effects).parameters.items()
        if each.kind is each.KEYWORD_ONLY and name not in ("progress", "checkpoint", "resume", "checkpoint_every")
    }
    if unknown := [name for name in settings if name not in usual]:
        raise InputError(f"There is no setting {unknown[0]!r} of a fleet's studies; {nearest(unknown[0], list(usual))}")
    every = {**usual, **settings}
    Sampling(**{name: every[name] for name in SAMPLER_SETTINGS})
    check_settings(every["effects_at_most"], every["negligible"], every["odds"], every["interpolation"])
    load_catalogue(every["catalogue"])
    return {**every, "catalogue": located(every["catalogue"])}
