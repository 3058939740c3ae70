"""Hidden effects in plain NumPy: the catalogue's effects, written a second time, and shapes that no entry resembles.

Formulas and priors repeat those of `bayes_greybox.physics` on purpose, so that an error there is not also in the
data; a test holds the two side by side.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .hosts import Columns, Host

Value = Callable[[Columns, Any], Any]
"""(columns by role, nonlinear parameter) -> value."""


@dataclass(frozen=True)
class Inner:
    """A nonlinear parameter: log-uniform between two fractions of max|column| of a role, over the training data."""

    role: str
    low: float
    high: float


@dataclass(frozen=True)
class Hidden:
    """One effect that can be hidden in a host.

    Attributes:
        slug: The catalogue's slug, or the name of a shape that is in no catalogue.
        roles: Roles it needs.
        value: Its value, to be multiplied by a coefficient.
        inner: Its nonlinear parameter.
        jump: Role at whose zero it jumps; the integrator stops there.
        memory: Rate of a state of its own, which starts at zero and which `value` reads as the role "memory".
        steps: Least number of steps in which the integrator follows a run; more where it could step across the effect.
    """

    slug: str
    roles: tuple[str, ...]
    value: Value
    inner: Inner | None = None
    jump: str | None = None
    memory: Value | None = None
    steps: int = 40

    def fits(self, host: Host) -> bool:
        """Return True if the host has the roles."""
        return all(role in host.roles for role in self.roles)


def _sign(c: Columns, role: str) -> Any:
    """Return the sign of a column; on a stretch between two of its zeros, the integrator says which."""
    return c["side"] if "side" in c else np.sign(c[role])


def _root(x: Any) -> Any:
    return np.sqrt(np.maximum(x, 0.0))


def _plain(slug: str, value: Callable[..., Any], *roles: str) -> Hidden:
    """Return an effect of columns alone."""
    return Hidden(slug, roles, lambda c, _: value(*(c[role] for role in roles)))


def _inner(slug: str, value: Callable[..., Any], *roles: str, of: str, low: float, high: float) -> Hidden:
    """Return an effect with a nonlinear parameter, the last argument of `value`."""
    return Hidden(slug, roles, lambda c, inner: value(*(c[role] for role in roles), inner), Inner(of, low, high))


def _odd_power(x: Any, exponent: Any) -> Any:
    return np.sign(x) * np.abs(x) ** exponent


def _one(*_: Any) -> float:
    return 1.0


_INPUT = (_plain("input-gain", lambda u: u, "input"), _plain("cubic-input", lambda u: u**3, "input"))
_SQUARED_INPUT = _plain("squared-input", lambda u: u * np.abs(u), "input")

MECHANICAL = (
    _plain("linear-stiffness", lambda x: x, "position"),
    _plain("quadratic-stiffness", lambda x: x**2, "position"),
    _plain("cubic-stiffness", lambda x: x**3, "position"),
    _plain("quintic-stiffness", lambda x: x**5, "position"),
    _plain("signed-quadratic-stiffness", lambda x: x * np.abs(x), "position"),
    _plain("pendulum-restoring", np.sin, "position"),
    _inner("dead-zone", lambda x, gap: x - np.clip(x, -gap, gap), "position", of="position", low=0.1, high=0.8),
    _plain("bilinear-stiffness", lambda x: np.maximum(x, 0.0), "position"),
    _plain("viscous-damping", lambda v: v, "velocity"),
    Hidden("coulomb-friction", ("velocity",), lambda c, _: _sign(c, "velocity"), jump="velocity"),
    Hidden(
        "stribeck-friction",
        ("velocity",),
        lambda c, speed: _sign(c, "velocity") * np.exp(-((c["velocity"] / speed) ** 2)),
        Inner("velocity", 0.05, 0.6),
        jump="velocity",
    ),
    _plain("quadratic-drag", lambda v: v * np.abs(v), "velocity"),
    _plain("cubic-damping", lambda v: v**3, "velocity"),
    _plain("van-der-pol-damping", lambda x, v: x**2 * v, "position", "velocity"),
    _plain("velocity-squared", lambda v: v**2, "velocity"),
    _plain("position-velocity-coupling", lambda x, v: x * v, "position", "velocity"),
    _plain("constant-force", _one),
    *_INPUT,
    _SQUARED_INPUT,
    _plain("coupling-stiffness", lambda x, z: x - z, "position", "other_position"),
    _plain("cubic-coupling-stiffness", lambda x, z: (x - z) ** 3, "position", "other_position"),
    _plain("coupling-damping", lambda v, w: v - w, "velocity", "other_velocity"),
)

FLUID = (
    _plain("linear-outflow", lambda h: h, "level"),
    _plain("torricelli-outflow", _root, "level"),
    _inner("overflow", lambda h, b: np.maximum(h - b, 0.0), "level", of="level", low=0.5, high=0.95),
    _inner("weir-overflow", lambda h, b: np.maximum(h - b, 0.0) ** 1.5, "level", of="level", low=0.5, high=0.95),
    _plain("linear-inflow", lambda h: h, "upstream"),
    _plain("torricelli-inflow", _root, "upstream"),
    _inner("overflow-inflow", lambda h, b: np.maximum(h - b, 0.0), "upstream", of="upstream", low=0.5, high=0.95),
    _plain("connecting-pipe", lambda up, h: np.sign(up - h) * np.sqrt(np.abs(up - h)), "upstream", "level"),
    _plain("constant-inflow", _one),
    *_INPUT,
    _SQUARED_INPUT,
)

_PAIR = ("population", "other")

POPULATION = (
    _plain("linear-growth", lambda n: n, "population"),
    _plain("logistic-crowding", lambda n: n**2, "population"),
    _plain("cubic-crowding", lambda n: n**3, "population"),
    _plain("bilinear-interaction", lambda n, m: n * m, *_PAIR),
    _inner("holling-ii", lambda n, m, half: n * m / (half + n), *_PAIR, of="population", low=0.1, high=2.0),
    _inner("holling-ii-gain", lambda n, m, half: n * m / (half + m), *_PAIR, of="other", low=0.1, high=2.0),
    _inner("holling-iii", lambda n, m, half: n**2 * m / (half**2 + n**2), *_PAIR, of="population", low=0.1, high=2.0),
    _inner("holling-iii-gain", lambda n, m, half: n * m**2 / (half**2 + m**2), *_PAIR, of="other", low=0.1, high=2.0),
    _inner("allee", lambda n, a: n / (a + n), "population", of="population", low=0.02, high=0.5),
    _plain("migration", lambda m: m, "other"),
    _plain("constant-harvest", _one),
    _plain("driven-growth", lambda n, u: n * u, "population", "input"),
)

ELECTRICAL = (
    _plain("ohmic-loss", lambda z: z, "state"),
    _plain("cubic-resistor", lambda z: z**3, "state"),
    _inner("diode", lambda v, s: np.expm1(v / s), "voltage", of="voltage", low=0.02, high=0.5),
    _inner("diode-pair", lambda v, s: np.sinh(v / s), "voltage", of="voltage", low=0.02, high=0.5),
    Hidden("brush-drop", ("current",), lambda c, _: _sign(c, "current"), jump="current"),
    _inner("saturating-inductor", lambda f, k: f - np.clip(f, -k, k), "flux", of="flux", low=0.2, high=0.9),
    _plain("cubic-storage", lambda q: q**3, "stored"),
    _plain("inductance-drop", lambda u, i: u * i**2, "input", "current"),
    _plain("constant-source", _one),
    *_INPUT,
)


def _by_slug(
    mechanical: tuple[Hidden, ...],
    fluid: tuple[Hidden, ...] = (),
    population: tuple[Hidden, ...] = (),
    electrical: tuple[Hidden, ...] = (),
) -> dict[str, dict[str, Hidden]]:
    domains = {"mechanical": mechanical, "fluid": fluid, "population": population, "electrical": electrical}
    return {domain: {effect.slug: effect for effect in effects} for domain, effects in domains.items()}


CATALOGUE = _by_slug(MECHANICAL, FLUID, POPULATION, ELECTRICAL)
"""The catalogue's effects by domain and slug, as far as the family "catalogue" hides them."""

ADDED = _by_slug(
    (
        _inner("smooth-friction", lambda v, c: np.tanh(v / c), "velocity", of="velocity", low=0.02, high=0.5),
        Hidden(
            "exponential-stribeck-friction",
            ("velocity",),
            lambda c, speed: _sign(c, "velocity") * np.exp(-np.abs(c["velocity"]) / speed),
            Inner("velocity", 0.05, 0.6),
            jump="velocity",
        ),
        _plain("direction-dependent-friction", np.abs, "velocity"),
        _inner("backlash", lambda u, play: np.clip(u, -play, play), "input", of="input", low=0.05, high=0.8),
        _inner("input-saturation", lambda u, g: u - np.clip(u, -g, g), "input", of="input", low=0.02, high=0.95),
        _inner("power-law-stiffness", _odd_power, "position", of="position", low=1.3, high=5.0),
        _inner("power-law-drag", _odd_power, "velocity", of="velocity", low=1.3, high=4.0),
        _plain("stroke-dependent-drive", lambda u, x: u * x**2, "input", "position"),
    )
)
"""Effects that the catalogue has got since the cases of the family "catalogue" were laid down, which stay as they are.

The study weighs them like all others; the oracle and PySINDy, which know what that family hides, do not.
"""


def _wave(x: Any, length: Any) -> Any:
    return np.cos(2 * np.pi * x / length)


def _triangle(x: Any, length: Any) -> Any:
    """Return a sawtooth with equal flanks, between -1 and 1."""
    return 2 / np.pi * np.arcsin(np.sin(2 * np.pi * x / length))


def _shapes(role: str, length: tuple[float, float], place: tuple[float, float], width: float) -> tuple[Hidden, ...]:
    """Return waves of some lengths and a bump at some place over one column, in fractions of its range."""

    def bump(x: Any, at: Any) -> Any:
        return np.exp(-(((x - at) / (width * at)) ** 2))

    return (
        _inner("ripple", _wave, role, of=role, low=length[0], high=length[1]),
        _inner("sawtooth", _triangle, role, of=role, low=length[0], high=length[1]),
        _inner("bump", bump, role, of=role, low=place[0], high=place[1]),
    )


_SEASON = Hidden("season", (), lambda c, length: np.sin(2 * np.pi * c["t"] / length), Inner("t", 0.15, 0.3))
"""An influence that no column records."""

OFF_CATALOGUE = _by_slug(
    (
        *_shapes("position", (0.5, 0.9), (0.4, 0.7), 0.3),
        _plain("position-times-cubed-velocity", lambda x, v: x * v**3, "position", "velocity"),
        _inner(
            "rippled-damping",
            lambda x, v, s: v * _wave(x, s),
            *("position", "velocity"),
            of="position",
            low=0.5,
            high=0.9,
        ),
        _inner("velocity-ripple", lambda v, s: _wave(v, s), "velocity", of="velocity", low=0.5, high=0.9),
        # Dahl's friction: a bristle that bends until it slips.
        Hidden(
            "hysteresis",
            ("position", "velocity"),
            lambda c, _: c["memory"],
            Inner("position", 0.2, 0.5),
            memory=lambda c, s: c["velocity"] - np.abs(c["velocity"]) * c["memory"] / s,
        ),
        _SEASON,
    ),
    (*_shapes("level", (0.15, 0.25), (0.65, 0.8), 0.12), _SEASON),
    (*_shapes("population", (0.2, 0.4), (0.4, 0.6), 0.2), _SEASON),
    (*_shapes("state", (0.5, 0.9), (0.4, 0.7), 0.3), _SEASON),
)
"""Shapes that no entry of the catalogue resembles, by domain and name."""


def find(domain: str, slug: str) -> Hidden:
    """Return the effect or shape of that name."""
    return {**OFF_CATALOGUE[domain], **CATALOGUE[domain], **ADDED[domain]}[slug]
