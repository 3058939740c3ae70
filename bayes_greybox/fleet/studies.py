"""One simulation and many machines in Python's hands: find_missing_effects_of_fleet, and FleetStudy, its result."""

import inspect
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd

from bayes_greybox.data.reading.door import read as read_file
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.fleet.shared import Fleet
from bayes_greybox.discovery.refusals import check_settings
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

from .files import alike, data_files, require_one_each
from .reporting import STUDY, remove_results, report_into, set_aside
from .together import ASSETS, Told, studied_together, write_fleet

Measured = Trajectories | str | os.PathLike[str]
"""Measurements of an asset, or the file that they are read from where they are studied."""

SAMPLING = ("draws", "tune", "chains", "seed")
"""Settings of the sampler."""

NO_NAME, LONGEST = '/\\<>:"|?*', 255
"""Characters that the name of a folder has on no system, or not on all, and its most bytes."""


@dataclass(frozen=True, repr=False)
class FleetStudy:
    """What many assets lack under one description, each and together.

    The coefficient of an effect is pooled over the assets that surely lack it, from each one's posterior mean b and
    standard deviation s:

        b_i ~ N(β_i, s_i²),   β_i ~ N(μ, τ²),   p(μ) ∝ 1,   τ = 0 or τ ~ HalfNormal(r/3), evenly

    with r the RMS of the b_i, or the smallest s_i where that is larger

    (Gelman et al. 2013, Bayesian Data Analysis, 3rd ed., section 5.4). Nothing is pooled where inner parameters or
    units differ.

    Attributes:
        failed: Why an asset could not be studied, by asset.
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
        """How many assets lack what, and whether that is one cause."""
        return fleet_sentence(self._fleet)

    @property
    def assets(self) -> pd.DataFrame:
        """Assets, the largest gap first: verdict, lacks, may_lack, gap, left, sentence, converged; failed ones last.

        `may_lack` is what was added to an asset's model though its study is not sure of it (*one of*, or a probability
        below 0.9). `gap` and `left` are the unexplained shares before and after, of held-out data where there are any.
        """
        return self._fleet.table()

    @property
    def coefficients(self) -> pd.DataFrame:
        """Pooled coefficients by (equation, slug, expression), effects that most assets lack first.

        `mean`, `sd`, `lower`, `upper` are of μ, `between`, `between_lower`, `between_upper` the median and interval of
        τ, and `same` is P(τ = 0): one coefficient for all. They are NaN where nothing is pooled; intervals hold 90 %.
        `assets` are those that surely lack the effect, `possible` those that may, and `likely` the probability of it in
        each of the possible to whose model it was added. In `expression` inner parameters that differ have their names.
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
        what it is once all are known, NaN where nothing is pooled.
        """
        rows = []
        for each in self._fleet.shared:
            none = (float("nan"),) * len(each.assets)
            whole = (none, none) if each.whole is None else (each.whole.each, each.whole.each_sd)
            own = zip(each.expressions, each.assets, each.mean, each.sd, *whole, each.units, strict=True)
            rows += [(each.equation, each.slug, *values) for values in own]
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
        """Write what `bayes-greybox discover --fleet` writes: fleet.html, assets.csv, summary.json and assets/NAME.

        Studies that another fleet left in assets/NAME are removed; files that are no study's stay, and what an earlier
        run found of an asset that failed in this fleet is kept under other names.

        Args:
            folder: Folder for the results.
            figures: Whether to draw each asset's figures as files too; its page, gap.html, has them anyway.
            progress: Whether to show what is being done.

        Raises:
            InputError: The folder cannot be written to, or holds results of another command.
        """
        require_own(Path(folder), "fleet")
        with output_folder(folder) as place, stages(progress):
            for own in (place / ASSETS).glob("*"):
                if own.name in self.failed:
                    # What an earlier run found of it is no result of this one, and may be all there is.
                    set_aside(own)
                elif own.name not in self._studies.told:
                    remove_results(own)
            for name, told in self._studies.told.items():
                with staged(place) as part:
                    own = part / ASSETS / name
                    own.mkdir(parents=True)
                    (own / STUDY).write_bytes(told.kept)
                report_into(place / ASSETS / name, self._studies.read(name), told.record, figures)
            write_fleet(self._fleet, place)

    def __repr__(self) -> str:
        """The sentence, and all assets by their gap."""
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
    """Find what one simulation lacks of many machines: each one's study, and whether what they lack is one cause.

    Each asset is studied by `find_missing_effects`, whatever the others say; then coefficients are pooled, see
    `FleetStudy`. What comes of it does not depend on where or in which order assets are studied. Nothing is kept before
    all are done; of a Dask scheduler that is lost those come back that were done. `bayes-greybox discover --fleet`
    keeps each study, and goes on where it was.

    Args:
        model: The simulation, and terms whose coefficients are to be learned; for all assets, or one for each by name.
        train: Measurements by asset, or files of these, or a folder with a file for each asset. A file is read where
            the asset is studied, and one that cannot be read costs that asset alone.
        test: Held-out data by asset, for some or all; or the share at the end of each asset's that is held out.
        read: From the path of a file to its measurements, such as
            `functools.partial(bg.read, time="t", states=["y"], inputs=["F"])`.
        workers: Processes of this machine, each of which studies one asset at a time; if left out assets are studied
            here, one after another. A script with workers needs `if __name__ == "__main__":`.
        scheduler: Address of a Dask scheduler in the place of workers, such as "tcp://host:8786".
        progress: Whether to show progress.
        **settings: Of `find_missing_effects` but for its checkpoints: catalogue, roles, seed, effects_at_most, odds,
            settle, free_runs, interpolation, draws, tune, chains.

    Raises:
        InputError: No assets, or what is no measurements; a name that no folder can have; an asset without a model, or
            held-out data of none; a setting that there is not, or a catalogue or sampling that cannot be; no Dask, or
            no scheduler answers. Data that cannot be used cost their asset alone: see `FleetStudy.failed`.
    """
    assets = _by_name(train)
    models = {name: _model_of(model, name) for name in assets}
    held_out = _held_out(test, assets)
    settings = _checked(settings)
    tasks = {name: (models[name], each, held_out.get(name), read, settings) for name, each in assets.items()}
    with stages(progress):
        # Without a wish they are studied here: a script that starts processes has to be written for it.
        workers = workers if scheduler is not None else workers or 1
        fleet, told = studied_together(_study, tasks, list(assets), workers=workers, scheduler=scheduler)
    failed = {each.asset: each.sentence for each in fleet.failed}
    return FleetStudy(failed, fleet, _Studies(told, models))


class _Studies(Mapping[str, Study]):
    """Studies by asset, read from what workers sent when they are asked for."""

    def __init__(self, told: Mapping[str, Told], models: Mapping[str, GreyBox]) -> None:
        self.told, self._models = told, models
        self._kept: dict[str, Study] = {}

    def __getitem__(self, name: str) -> Study:
        if name not in self._kept:
            self._kept[name] = self.read(name)
        return self._kept[name]

    def read(self, name: str) -> Study:
        """One that is not kept, unless it was asked for before: many together may be more than the memory holds."""
        if name in self._kept:
            return self._kept[name]
        kept, simulation = self.told[name].kept, self._models[name].simulation
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / STUDY
            file.write_bytes(kept)
            return load(file, None if isinstance(simulation, Mapping) else simulation)

    def __iter__(self) -> Iterator[str]:
        return iter(self.told)

    def __len__(self) -> int:
        return len(self.told)


def _study(
    model: GreyBox, train: Measured, test: Measured | float | None, read: Callable[[Path], Trajectories],
    settings: Mapping[str, Any],
) -> Told:  # fmt: skip
    """One asset's study, on whatever machine."""
    data, held_out = _measured(train, read), None
    if isinstance(test, int | float):
        data, held_out = data.split(1.0 - test)
    elif test is not None:
        held_out = _measured(test, read)
    study = find_missing_effects(model, data, held_out, progress=False, **settings)
    sampling = {key: settings[key] for key in SAMPLING}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / STUDY
        study.save(file)
        # As a file of records has it: a worker may be another machine.
        return Told(json.loads(json.dumps(study_record(study, sampling))), file.read_bytes())


def _by_name(train: Any) -> dict[str, Measured]:
    """Measurements by asset.

    Raises:
        InputError: There are none; a name that is no folder's; what is no measurements.
    """
    if isinstance(train, str | os.PathLike):
        folder = Path(train)
        files = data_files(folder)
        require_one_each(folder, [file.stem for file in files])
        return {file.stem: file for file in files}
    if not isinstance(train, Mapping):
        raise InputError(
            f"train is {type(train).__name__}, which says no names of assets: give data by asset, such as "
            "train={'pump 1': data}, or a folder of files."
        )
    if not train:
        raise InputError("A fleet needs an asset: give measurements by name, such as {'pump 1': data}.")
    for name in train:
        if not isinstance(name, str) or not name.isprintable() or name in ("", ".", "..") or set(name) & set(NO_NAME):
            raise InputError(f"The asset name {name!r} cannot be a folder's: give text without {' '.join(NO_NAME)}.")
        if len(name.encode()) > LONGEST:
            raise InputError(f"The asset name {name!r} is too long for a folder's: give {LONGEST} bytes at most.")
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
        other = next((name for name in test if name not in assets), None)
        if other is not None:
            raise InputError(f"test has data of {other!r}, which is no asset: give names that train has.")
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
    """Measurements, or files whose paths hold in whatever folder a worker runs."""
    found: dict[str, Any] = {}
    for name, each in given.items():
        if not isinstance(each, Trajectories | str | os.PathLike):
            raise InputError(
                f"{what} has {type(each).__name__} for {name!r}: give Trajectories, as bg.read and "
                "Trajectories.from_arrays make them, or the path of a file."
            )
        found[name] = each if isinstance(each, Trajectories) else Path(each).absolute()
    return found


def _measured(given: Measured, read: Callable[[Path], Trajectories]) -> Trajectories:
    return given if isinstance(given, Trajectories) else read(Path(given))


def _checked(settings: Mapping[str, Any]) -> dict[str, Any]:
    """All settings of a study: what is wrong with them is no fault of any asset's."""
    usual = _usual_settings()
    unknown = next((name for name in settings if name not in usual), None)
    if unknown is not None:
        raise InputError(f"There is no setting {unknown!r} of a fleet's studies; {nearest(unknown, list(usual))}")
    found = {**usual, **settings}
    Sampling(**{name: found[name] for name in SAMPLING})
    check_settings(found["effects_at_most"], found["negligible"], found["odds"], found["interpolation"])
    load_catalogue(found["catalogue"])
    return {**found, "catalogue": located(found["catalogue"])}


@cache
def _usual_settings() -> Mapping[str, Any]:
    """Settings of a study, with what they are where nothing is said."""
    return {
        name: each.default
        for name, each in inspect.signature(find_missing_effects).parameters.items()
        if each.kind is each.KEYWORD_ONLY and name not in ("progress", "checkpoint", "resume", "checkpoint_every")
    }
