"""[data]: measurements from a table, a benchmark data set or a simulated system."""

import glob
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import Count, NotNegative, Positive, Seed, Whole

from .section import AlsoAs, Section, wrong

if TYPE_CHECKING:
    from bayes_greybox.data.streams.row_stream import RowStream
    from bayes_greybox.data.trajectories import Trajectories


class Differentiate(Section):
    """[data.differentiate]: arguments of `Trajectories.differentiate`."""

    method: Literal["savgol", "bandlimited", "spectral"] = "savgol"
    rates: dict[str, str] = {}
    window: Count | None = None
    polyorder: Count | None = None
    band: Positive | None = None
    white_share: Positive | None = None


class Source(Section, ABC):
    """Settings that every kind of [data] may have.

    Attributes:
        leave_out: Names of runs that are not used.
        resample: Spacing of even times at which samples are interpolated by a spline; see `Trajectories.resample`.
    """

    leave_out: list[Annotated[str, BeforeValidator(lambda v: str(v) if type(v) is int else v), AlsoAs((int,))]] = []
    resample: Positive | None = None
    differentiate: Differentiate | None = None
    test_fraction: Annotated[float, Field(ge=0.0, lt=1.0)] | None = None
    split_by: Literal["time", "trajectory"] = "time"

    @model_validator(mode="after")
    def _check_test(self) -> Any:
        if self.test_fraction and self.held_out:
            raise wrong("give either test_fraction or the table test, not both")
        if self.test_fraction is None and "split_by" in self.model_fields_set:
            raise wrong("split_by needs test_fraction, the share of the data to hold out")
        return self

    @property
    def held_out(self) -> bool:
        """True if there is a table [data.test]."""
        return getattr(self, "test", None) is not None

    @property
    def filter_settings(self) -> dict[str, Any] | None:
        """Arguments of `Trajectories.differentiate`; None where nothing is to be differentiated."""
        return None if self.differentiate is None else self.differentiate.given()

    def read(self, folder: Path) -> "tuple[Trajectories | RowStream, Trajectories | None]":
        """Return training data and, where the file asks for them, held-out data."""
        first: Any = self.load(folder, test=False)
        second = self.load(folder, test=True) if self.held_out else None
        if self.leave_out:
            first = first.leave_out(self.leave_out)
        if self.test_fraction:
            first, second = first.split(1.0 - self.test_fraction, by=self.split_by)
        if self.resample is not None:
            first, second = (None if part is None else part.resample(self.resample) for part in (first, second))
        settings = self.filter_settings
        if settings is not None:
            # After the split, because filtered rows share samples with their neighbours.
            first = first.differentiate(**settings)
            second = None if second is None else second.differentiate(like=first)
        return first, second

    def files(self, folder: Path) -> list[Path]:
        """List the files of measurements from this folder on; none where data are computed or packaged."""
        return []

    @abstractmethod
    def load(self, folder: Path, *, test: bool) -> "Trajectories":
        """Load the training or the held-out data as they are."""


class TableTest(Section):
    """[data.test] of a table: another file, or files, with the same columns."""

    path: Annotated[str | list[str], BeforeValidator(lambda v: _paths(v))]


STREAMING = ("sample", "workers", "scheduler")
STREAMED = (
    "path", "time", "states", "inputs", "derivatives", "outputs", "run", "trajectory", "restart", "units", "missing",
    "stream", "test", *STREAMING,
)  # fmt: skip
"""Keys of a table for rows in chunks only, and those that are allowed with them."""


class TableSource(Source):
    """[data] with path: arguments of `read`."""

    path: Annotated[str | list[str], BeforeValidator(lambda v: _paths(v))]
    time: str | None = None
    dt: Positive | None = None
    states: Annotated[list[str] | dict[str, str], BeforeValidator(lambda v: _names(v))]
    inputs: Annotated[list[str] | dict[str, str], BeforeValidator(lambda v: _names(v))] = []
    derivatives: dict[str, str] = {}
    outputs: Annotated[list[str] | dict[str, str], BeforeValidator(lambda v: _names(v))] = []
    run: str | None = None
    trajectory: str | None = None
    units: dict[str, str] = {}
    rates: dict[str, str] = {}
    missing: Literal["error", "drop"] = "error"
    constant: Literal["error", "keep"] = "error"
    restart: Literal["error", "run"] = "error"
    sep: str | None = None
    decimal: str = "."
    thousands: str | None = None
    skiprows: Whole | list[Whole] = 0
    encoding: str = "utf-8"
    sheet: str | Whole | None = None
    columns: list[str] | None = None
    dayfirst: bool | None = None
    stream: bool = False
    sample: Count | None = None
    workers: Count | None = None
    scheduler: str | None = None
    test: TableTest | None = None

    @model_validator(mode="after")
    def _check_keys_together(self) -> Any:
        if self.trajectory is not None and self.run is not None:
            raise wrong("run and trajectory are two names of one key; give run alone")
        if self.rates and self.differentiate is not None and self.differentiate.rates:
            raise wrong("rates stands in [data] and in [data.differentiate]; give it once")
        if self.stream:
            self._check_stream()
        elif alone := next((key for key in STREAMING if key in self.model_fields_set), None):
            raise wrong(f"{alone} is for rows that are read in chunks; give stream = true with it")
        return self

    def _check_stream(self) -> None:
        if self.test_fraction:
            raise wrong("a stream is not split: leave test_fraction out, and give held-out rows as [data.test] path")
        if beyond := next((key for key in self.model_fields_set if key not in STREAMED), None):
            raise wrong(f"{beyond} does not apply to rows that are read in chunks; leave it out, or leave out stream")
        if self.workers is not None and self.scheduler is not None:
            raise wrong("a scheduler has workers of its own; give scheduler or workers, not both")

    def require_equations(self, simulation: Iterable[str], sections: Mapping[str, Iterable[str]]) -> None:
        """Refuse data without a state or an output, and sections, by name, with an equation of an input."""
        if not (self.states or self.outputs):
            name = next(iter(simulation), "y")
            raise wrong(
                f'[data] has no state and no output: give states = ["{name}"] if [simulation] says the rate of '
                f'{name!r}, or outputs = ["{name}"] if it says {name!r} itself'
            )
        outside = set(self.inputs) - set(self._with_equations)
        for section, name in ((section, name) for section, names in sections.items() for name in names):
            if name in outside:
                raise wrong(
                    f"{section} still has a line for {name!r}, which [data] has among its inputs: what acts from "
                    "outside has no equation; delete that line"
                )

    def rate_without_equation(self, simulation: Mapping[str, str], learned: Iterable[str]) -> str:
        """Say that the simulation only names a rate, and nothing gives its equation; "" where that is not so."""
        known = {*self._with_equations, *self.inputs, *learned, *simulation, "t", "pi"}
        for state, formula in simulation.items():
            if formula.isidentifier() and formula not in known:
                return (
                    f"[simulation] says that the rate of {state!r} is {formula!r}, and not what the rate of "
                    f'{formula!r} is: add a line {formula} = "..." with what your simulation says'
                )
        return ""

    @property
    def _with_equations(self) -> list[str]:
        """States and outputs, and the rates that are computed to be states."""
        return [*self.states, *self.outputs, *((self.filter_settings or {}).get("rates") or {}).values()]

    @property
    def filter_settings(self) -> dict[str, Any] | None:
        """Arguments of `Trajectories.differentiate`; None where nothing is to be differentiated."""
        settings = super().filter_settings
        return settings if not self.rates else {**(settings or {}), "rates": self.rates}

    def files(self, folder: Path) -> list[Path]:
        """List the tables."""
        files = []
        paths = [self.path] if self.test is None else [self.path, self.test.path]
        for path in [each for some in paths for each in ([some] if isinstance(some, str) else some)]:
            # As they are read: a file of that very name first.
            whole = folder / path
            pattern = glob.has_magic(path) and not whole.exists()
            files += sorted(map(Path, glob.glob(str(_located(path, folder))))) if pattern else [whole]
        return files

    def load(self, folder: Path, *, test: bool) -> "Any":
        """Read the file, or open it as a stream."""
        from bayes_greybox.data.reading.door import read, require_computed

        # Rates are computed after the split; the key trajectory is older than run.
        settings = self.given(
            "path", "test", "test_fraction", "split_by", "differentiate", "rates", "resample", "leave_out", "trajectory"
        )
        if self.trajectory is not None:
            settings["run"] = self.trajectory
        path = self.path
        if test and self.test is not None:
            # Held-out runs may well have an input switched off.
            path, settings = self.test.path, {"constant": "keep", **settings}
        if self.stream and not test:
            from bayes_greybox.data.streams.door import stream

            return stream(_located(path, folder), **{key: settings[key] for key in settings if key != "stream"})
        settings = {key: value for key, value in settings.items() if key not in ("stream", *STREAMING)}
        located = _located(path, folder)
        if rates := (self.filter_settings or {}).get("rates"):
            require_computed(located, rates, settings)
        return read(located, **settings)


class DatasetTest(Section):
    """[data.test] of a benchmark data set: another part of it."""

    part: str


class DatasetSource(Source):
    """[data] with dataset: a benchmark data set, its part and its options (see `load_dataset`)."""

    dataset: str
    part: str | None = None
    options: dict[str, Any] = {}
    test: DatasetTest | None = None

    def load(self, folder: Path, *, test: bool) -> "Trajectories":
        """Load the part."""
        from bayes_greybox.data.datasets import load_dataset
        from bayes_greybox.data.trajectories import Trajectories

        loaded = load_dataset(self.dataset, **self.options)
        part = self.test.part if test and self.test is not None else self.part
        where = f"{'[data.test]' if test else '[data]'} the data set {self.dataset!r}"
        if not isinstance(loaded, dict):
            if part is not None:
                raise InputError(f"{where} has no parts; leave out part.")
            return loaded if isinstance(loaded, Trajectories) else loaded.data
        if part not in loaded:
            lacks = f"has no part {part!r}" if part is not None else "comes in parts"
            raise InputError(f"{where} {lacks}; set part to one of {', '.join(loaded)}.")
        return loaded[part]


class TimeRange(Section):
    """Evenly spaced times from start to stop, both included."""

    start: float = 0.0
    stop: float
    points: Annotated[int, Field(ge=4)]


class Sampled(Section):
    """Arguments of `System.simulate`."""

    t: TimeRange | None = None
    x0: Annotated[Any, BeforeValidator(lambda v: _start(v))] = None
    noise: NotNegative = 0.0
    noise_on: Literal["derivatives", "states", "both"] = "derivatives"
    seed: Seed = 0


class SystemTest(Sampled):
    """[data.test] of a simulated system: settings that differ from the training data."""


class SystemSource(Source, Sampled):
    """[data] with system: data simulated from a system of `bayes_greybox.systems`."""

    system: Literal["duffing", "lotka_volterra", "oscillator", "pendulum", "two_tanks", "van_der_pol"]
    parameters: dict[str, float] = {}
    test: SystemTest | None = None

    def load(self, folder: Path, *, test: bool) -> "Trajectories":
        """Simulate the system."""
        import inspect

        import numpy as np

        from bayes_greybox.physics.experiments import systems

        build = getattr(systems, self.system)
        known = list(inspect.signature(build).parameters)
        other = next((name for name in self.parameters if name not in known), None)
        if other is not None:
            raise InputError(f"[data.parameters] {self.system} has no parameter {other!r}; it has {', '.join(known)}.")
        settings = {name: getattr(self, name) for name in Sampled.model_fields}
        if test and self.test is not None:
            settings |= {name: getattr(self.test, name) for name in self.test.model_fields_set}
        t = settings.pop("t")
        times = None if t is None else np.linspace(t.start, t.stop, t.points)
        return build(**self.parameters).simulate(times, **settings)


def _kinds(given: Any) -> list[str]:
    keys = given if isinstance(given, Mapping) else type(given).model_fields
    return [kind for kind in ("path", "dataset", "system") if kind in keys]


def _check_kind(given: Any) -> Any:
    if isinstance(given, Source) or (isinstance(given, Mapping) and len(_kinds(given)) == 1):
        return given
    raise wrong("should be a table with exactly one of path (a file), dataset (a benchmark) and system (a simulation)")


def _paths(value: Any) -> Any:
    if isinstance(value, str) or (isinstance(value, list) and value and all(isinstance(item, str) for item in value)):
        return value
    raise wrong('should be the path of a file, a pattern such as "run*.csv", or a list of paths')


def _located(path: str | list[str], folder: Path) -> Any:
    """Return paths from the folder of the configuration file, which is no pattern even if its name looks like one."""
    if isinstance(path, list):
        return [_located(each, folder) for each in path]
    return folder / path if not glob.has_magic(path) else str(Path(glob.escape(str(folder))) / path)


def _names(value: Any) -> Any:
    items = value.values() if isinstance(value, dict) else value
    if isinstance(value, list | dict) and all(isinstance(item, str) for item in items):
        return value
    raise wrong('should be a list of column names, such as ["y"], or a table of name = "column"')


def _start(value: Any) -> Any:
    rows = value if isinstance(value, list) and value and isinstance(value[0], list | dict) else [value]
    rows = [list(row.values()) if isinstance(row, dict) else row for row in rows]
    if all(isinstance(row, list) and row and all(type(x) in (int, float) for x in row) for row in rows):
        return value
    raise wrong("should be a list of numbers, one for each state, or a list of such lists, one for each run")


Data = Annotated[
    Annotated[TableSource, Tag("<path>")]
    | Annotated[DatasetSource, Tag("<dataset>")]
    | Annotated[SystemSource, Tag("<system>")],
    Discriminator(lambda given: f"<{_kinds(given)[0]}>"),
    BeforeValidator(_check_kind),
]
