"""Friction that turns over smoothly, tanh(v / v0), alone and beside another effect.

Its own name is right, and "coulomb-friction" too where the motion hardly ever is as slow as v0: up to SHARP of the
largest speed, where fewer than about one row in twenty lies between.
"""

from collections.abc import Iterator

from benchmarks.hidden_effects.assumptions.case import AssumptionCase, Family, Setting, white

SHARP = 0.03
"""Largest share of the largest speed at which the friction is held to be Coulomb's."""

SPEEDS = (0.01, 0.03, 0.1, 0.2, 0.4)
"""v0 over the largest speed of the training data."""

NOISE = (0.01, 0.05)
"""Noise over the RMS of the rate."""

SMOOTH = "smooth-friction"
"""Its slug."""


def _settings() -> Iterator[Setting]:
    hosts = ("machine", "forced-oscillator", "swept-oscillator")
    for turn, speed in enumerate(SPEEDS):
        for place, noise in enumerate(NOISE):
            host = hosts[(turn + place) % 3]
            yield Setting("tanh", speed, host, noise, effects=(SMOOTH,), signs=(-1.0,), bare=False)
            other = ("cubic-stiffness", "signed-quadratic-stiffness")[(turn + place) % 2]
            yield Setting("tanh", speed, host, noise, effects=(SMOOTH, other), signs=(-1.0, -1.0), bare=False)


def either_friction(case: AssumptionCase, slug: str) -> tuple[str, ...]:
    """Slugs that name a hidden effect, for families with another breach: a jump may be taken for a steep turn."""
    return (slug, SMOOTH) if slug == "coulomb-friction" else (slug,)


def _accepted(case: AssumptionCase, slug: str) -> tuple[str, ...]:
    return (slug, "coulomb-friction") if slug == SMOOTH and case.size <= SHARP else (slug,)


FAMILY = Family(
    "smooth friction",
    _settings,
    white,
    inner=lambda case: {SMOOTH: case.size},
    accepted=_accepted,
)
