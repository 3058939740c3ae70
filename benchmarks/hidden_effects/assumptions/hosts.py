"""Hosts where assumptions are broken, sampled finely enough for small delays; some have states nobody measures."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from benchmarks.hidden_effects.systems.hosts import HOSTS, Excitation, Host, Start

USUAL_ROWS = 601
"""Rows of a usual run."""

LONGEST_RUN = 3001
"""Rows of the longest run; larger data have several."""


@dataclass(frozen=True)
class Place:
    """A host as the study sees it, and the whole system; they differ where a state is not handed out."""

    visible: Host
    whole: Host


def placed(name: str, rows: int) -> Place:
    """Return a host with that many rows: its sampling step stays, the runs grow and then become more."""
    place = PLACES[name]
    if rows == place.visible.samples * place.visible.runs:
        return place
    samples = min(rows, LONGEST_RUN)
    step = place.visible.stop / (place.visible.samples - 1)
    size: dict[str, Any] = {"samples": samples, "stop": step * (samples - 1), "runs": rows // samples, "test_runs": 1}
    return Place(replace(place.visible, **size), replace(place.whole, **size))


def own_rows(name: str) -> int:
    """Return rows of a host's training data where a case does not ask for more."""
    return PLACES[name].visible.samples * PLACES[name].visible.runs


def _finer(host: Host, samples: int = USUAL_ROWS, runs: int = 1, **changes: Any) -> Place:
    finer = replace(host, samples=samples, runs=runs, **changes)
    return Place(finer, finer)


def _partly(name: str, whole: Host, visible: tuple[str, ...]) -> Place:
    """Return a place where only some states are measured, and simulated."""
    rates = {
        state: {text: value for text, value in whole.rates[state].items() if text not in set(whole.states) - {*visible}}
        for state in visible
    }
    measured = {*visible, *whole.inputs}
    seen = replace(
        whole,
        name=name,
        rates=rates,
        roles={role: column for role, column in whole.roles.items() if column in measured},
        units={column: unit for column, unit in whole.units.items() if column in {"t", *measured}},
        starts={state: whole.starts[state] for state in visible},
    )
    # An effect that is hidden has the roles that the study sees.
    return Place(seen, replace(whole, name=name, roles=seen.roles))


_MACHINE_SPRING, _MACHINE_DAMPING = 10.0, 0.5

MACHINE = Host(
    name="machine",
    domain="mechanical",
    equation="ydot",
    rates={"y": {"ydot": 1.0}, "ydot": {"F": 1.0, "y": -_MACHINE_SPRING, "ydot": -_MACHINE_DAMPING}},
    roles={"position": "y", "velocity": "ydot", "input": "F"},
    units={"t": "s", "y": "m", "ydot": "m/s", "F": "N/kg"},
    starts={"y": Start(0.2, 1.0, mirrored=True), "ydot": Start(0.0, 2.0, mirrored=True)},
    stop=12.0,
    samples=USUAL_ROWS,
    runs=1,
    # No two differences of tones agree with the record's length, so that long records do not repeat a short one.
    excitation={"F": Excitation(4.5, (0.11, 0.93), tones=9)},
)
"""A driven mass on a spring, sampled at 50 Hz."""

# Pushed to one side: it stays, for most of the time, at positive displacements.
_BIASED = replace(MACHINE, name="biased-machine", excitation={"F": Excitation(3.0, (0.11, 0.93), 9.0, tones=9)})

# Driven in one direction; now and then it turns back.
_ROTOR = Host(
    name="rotor",
    domain="mechanical",
    equation="omega",
    rates={"omega": {"F": 1.0, "omega": -0.8}},
    roles={"velocity": "omega", "input": "F"},
    units={"t": "s", "omega": "rad/s", "F": "rad/s**2"},
    starts={"omega": Start(1.0, 4.0)},
    stop=12.0,
    samples=USUAL_ROWS,
    runs=1,
    excitation={"F": Excitation(5.0, (0.1, 0.8), 3.5, tones=9)},
)


def _absorbed(ratio: float) -> Host:
    """Return the machine with a small mass on a spring of its own, tuned near the machine's resonance."""
    spring, damping = 9.0, 0.3
    return replace(
        MACHINE,
        name="absorbed-machine",
        rates={
            "y": {"ydot": 1.0},
            "ydot": {**MACHINE.rates["ydot"], "z": ratio * spring, "zdot": ratio * damping},
            "z": {"zdot": 1.0},
            "zdot": {"y": spring, "z": -spring, "ydot": damping, "zdot": -damping},
        },
        units={**MACHINE.units, "z": "m", "zdot": "m/s"},
        starts={**MACHINE.starts, "z": Start(0.0, 0.1, mirrored=True), "zdot": Start(0.0, 0.1, mirrored=True)},
    )


def _with_terms(place: Place, name: str, **terms: float) -> Place:
    """Return a host with other coefficients in its equation, or further terms."""
    host = place.whole
    rates = {**host.rates, host.equation: {**host.rates[host.equation], **terms}}
    changed = replace(host, name=name, rates=rates)
    return Place(changed, changed)


_DRIVEN = _finer(HOSTS["forced-oscillator"])

_SEEN = ("y1", "v1")

PLACES: Mapping[str, Place] = {
    "machine": Place(MACHINE, MACHINE),
    "biased-machine": Place(_BIASED, _BIASED),
    "rotor": Place(_ROTOR, _ROTOR),
    "absorbed-machine": _partly("absorbed-machine", _absorbed(0.15), ("y", "ydot")),
    "forced-oscillator": _finer(HOSTS["forced-oscillator"]),
    "swept-oscillator": _finer(HOSTS["swept-oscillator"]),
    "free-oscillator": _finer(HOSTS["free-oscillator"], samples=USUAL_ROWS, runs=2),
    "half-seen-forced-chain": _partly("half-seen-forced-chain", _finer(HOSTS["forced-chain"]).whole, _SEEN),
    "half-seen-free-chain": _partly("half-seen-free-chain", _finer(HOSTS["free-chain"], runs=2).whole, _SEEN),
    "tank": _finer(HOSTS["tank"]),
    "series-rlc": _finer(HOSTS["series-rlc"]),
    # Sampled four times as fast, for displacements that are differentiated.
    "fast-machine": _finer(MACHINE, samples=4 * (USUAL_ROWS - 1) + 1, name="fast-machine"),
    "fast-forced-oscillator": _finer(
        HOSTS["forced-oscillator"], samples=4 * (USUAL_ROWS - 1) + 1, name="fast-forced-oscillator"
    ),
    "fast-swept-oscillator": _finer(
        HOSTS["swept-oscillator"], samples=4 * (USUAL_ROWS - 1) + 1, name="fast-swept-oscillator"
    ),
    # For sensors that are bent: springs that harden, and damping of which much is known.
    "hardening-machine": _with_terms(Place(MACHINE, MACHINE), "hardening-machine", **{"y**3": -2.0}),
    "hardening-oscillator": _with_terms(_DRIVEN, "hardening-oscillator", **{"y**3": -0.8}),
    "damped-machine": _with_terms(Place(MACHINE, MACHINE), "damped-machine", ydot=-3.0),
    "damped-oscillator": _with_terms(_DRIVEN, "damped-oscillator", ydot=-2.0),
}
"""Hosts by name."""

SMOOTH_EFFECTS = (
    *("cubic-stiffness", "quadratic-drag", "cubic-damping", "quadratic-stiffness"),
    *("signed-quadratic-stiffness", "van-der-pol-damping", "dead-zone"),
)
"""Mechanical effects without a jump."""

EFFECTS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(PLACES, ("coulomb-friction", *SMOOTH_EFFECTS)),
    "rotor": ("coulomb-friction", "quadratic-drag", "cubic-damping"),
    "tank": ("linear-outflow", "overflow"),
    # Without what is in the simulation already, or can hardly be told from a zero that is off.
    **dict.fromkeys(
        ("hardening-machine", "hardening-oscillator"),
        ("coulomb-friction", "quadratic-drag", "cubic-damping", "van-der-pol-damping"),
    ),
    "series-rlc": ("cubic-resistor", "brush-drop", "cubic-storage"),
}
"""Effects that a host can hide, in turn."""

FORCED = ("machine", "forced-oscillator", "swept-oscillator")
"""Hosts whose input tells late from early."""
