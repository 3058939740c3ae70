"""One case of a broken assumption, and the family that it belongs to."""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError
from benchmarks.hidden_effects.systems.hosts import Host
from benchmarks.hidden_effects.systems.ode import Acting, HostODE
from benchmarks.hidden_effects.systems.search import Wanted
from benchmarks.hidden_effects.systems.trajectories import Excited

from .hosts import PLACES, Place, placed
from .path import Path

SILENT = ("no gap", "instrument")
"""Verdicts that are right where no effect is hidden."""


@dataclass(frozen=True)
class AssumptionCase:
    """One case; the same case gives the same data.

    Attributes:
        family: Name of its family.
        breach: In which way the assumption is broken.
        size: Size of the breach, in the family's own measure.
        host: Name of the host, a key of `hosts.PLACES`.
        effects: Slugs of the hidden effects, or none.
        ratios: Wanted RMS of each effect over that of the noise.
        signs: Sign of each effect's coefficient: -1 dissipates or restores.
        noise: Standard deviation of the noise over the RMS of the true rate.
        rows: Rows of the training data.
        seed: Seed of everything random in the data.
    """

    family: str
    breach: str
    size: float
    host: str
    effects: tuple[str, ...]
    ratios: tuple[float, ...]
    signs: tuple[float, ...]
    noise: float
    rows: int
    seed: int

    def __post_init__(self) -> None:
        if self.host not in PLACES:
            raise InputError(f"There is no host {self.host!r}; there are {', '.join(PLACES)}.")
        if not len(self.effects) == len(self.ratios) == len(self.signs):
            raise InputError("A case needs one ratio and one sign for each of its effects.")

    @property
    def key(self) -> str:
        """Name that tells the case from all others, those of other seeds included."""
        digest = hashlib.sha1(json.dumps(asdict(self)).encode(), usedforsecurity=False).hexdigest()
        breach = f"{self.breach} {self.size:g}"
        return "/".join((self.family, breach, self.host, "+".join(self.effects) or "-", f"{self.noise:g}", digest[:8]))

    @property
    def place(self) -> Place:
        """The host as it is seen and as it is, at the case's number of rows."""
        return placed(self.host, self.rows)

    @property
    def system(self) -> Host:
        """The host as it is seen."""
        return self.place.visible


@dataclass(frozen=True)
class Setting:
    """A breach that a family tries, with a hidden effect and without.

    Attributes:
        breach: In which way the assumption is broken.
        size: Size of the breach.
        host: Name of the host.
        noise: Noise over the RMS of the true rate.
        rows: Rows of the training data; 0 for the host's own.
        effects: Hidden effects; the host's next one by default.
        signs: Signs of their coefficients.
        bare: If true, it is tried without a hidden effect too.
    """

    breach: str
    size: float
    host: str
    noise: float
    rows: int = 0
    effects: tuple[str, ...] | None = None
    signs: tuple[float, ...] | None = None
    bare: bool = True


@dataclass(frozen=True)
class Suspect:
    """A true fault of the instrument.

    Attributes:
        name: As the column "suspect" of `study.instrument` has it.
        channels: Any of these is right; empty if every one is.
        samples: Delay in samples, positive for a channel that is late; None for what is no delay.
        either: True if a delay of the other sign, in another channel, is the same.
    """

    name: str
    channels: tuple[str, ...] = ()
    samples: float | None = None
    either: bool = False


@dataclass(frozen=True)
class Scene:
    """The true paths, before anything is measured.

    Attributes:
        case: The case.
        paths: The true system, on "train" and "test".
        rate: RMS of the true studied rate on the training data.
        spread: Standard deviation of each column on the training data.
    """

    case: AssumptionCase
    paths: Mapping[str, Path]
    rate: float
    spread: Mapping[str, float]

    @property
    def sigma(self) -> float:
        """Nominal standard deviation of the rate's noise."""
        return self.case.noise * self.rate


@dataclass(frozen=True)
class Measured:
    """Readings of the sensors, runs one after another: columns by name, and the studied rate."""

    columns: Mapping[str, Float[np.ndarray, " n_obs"]]
    rate: Float[np.ndarray, " n_obs"]


Measure = Callable[[Scene, str, np.random.Generator], Measured]
"""(scene, "train" or "test", generator) -> readings of the sensors."""


@dataclass(frozen=True)
class Family:
    """One way of breaking an assumption.

    Attributes:
        name: Its name.
        settings: Breaches that are tried, each without and with a hidden effect.
        measure: Function that makes the sensors' readings.
        suspects: True faults of the instrument.
        level: Noise that ratios are relative to, over the RMS of the rate; the case's by default.
        sigma: Standard deviation of the noise on the studied equation; the nominal one by default.
        beside: Further effects that act and are in no catalogue, with their sizes.
        momentary: Further effects that act and are in no catalogue, sized by the family itself: (case, system with all
            other effects, starts and input of the training data, generator) -> effects.
        inner: Nonlinear parameters of hidden effects, as fractions, where the case says them.
        accepted: Slugs that count as the right name of a hidden effect.
        excused: Slugs that no data could tell from the breach: neither right nor wrong.
        silent: Verdicts that are right without a hidden effect; none where something is missing all the same.
        finish: Step of the user before the study: training and test data in, the same out.
    """

    name: str
    settings: Callable[[], Iterable[Setting]]
    measure: Measure
    suspects: Callable[[AssumptionCase], tuple[Suspect, ...]] = field(default=lambda case: ())
    level: Callable[[AssumptionCase], float] = field(default=lambda case: case.noise)
    sigma: Callable[[Scene], float] = field(default=lambda scene: scene.sigma)
    beside: Callable[[AssumptionCase, np.random.Generator], tuple[Wanted, ...]] = field(default=lambda case, rng: ())
    momentary: Callable[[AssumptionCase, HostODE, Excited, np.random.Generator], tuple[Acting, ...]] = field(
        default=lambda case, system, excited, rng: ()
    )
    inner: Callable[[AssumptionCase], Mapping[str, float]] = field(default=lambda case: {})
    accepted: Callable[[AssumptionCase, str], tuple[str, ...]] = field(default=lambda case, slug: (slug,))
    excused: Callable[[AssumptionCase], tuple[str, ...]] = field(default=lambda case: ())
    silent: Callable[[AssumptionCase], tuple[str, ...]] = field(default=lambda case: SILENT)
    finish: Callable[[Trajectories, Trajectories], tuple[Trajectories, Trajectories]] | None = None


def rate_channel(case: AssumptionCase) -> tuple[str, ...]:
    """Return names of the studied rate's sensor."""
    state = case.system.equation
    return (f"d({state})/dt", "rate", f"rate of {state}")


def seen(scene: Scene, part: str, late: float | Float[np.ndarray, "n_run n_time"] = 0.0) -> Measured:
    """Return exact columns and rate, all late by so many sampling steps, or each row by its own."""
    host = scene.case.system
    runs = scene.paths[part].at(late)
    return Measured({name: runs.columns[name] for name in (*host.states, *host.inputs)}, runs.rates[host.equation])


def white(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    """Return exact columns, and independent normal noise on the rate."""
    clean = seen(scene, part)
    return Measured(clean.columns, clean.rate + scene.sigma * rng.standard_normal(len(clean.rate)))
