"""Forces that no entry of the catalogue says, or that are hard to see: memory, other laws, effects that cancel.

Memory has Bouc–Wen hysteresis, an attached absorber, a Maxwell damper and LuGre friction. Other laws have powers
between whole ones, and a resistance that fades as none of the catalogue does: two laws of whole powers together follow
each of them closely. Every name of the catalogue's for them is wrong, but that of a power law.

Smooth friction turns over as tanh(v / v0), alone and beside another effect. Its own name is right, and
"coulomb-friction" too where the motion hardly ever is as slow as v0: up to `SHARP` of the largest speed, where fewer
than about one row in twenty lies between.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.hidden_effects.assumptions.case import AssumptionCase, Family, Setting, white
from benchmarks.hidden_effects.assumptions.hosts import FORCED, SMOOTH_EFFECTS
from benchmarks.hidden_effects.systems.hidden import Hidden, Inner
from benchmarks.hidden_effects.systems.hosts import Columns
from benchmarks.hidden_effects.systems.search import Wanted

MEMORY_SHARES = {"Bouc-Wen mild": 0.15, "Bouc-Wen strong": 0.4, "Maxwell": 0.25, "LuGre": 0.2}
"""RMS of each force that remembers over that of the rate."""

LAW_SHARE = 0.3
"""RMS of a force of another law over that of the rate."""

SMOOTH_FRICTION_SLUG, SHARP = "smooth-friction", 0.03
"""Slug of smooth friction, and the largest share of the largest speed at which it is held to be Coulomb's."""

CANCELLING = (
    ("biased-machine", ("quadratic-stiffness", "cubic-stiffness"), (1.0, -1.0)),
    ("rotor", ("constant-force", "coulomb-friction"), (1.0, -1.0)),
    ("machine", ("signed-quadratic-stiffness", "cubic-stiffness"), (1.0, -1.0)),
    ("machine", ("cubic-damping", "quadratic-drag"), (-1.0, 1.0)),
    ("machine", ("quadratic-stiffness", "constant-force"), (-1.0, 1.0)),
    ("rotor", ("quadratic-drag", "velocity-squared"), (-1.0, 1.0)),
    ("forced-oscillator", ("cubic-stiffness", "quintic-stiffness"), (1.0, -1.0)),
    ("biased-machine", ("constant-force", "quadratic-stiffness"), (1.0, -1.0)),
    ("swept-oscillator", ("van-der-pol-damping", "cubic-damping"), (1.0, -1.0)),
    ("tank", ("linear-outflow", "constant-inflow"), (-1.0, 1.0)),
)
"""Hosts, pairs of effects that show only together, and signs that make them cancel over the data's range."""


def bouc_wen(low: float, high: float) -> Hidden:
    """Return hysteresis whose elastic part ends at a displacement between these shares of the largest one."""
    return Hidden(
        "bouc-wen",
        ("velocity", "position"),
        lambda c, _: c["memory"],
        Inner("position", low, high),
        memory=lambda c, s: (
            c["velocity"] - (0.7 * np.abs(c["velocity"]) * c["memory"] + 0.3 * c["velocity"] * np.abs(c["memory"])) / s
        ),
    )


def maxwell(time: float) -> Hidden:
    """Return a spring and a damper in series that forget with this time constant."""
    rate = lambda c, _: c["velocity"] - c["memory"] / time  # noqa: E731
    return Hidden("maxwell", ("velocity",), lambda c, _: c["memory"], memory=rate)


def lugre() -> Hidden:
    """Return bristles that bend by a share of the largest displacement before they slip; from rest they hold more."""

    def bending(c: Columns, s: Any) -> Any:
        slipping = s * (1.0 + 0.5 * np.exp(-((c["velocity"] / (5.0 * s)) ** 2)))
        return c["velocity"] - np.abs(c["velocity"]) * c["memory"] / slipping

    value = lambda c, s: c["memory"] + 0.02 * bending(c, s)  # noqa: E731
    return Hidden("lugre", ("velocity", "position"), value, Inner("position", 0.12, 0.25), memory=bending)


def _remembering() -> Iterator[Setting]:
    for turn, (breach, share) in enumerate(MEMORY_SHARES.items()):
        for place, noise in enumerate((0.01, 0.02, 0.05)):
            # An effect with a jump beside one with a memory is more than the integrator follows.
            effect = SMOOTH_EFFECTS[(3 * turn + place) % len(SMOOTH_EFFECTS)]
            yield Setting(breach, share, FORCED[(turn + place) % 3], noise, effects=(effect,))
    for noise in (0.01, 0.02, 0.05):
        yield Setting("absorber", 0.15, "absorbed-machine", noise)


def _memory(case: AssumptionCase, rng: np.random.Generator) -> tuple[Wanted, ...]:
    if case.breach == "absorber":
        return ()
    # A time constant about that of the motion, where a Maxwell damper is neither a spring nor a damper.
    time = float(np.exp(rng.uniform(np.log(0.15), np.log(0.6))))
    effects = {
        "Bouc-Wen mild": bouc_wen(0.4, 0.8),
        "Bouc-Wen strong": bouc_wen(0.1, 0.3),
        "Maxwell": maxwell(time),
        "LuGre": lugre(),
    }
    return _wanted(case, effects[case.breach], rng)


def _wanted(case: AssumptionCase, effect: Hidden, rng: np.random.Generator) -> tuple[Wanted, ...]:
    """Return the effect at the case's size, its nonlinear parameter drawn."""
    inner = effect.inner
    fraction = float("nan") if inner is None else float(np.exp(rng.uniform(np.log(inner.low), np.log(inner.high))))
    return (Wanted(effect, case.size, -1.0, fraction),)


MEMORY = Family("memory", _remembering, white, beside=_memory, silent=lambda case: ())


def power(role: str, exponent: float) -> Hidden:
    """Return an odd law of one column: sign(x) |x|^p."""
    return Hidden(f"power-{exponent:g}", (role,), lambda c, _: np.sign(c[role]) * np.abs(c[role]) ** exponent)


def _stall(c: Columns, at: Any) -> Any:
    return c["velocity"] * np.exp(-((c["velocity"] / at) ** 4))


LAWS = {
    "stiffness 1.5": power("position", 1.5),
    "stiffness 2.3": power("position", 2.3),
    "drag 1.6": power("velocity", 1.6),
    "drag 1.75": power("velocity", 1.75),
    "stall": Hidden("stall", ("velocity",), _stall, Inner("velocity", 0.3, 0.6)),
}


def _of_other_laws() -> Iterator[Setting]:
    for turn, breach in enumerate(LAWS):
        for place, noise in enumerate((0.01, 0.05)):
            effect = SMOOTH_EFFECTS[(2 * turn + place) % len(SMOOTH_EFFECTS)]
            yield Setting(breach, LAW_SHARE, FORCED[(turn + place) % 3], noise, effects=(effect,))


def _power_law(case: AssumptionCase) -> tuple[str, ...]:
    kind = case.breach.split()[0]
    return (f"power-law-{kind}",) if kind in ("stiffness", "drag") else ()


OTHER_LAWS = Family(
    "other laws",
    _of_other_laws,
    white,
    beside=lambda case, rng: _wanted(case, LAWS[case.breach], rng),
    excused=_power_law,
    silent=lambda case: (),
)


def _turning_over() -> Iterator[Setting]:
    # The size is v0 over the largest speed of the training data.
    for turn, speed in enumerate((0.01, 0.03, 0.1, 0.2, 0.4)):
        for place, noise in enumerate((0.01, 0.05)):
            host, other = (
                FORCED[(turn + place) % 3],
                ("cubic-stiffness", "signed-quadratic-stiffness")[(turn + place) % 2],
            )
            for effects in ((SMOOTH_FRICTION_SLUG,), (SMOOTH_FRICTION_SLUG, other)):
                yield Setting("tanh", speed, host, noise, effects=effects, signs=(-1.0,) * len(effects), bare=False)


def either_friction(case: AssumptionCase, slug: str) -> tuple[str, ...]:
    """Return slugs that name a hidden effect, for families with another breach: a jump may pass for a steep turn."""
    return (slug, SMOOTH_FRICTION_SLUG) if slug == "coulomb-friction" else (slug,)


def _or_sharp(case: AssumptionCase, slug: str) -> tuple[str, ...]:
    return (slug, "coulomb-friction") if slug == SMOOTH_FRICTION_SLUG and case.size <= SHARP else (slug,)


SMOOTH_FRICTION = Family(
    "smooth friction",
    _turning_over,
    white,
    inner=lambda case: {SMOOTH_FRICTION_SLUG: case.size},
    accepted=_or_sharp,
)


def _cancelling() -> Iterator[Setting]:
    # More noise would hide what is left of such a pair.
    for noise in (0.01, 0.02):
        for host, effects, signs in CANCELLING:
            yield Setting("pair", 2.0, host, noise, effects=effects, signs=signs, bare=noise == 0.01)


ONLY_TOGETHER = Family("only together", _cancelling, white)


def _half_seen() -> Iterator[Setting]:
    for noise in (0.01, 0.02, 0.05, 0.1):
        for host in ("half-seen-forced-chain", "half-seen-free-chain"):
            yield Setting("second mass", 1.0, host, noise)


# Of two masses one is neither measured nor simulated.
MISSING_STATE = Family("missing state", _half_seen, white, silent=lambda case: ())
