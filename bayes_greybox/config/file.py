"""The whole configuration file: sections, and the objects that are built from them."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import PlainValidator, PrivateAttr, ValidationError, field_validator, model_validator

from bayes_greybox.data.reading.toml_files import read_toml
from bayes_greybox.report.folders.holding import CONFIG, author_text, command_of, copy_of
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import Count, NotNegative, Positive, Probability, Seed, Whole

from . import parts
from .section import AlsoAs, Section, sentences, wrong
from .sources import Data, TableSource

if TYPE_CHECKING:
    from bayes_greybox.data.streams.row_stream import RowStream
    from bayes_greybox.data.trajectories import Trajectories
    from bayes_greybox.greybox import GreyBox


def _fit_or_positive(value: Any) -> Any:
    if value == "fit" or (isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf):
        return value
    raise wrong('cannot be used; it must be "fit" or a number above 0')


FitOrPositive = Annotated[Any, PlainValidator(_fit_or_positive), AlsoAs((Literal["fit"], Positive), only=True)]


class Noise(Section):
    """[noise]: the measurement noise of the derivatives, over the RMS of the target (see `GreyBox` and `Noise`)."""

    floor: Positive | None = None
    scale: Positive | None = None
    correlation: FitOrPositive = None
    depends_on: str | None = None
    tails: FitOrPositive = None
    force: Literal["fit"] | None = None

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `GreyBox` for the keys that the file has."""
        given = self.given()
        arguments = {"noise_floor": given.pop("floor")} if "floor" in given else {}
        if set(given) - {"scale"}:
            from bayes_greybox.model.noise import asked as noise

            arguments["noise"] = noise.Noise(**given)
        elif given:
            arguments["noise"] = given["scale"]
        return arguments


class Sampling(Section):
    """[sampling]: arguments of `GreyBox.fit`."""

    draws: Count = 1000
    tune: Whole = 1000
    chains: Count = 4
    seed: Seed = 0
    target_accept: Probability = 0.9


class Output(Section):
    """[output]: the place of results, relative to the folder that the command is run in.

    Attributes:
        checkpoint_every: Seconds between two checkpoints of the draws.
    """

    folder: str | None = None
    figures: bool = True
    checkpoint_every: NotNegative = 10.0


class Compare(Section):
    """[compare]: the arguments of `compare`."""

    scheme: Literal["loo", "block", "trajectory", "future"] = "loo"
    block: Count | None = None
    start: Probability | None = None
    max_refits: Whole | None = None

    @model_validator(mode="after")
    def _check_start(self) -> Any:
        if self.start is not None and self.scheme != "future":
            raise wrong('start applies to scheme = "future" only; leave it out')
        return self


class Model(Section):
    """[models.NAME]: the sections in which one model of a comparison differs from the file's own."""

    dictionary: parts.Dictionary | None = None
    coefficients: parts.Coefficients | None = None
    prior: parts.Prior = None
    discrepancy: parts.Discrepancy = None


class Config(Section):
    """A configuration file, checked; read one with `load_config`.

    Attributes:
        copied_from: Original of a copy beside results: relative paths start from its folder.
        asset: File that a copy beside results of a fleet's asset reads in place of [data] path, from the folder of the
            copy.
    """

    copied_from: str | None = None
    asset: str | None = None
    data: Data
    simulation: parts.Simulation = {}
    parameters: parts.Parameters = {}
    starts: parts.Starts = {}
    dictionary: parts.Dictionary = {}
    coefficients: parts.Coefficients = {}
    prior: parts.Prior = None
    discrepancy: parts.Discrepancy = None
    rows: parts.Rows = None
    noise: Noise = Noise()
    sampling: Sampling = Sampling()
    output: Output = Output()
    compare: Compare = Compare()
    study: parts.Study = parts.Study()
    next: parts.Next = parts.Next()
    models: dict[str, Model] = {}

    _path: Path = PrivateAttr(default=Path("config.toml"))
    _text: str = PrivateAttr(default="")
    _asset: Path | None = PrivateAttr(default=None)

    @field_validator("models")
    @classmethod
    def _check_models(cls, models: dict[str, Model]) -> dict[str, Model]:
        for name in models:
            if not name.strip() or name.startswith(".") or set(name) & set('/\\:*?"<>|\0'):
                raise wrong(f"{name!r} cannot name a model, because files are named after it")
        return models

    @model_validator(mode="after")
    def _check_parts(self) -> Any:
        if self.asset is not None and self.copied_from is None:
            raise wrong("asset stands in copies beside results of a fleet (see copied_from); leave it out")
        learned = {name: set(self._dictionary(model)) for name, model in self.models.items()}
        first = next(iter(learned), "")
        for name, states in learned.items():
            if states != learned[first]:
                raise wrong(
                    f"[models] {first} learns {', '.join(sorted(learned[first]))} but {name} learns "
                    f"{', '.join(sorted(states))}; compare models of the same equations"
                )
        if isinstance(self.data, TableSource):
            sections = {"[simulation]": self._formulas, "[dictionary]": self.dictionary}
            sections |= {f"[models.{name}.dictionary]": model.dictionary or {} for name, model in self.models.items()}
            self.data.require_equations(self._formulas, sections)
        return self

    @property
    def _formulas(self) -> dict[str, str]:
        """Formulas of the simulation."""
        return dict(self.simulation) if isinstance(self.simulation, Mapping) else {}

    @property
    def _example(self) -> str:
        """Name for examples of equations: the first that the file has."""
        stated = [name for key in ("states", "outputs") for name in getattr(self.data, key, ())]
        return next(iter((*stated, *self._formulas)), "y")

    @property
    def file(self) -> str:
        """Name of the file, or of the original of a copy."""
        return self.origin.name

    @property
    def text(self) -> str:
        """The file as its author wrote it."""
        return self._text if self.copied_from is None else author_text(self._text)

    @property
    def origin(self) -> Path:
        """The file itself, or the original of a copy: paths in it start from its folder."""
        return self._path if self.copied_from is None else (self._path.resolve().parent / self.copied_from).resolve()

    def of_asset(self, file: Path) -> "Config":
        """Return the same configuration for another data file in place of [data] path."""
        if not isinstance(self.data, TableSource):
            raise InputError(f'"{self._path}": [data] reads no table (path), so no other file can stand in its place.')
        if self.data.held_out:
            raise InputError(
                f'"{self._path}": [data.test] is one file, and each asset needs its own: give test_fraction instead.'
            )
        again = self.model_copy(update={"data": self.data.model_copy(update={"path": str(file.resolve())})})
        again._asset = file
        return again

    @property
    def folder(self) -> Path:
        """Folder for results: as the file says, else runs/<name>; a copy beside results has the folder of these."""
        if self.copied_from is not None and self._path.name == CONFIG:
            # Taken elsewhere it is a file as any other.
            return self._path.parent if command_of(self._path.parent) else Path("runs") / self.origin.stem
        return Path(self.output.folder or Path("runs") / self._path.stem)

    def copy_to(self, folder: Path, place: Path | None = None) -> None:
        """Write a copy that can be run again where it lies, in `folder`; first to `place`, if that is another."""
        copy = folder / CONFIG
        if self.copied_from is None and copy.exists() and copy.samefile(self._path):
            # The results lie beside the file itself, which stays as its author wrote it.
            return
        text = copy_of(self.text, self.origin, folder, self._asset)
        ((place or folder) / CONFIG).write_text(text, encoding="utf-8", newline="")

    def read_data(self) -> "tuple[Trajectories, Trajectories | None]":
        """Return training data, which are not read in chunks, and, where the file asks for them, held-out data."""
        from bayes_greybox.data.trajectories import require_measured

        train: Any
        train, test = self.read_rows()
        require_measured(train)
        return train, test

    def read_rows(self) -> "tuple[Trajectories | RowStream, Trajectories | None]":
        """Return the same for a fit, which may read its rows in chunks."""
        return self.data.read(self.origin.parent)

    def build_model(self, name: str | None = None) -> "GreyBox":
        """Return the model of the file, or one of its [models] by name, which must have terms to fit."""
        if name is not None and name not in self.models:
            raise InputError(f"There is no model {name!r}; there are {', '.join(self.models) or 'none'}.")
        model = self.models[name] if name is not None else Model()
        dictionary = self._dictionary(model)
        if not dictionary and not any(each.sd for each in self.parameters.values()):
            raise InputError(
                f'"{self._path}" has no [dictionary], so there is nothing to fit: add terms such as '
                f'{self._example} = ["{self._example}"], or look for what the simulation misses with bayes-greybox '
                "discover."
            )
        return self._model(dictionary, model)

    def build_studied_model(self) -> "GreyBox":
        """Return the model in which missing effects are looked for: the simulation, and terms that are free anyway."""
        if not (self.simulation or self.dictionary):
            raise InputError(
                f'"{self._path}" has neither [simulation] nor [dictionary]: say what is known, such as '
                f'[simulation] {self._example} = "-2*{self._example}", so that what is missing can be told from it.'
            )
        return self._model(self.dictionary, Model())

    def study_arguments(self) -> dict[str, Any]:
        """Return the arguments of `find_missing_effects` beside model and data."""
        if "target_accept" in self.sampling.model_fields_set:
            raise InputError(f'"{self._path}": [sampling] target_accept does not apply to discover; leave it out.')
        sampling = self.sampling.model_dump(exclude={"target_accept"})
        return {**self.study.arguments(self.origin.parent), **sampling}

    def _dictionary(self, model: Model) -> parts.Dictionary:
        return self.dictionary if model.dictionary is None else model.dictionary

    def _model(self, dictionary: parts.Dictionary, model: Model) -> "GreyBox":
        from bayes_greybox.greybox import GreyBox

        if isinstance(self.data, TableSource):
            if error := self.data.rate_without_equation(self._formulas, dictionary):
                raise InputError(f'"{self._path}": {error}.')
        prior, discrepancy = model.prior or self.prior, model.discrepancy or self.discrepancy
        built = {"prior": prior, "discrepancy": discrepancy, "rows": self.rows}
        given = self.simulation
        coefficients = self.coefficients if model.coefficients is None else model.coefficients
        return GreyBox(
            dictionary={state: terms.build() for state, terms in dictionary.items()},
            simulation=given.build(self.origin.parent) if isinstance(given, parts.FMUFile) else dict(given) or None,
            parameters={name: each.build() for name, each in self.parameters.items()},
            starts=self.starts,
            coefficients={state: {name: c.build() for name, c in each.items()} for state, each in coefficients.items()},
            **{name: part.build() for name, part in built.items() if part is not None},
            **self.noise.arguments(),
        )

    def with_settings(self, name: str, **settings: Any) -> "Config":
        """Return the same configuration with some settings of the section [name] replaced; None leaves one as it is."""
        section: Section = getattr(self, name)
        chosen = {key: value for key, value in settings.items() if value is not None}
        try:
            return self.model_copy(update={name: type(section).model_validate({**section.given(), **chosen})})
        except ValidationError as error:
            raise InputError(sentences(error)) from None


def load_config(path: str | Path) -> Config:
    """Read and check a configuration file.

    Args:
        path: The TOML file; paths in it are relative to its folder.

    Raises:
        InputError: The file cannot be read, is not TOML, or has an unknown key or a value that cannot be
            used; the message names the file and the place.
    """
    path = Path(path)
    content, text = read_toml(path, "configuration")
    try:
        config = Config.model_validate(content)
    except ValidationError as error:
        raise InputError(f'"{path}": {sentences(error)}') from None
    config._path, config._text = path, text
    return config if config.asset is None else config.of_asset(path.resolve().parent / config.asset)
