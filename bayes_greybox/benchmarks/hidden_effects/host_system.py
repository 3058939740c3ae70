"""What a host system of the benchmark is, in plain NumPy: a simulation, starts and excitation.

Nothing here or in the modules that make the data uses the package's own formulas, models or integrators.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

Columns = Mapping[str, Any]
"""Columns by name: numbers, or arrays of one shape."""

TERMS: dict[str, Callable[[Columns], Any]] = {
    "1": lambda c: 1.0,
    "y**3": lambda c: c["y"] ** 3,
    "ydot*abs(ydot)": lambda c: c["ydot"] * np.abs(c["ydot"]),
    "sqrt(h)": lambda c: np.sqrt(np.maximum(c["h"], 0.0)),
    "sqrt(h1)": lambda c: np.sqrt(np.maximum(c["h1"], 0.0)),
    "sqrt(h2)": lambda c: np.sqrt(np.maximum(c["h2"], 0.0)),
    "p**2": lambda c: c["p"] ** 2,
    "q**2": lambda c: c["q"] ** 2,
    "v**3": lambda c: c["v"] ** 3,
    "p*q": lambda c: c["p"] * c["q"],
}
"""Terms of the simulations that are more than a column."""

SPREAD = 0.2
"""Coefficients vary from case to case by a factor between exp(-SPREAD) and exp(SPREAD)."""


def term_value(text: str, columns: Columns) -> Any:
    """Value of a term of a simulation: a column, or a key of `TERMS`."""
    return columns[text] if text in columns else TERMS[text](columns)


def formula(terms: Mapping[str, float]) -> str:
    """A simulation as the text that a user writes; numbers read back to the last bit."""
    text = ""
    for name, value in terms.items():
        size = "" if abs(value) == 1.0 else f"{abs(value)!r}*"
        text += f" {'-' if value < 0 else '+'} {size}{name}"
    return text[3:] if text.startswith(" + ") else text[1:].replace("- ", "-", 1)


@dataclass(frozen=True)
class Excitation:
    """Smooth input signal, an exact function of time.

    Attributes:
        size: RMS of a multisine about its offset, amplitude of a chirp.
        band: Lowest and highest frequency, cycles per unit of time.
        offset: Mean level.
        kind: "multisine" or "chirp".
        tones: Number of sines of a multisine.
    """

    size: float
    band: tuple[float, float]
    offset: float = 0.0
    kind: str = "multisine"
    tones: int = 6

    def draw(self, rng: np.random.Generator, runs: int, stop: float) -> Callable[[float], np.ndarray]:
        """The signal of several runs, each with phases of its own: a function from time to one value for each run."""
        low, high = self.band
        if self.kind == "chirp":
            phase = rng.uniform(0.0, 2 * np.pi, runs)
            return lambda t: (
                self.offset + self.size * np.sin(2 * np.pi * (low * t + (high - low) * t**2 / (2 * stop)) + phase)
            )
        phases = rng.uniform(0.0, 2 * np.pi, (self.tones, runs))
        omega = 2 * np.pi * np.linspace(low, high, self.tones)[:, None]
        scale = self.size * np.sqrt(2.0 / self.tones)
        return lambda t: self.offset + scale * np.sum(np.sin(omega * t + phases), axis=0)


@dataclass(frozen=True)
class Start:
    """Range that a state's initial value is drawn from; `mirrored` ones get a random sign."""

    low: float
    high: float
    mirrored: bool = False

    def draw(self, rng: np.random.Generator, runs: int) -> Float[np.ndarray, " n_run"]:
        """Initial values of several runs."""
        sign = rng.choice([-1.0, 1.0], runs) if self.mirrored else np.ones(runs)
        return sign * rng.uniform(self.low, self.high, runs)


@dataclass(frozen=True)
class Host:
    """A system that an effect is hidden in.

    Attributes:
        name: Its name.
        domain: Domain of the catalogue that its hidden effect comes from.
        equation: The studied state, in whose equation the effect is hidden.
        rates: The simulation: by state, coefficient by term.
        roles: Column by role of the catalogue.
        units: Units by column name.
        starts: Range of initial values by state.
        stop: Length of a run.
        samples: Rows of a run.
        runs: Runs of the training data.
        test_runs: Runs of the held-out data.
        excitation: Signal of the input, by its name; none for a free system.
        positive: States that must stay above zero.
    """

    name: str
    domain: str
    equation: str
    rates: Mapping[str, Mapping[str, float]]
    roles: Mapping[str, str]
    units: Mapping[str, str]
    starts: Mapping[str, Start]
    stop: float
    samples: int
    runs: int
    test_runs: int = 2
    excitation: Mapping[str, Excitation] = field(default_factory=dict)
    positive: tuple[str, ...] = ()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        return tuple(self.rates)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs, in order."""
        return tuple(self.excitation)

    @property
    def times(self) -> Float[np.ndarray, " n_time"]:
        """Sampling times of every run."""
        return np.linspace(0.0, self.stop, self.samples)

    @property
    def heeds_input(self) -> bool:
        """Whether the simulation has a term of each of its inputs."""
        return all(any(name in terms for terms in self.rates.values()) for name in self.inputs)

    def in_roles(self, columns: Columns) -> dict[str, Any]:
        """Columns by role, as the hidden effects read them."""
        return {role: columns[name] for role, name in self.roles.items()}
