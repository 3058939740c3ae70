"""The host systems that effects are hidden in: oscillators, chains, tanks, populations and circuits.

Each is a simulation, starts and an excitation, in plain NumPy. Nothing here or in the modules that make the data uses
the package's own formulas, models or integrators.
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
    """Return the value of a term of a simulation: a column, or a key of `TERMS`."""
    return columns[text] if text in columns else TERMS[text](columns)


def formula(terms: Mapping[str, float]) -> str:
    """Write a simulation as a user does; numbers read back to the last bit."""
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
        """Draw the signal of several runs, each with its own phases: a function from time to a value for each run."""
        low, high = self.band
        if self.kind == "chirp":
            phase = rng.uniform(0.0, 2 * np.pi, runs)
            return lambda t: (
                self.offset + self.size * np.sin(2 * np.pi * (low * t + (high - low) * t**2 / (2 * stop)) + phase)
            )
        phases = rng.uniform(0.0, 2 * np.pi, (self.tones, runs))
        omega = 2 * np.pi * np.linspace(low, high, self.tones)[:, None]
        scale = self.size * np.sqrt(2.0 / self.tones)
        return lambda t: self.offset + scale * np.sin(omega * t + phases).sum(axis=0)


@dataclass(frozen=True)
class Start:
    """Range that a state's initial value is drawn from; `mirrored` ones get a random sign."""

    low: float
    high: float
    mirrored: bool = False

    def draw(self, rng: np.random.Generator, runs: int) -> Float[np.ndarray, " n_run"]:
        """Draw initial values of several runs."""
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
        """True if the simulation has a term of each of its inputs."""
        return all(any(name in terms for terms in self.rates.values()) for name in self.inputs)

    def in_roles(self, columns: Columns) -> dict[str, Any]:
        """Return columns by role, as the hidden effects read them."""
        return {role: columns[name] for role, name in self.roles.items()}


def _either(low: float, high: float) -> Start:
    return Start(low, high, mirrored=True)


def _free(name: str, terms: Mapping[str, float], **changes: Any) -> Host:
    """One mass, released."""
    given: dict[str, Any] = {
        "rates": {"y": {"ydot": 1.0}, "ydot": dict(terms)},
        "roles": {"position": "y", "velocity": "ydot"},
        "units": {"t": "s", "y": "rad", "ydot": "rad/s"},
        "starts": {"y": _either(1.2, 2.2), "ydot": _either(0.0, 3.0)},
        "stop": 12.0,
        "samples": 120,
        "runs": 3,
    }
    return Host(name=name, domain="mechanical", equation="ydot", **{**given, **changes})


def _forced(name: str, terms: Mapping[str, float], excitation: Excitation, **changes: Any) -> Host:
    """One mass, driven from near rest."""
    given: dict[str, Any] = {
        "roles": {"position": "y", "velocity": "ydot", "input": "F"},
        "units": {"t": "s", "y": "rad", "ydot": "rad/s", "F": "N*m"},
        "starts": {"y": _either(0.0, 1.0), "ydot": _either(0.0, 2.0)},
        "excitation": {"F": excitation},
        "stop": 20.0,
        "samples": 200,
        "runs": 2,
    }
    return _free(name, terms, **{**given, **changes})


def _chain(name: str, terms: Mapping[str, float], excitation: Excitation | None = None) -> Host:
    """Two masses between springs, released or driven; the terms are those of the first one's equation."""
    rates = {
        "y1": {"v1": 1.0},
        "v1": dict(terms),
        "y2": {"v2": 1.0},
        "v2": {"y2": -6.0, "y1": 2.0, "v2": -0.25, "v1": 0.1},
    }
    roles = {"position": "y1", "velocity": "v1", "other_position": "y2", "other_velocity": "v2"}
    units = {"t": "s", "y1": "rad", "v1": "rad/s", "y2": "rad", "v2": "rad/s"}
    far, fast = (_either(1.2, 2.2), _either(0.0, 2.0)) if excitation is None else (_either(0.0, 1.0),) * 2
    starts = {"y1": far, "v1": fast, "y2": far, "v2": fast}
    common: dict[str, Any] = {"domain": "mechanical", "equation": "v1", "rates": rates, "starts": starts}
    if excitation is None:
        return Host(name, roles=roles, units=units, stop=13.0, samples=130, runs=3, **common)
    return Host(
        name,
        roles={**roles, "input": "F"},
        units={**units, "F": "N*m"},
        excitation={"F": excitation},
        stop=20.0,
        samples=200,
        runs=2,
        **common,
    )


def _tank(name: str, terms: Mapping[str, float], pumped: bool = True) -> Host:
    """One tank, with a pump whose voltage is recorded, or draining."""
    pump: dict[str, Any] = {"runs": 3, "stop": 300.0, "samples": 120, "excitation": {"u": _PUMP}}
    drain: dict[str, Any] = {"runs": 3, "stop": 25.0, "samples": 100}
    return Host(
        name,
        domain="fluid",
        equation="h",
        rates={"h": dict(terms)},
        roles={"level": "h", **({"input": "u"} if pumped else {})},
        units={"t": "s", "h": "m", **({"u": "V"} if pumped else {})},
        starts={"h": Start(2.5, 12.0)},
        positive=("h",),
        **(pump if pumped else drain),
    )


def _second_tank(name: str, terms: Mapping[str, float]) -> Host:
    """The second of two tanks, beside or below a first one that the same pump feeds."""
    return Host(
        name,
        domain="fluid",
        equation="h2",
        rates={"h1": {"u": 0.05, "sqrt(h1)": -0.1}, "h2": dict(terms)},
        roles={"level": "h2", "upstream": "h1", "input": "u"},
        units={"t": "s", "h1": "m", "h2": "m", "u": "V"},
        starts={"h1": Start(2.0, 12.0), "h2": Start(2.0, 12.0)},
        stop=300.0,
        samples=120,
        runs=3,
        excitation={"u": _PUMP},
        positive=("h1", "h2"),
    )


def _population(
    name: str,
    terms: Mapping[str, float],
    other: Mapping[str, float] | None = None,
    starts: tuple[Start, ...] = (Start(2.0, 60.0), Start(2.0, 60.0)),
    stop: float = 12.0,
    feed: Excitation | None = None,
) -> Host:
    """A population p, alone or beside another one, q; `feed` is a recorded supply."""
    rates = {"p": dict(terms), **({"q": dict(other)} if other else {})}
    roles = {"population": "p", **({"other": "q"} if other else {}), **({"input": "u"} if feed else {})}
    return Host(
        name,
        domain="population",
        equation="p",
        rates=rates,
        roles=roles,
        units={"t": "year", **dict.fromkeys(rates, "1"), **({"u": "1/year"} if feed else {})},
        starts=dict(zip(rates, starts, strict=False)),
        stop=stop,
        samples=80,
        runs=5,
        excitation={"u": feed} if feed else {},
        positive=tuple(rates),
    )


def _circuit(
    name: str, rates: Mapping[str, Mapping[str, float]], roles: Mapping[str, str], driven: bool = True
) -> Host:
    """A circuit whose last state's equation is studied; `driven` by a recorded source u, or discharging."""
    state = list(rates)[-1]
    units = {"t": "ms", "v": "V", "i": "A", "q": "A*ms", "phi": "V*ms", "u": "V"}
    far = _either(0.9, 1.6)
    source: dict[str, Any] = {
        "runs": 2,
        "stop": 20.0,
        "samples": 200,
        "excitation": {"u": Excitation(2.0, (0.08, 0.5))},
    }
    decay: dict[str, Any] = {"runs": 3, "stop": 12.0, "samples": 120}
    return Host(
        name,
        domain="electrical",
        equation=state,
        rates={key: dict(terms) for key, terms in rates.items()},
        roles={"state": state, **roles, **({"input": "u"} if driven else {})},
        units={key: units[key] for key in ("t", *rates, *(("u",) if driven else ()))},
        starts=dict.fromkeys(rates, far),
        **(source if driven else decay),
    )


_SINES = Excitation(3.5, (0.08, 0.5))
_SWEEP = Excitation(4.0, (0.08, 0.6), kind="chirp")
_FORCE = Excitation(6.0, (0.08, 0.6))
_PUMP = Excitation(1.4, (0.003, 0.02), offset=5.0)
_FEED = Excitation(2.3, (0.04, 0.3), offset=8.0)
_LINKED = {"y1": -5.0, "y2": 2.0, "v1": -0.3, "v2": 0.1}
_PREY = {"p": 0.55, "p*q": -0.028}
_PREDATORS = {"p": -0.84, "p*q": 0.026}
_LOGISTIC = {"p": 0.8, "p**2": -0.01}

MECHANICAL_HOSTS = (
    _free("free-oscillator", {"y": -4.0, "ydot": -0.12}),
    _forced("forced-oscillator", {"F": 1.0, "y": -4.0, "ydot": -0.4}, _SINES),
    _forced("swept-oscillator", {"F": 1.0, "y": -4.0, "ydot": -0.4}, _SWEEP, stop=25.0, samples=250),
    _chain("free-chain", _LINKED),
    _chain("forced-chain", {"F": 1.0, **_LINKED}, _FORCE),
    # For effects that the hosts above have in their simulation.
    _free("free-drag-oscillator", {"y": -4.0, "ydot*abs(ydot)": -0.08}),
    _forced("forced-drag-oscillator", {"F": 1.0, "y": -4.0, "ydot*abs(ydot)": -0.25}, _SINES),
    _free("free-hard-spring", {"y**3": -4.0, "ydot": -0.12}),
    _forced("forced-hard-spring", {"F": 1.0, "y**3": -4.0, "ydot": -0.4}, _SINES),
    _chain("free-unlinked-chain", {"y1": -5.0, "v1": -0.3}),
    _chain("forced-unlinked-chain", {"F": 1.0, "y1": -5.0, "v1": -0.3}, _FORCE),
    # For effects of an input that the simulation leaves out.
    _forced(
        "unmodelled-force",
        {"y": -4.0, "ydot": -0.2},
        _SINES,
        starts={"y": _either(0.9, 1.4), "ydot": _either(0.0, 1.0)},
    ),
    _chain("chain-with-unmodelled-force", _LINKED, _FORCE),
)

FLUID_HOSTS = (
    _tank("tank", {"u": 0.05, "sqrt(h)": -0.1}),
    _tank("seeping-tank", {"u": 0.05, "h": -0.04}),
    _tank("draining-tank", {"sqrt(h)": -0.06}, pumped=False),
    _tank("draining-seeping-tank", {"h": -0.04}, pumped=False),
    _second_tank("lower-tank", {"sqrt(h1)": 0.1, "sqrt(h2)": -0.09}),
    _second_tank("seeping-lower-tank", {"h1": 0.04, "h2": -0.035}),
    _second_tank("twin-tank", {"u": 0.03, "sqrt(h2)": -0.06}),
    _second_tank("seeping-twin-tank", {"u": 0.03, "h2": -0.025}),
    _tank("unmodelled-pump", {"1": 0.25, "sqrt(h)": -0.1}),
    _tank("seeping-tank-with-unmodelled-pump", {"1": 0.25, "h": -0.04}),
)

POPULATION_HOSTS = (
    _population("prey", _PREY, {"q": -0.84, "p*q": 0.026}, (Start(5.0, 80.0), Start(3.0, 45.0))),
    _population("predators", _PREDATORS, {"q": 0.55, "p*q": -0.028}, (Start(3.0, 45.0), Start(5.0, 80.0))),
    _population("rivals", _LOGISTIC, {"q": 0.5, "q**2": -0.01}, (Start(2.0, 140.0), Start(2.0, 100.0)), stop=6.0),
    _population("visited", _LOGISTIC, {"u": 1.0, "q": -0.4}, (Start(2.0, 140.0), Start(5.0, 60.0)), 6.0, _FEED),
    _population("culture", {"u": 1.0, "p": -0.3}, feed=_FEED),
    _population("crowded-culture", {"u": 1.0, "p**2": -0.02}, feed=_FEED),
    _population("grazed", {"u": 1.0, "p*q": -0.03}, {"q": -0.5, "p*q": 0.02}, feed=_FEED),
)

ELECTRICAL_HOSTS = (
    _circuit("rc", {"v": {"u": 2.0, "v": -2.0}}, {"voltage": "v"}),
    _circuit("rl", {"i": {"u": 2.0, "i": -1.5}}, {"current": "i"}),
    _circuit("rl-flux", {"phi": {"u": 1.0, "phi": -1.0}}, {"flux": "phi"}),
    _circuit("series-rlc", {"q": {"i": 1.0}, "i": {"u": 1.0, "q": -4.0, "i": -0.5}}, {"current": "i", "stored": "q"}),
    _circuit(
        "parallel-rlc",
        {"phi": {"v": 1.0}, "v": {"u": 1.0, "phi": -4.0, "v": -0.5}},
        {"voltage": "v", "flux": "phi", "stored": "phi"},
    ),
    _circuit("discharging-rlc", {"q": {"i": 1.0}, "i": {"q": -4.0, "i": -0.2}}, {"current": "i", "stored": "q"}, False),
    _circuit("lossless-series", {"q": {"i": 1.0}, "i": {"u": 1.0, "q": -4.0}}, {"current": "i", "stored": "q"}),
    _circuit("varistor-rc", {"v": {"u": 2.0, "v**3": -1.0}}, {"voltage": "v"}),
    _circuit("unmodelled-source", {"q": {"i": 1.0}, "i": {"q": -4.0, "i": -0.2}}, {"current": "i", "stored": "q"}),
    _circuit("parallel-with-unmodelled-source", {"phi": {"v": 1.0}, "v": {"phi": -4.0, "v": -0.2}}, {"voltage": "v"}),
)

HOSTS: dict[str, Host] = {
    host.name: host for host in (*MECHANICAL_HOSTS, *FLUID_HOSTS, *POPULATION_HOSTS, *ELECTRICAL_HOSTS)
}
"""All hosts by name."""
