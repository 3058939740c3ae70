"""Laws beside those of whole powers: powers between them, and a resistance that fades as none of the catalogue does.

Two laws of whole powers together follow each of them closely, and every name is wrong but that of a power law.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.hidden_effects.assumptions.case import AssumptionCase, Family, Setting, white
from benchmarks.hidden_effects.assumptions.hosts import SMOOTH_EFFECTS
from benchmarks.hidden_effects.systems.hidden import Hidden, Inner
from benchmarks.hidden_effects.systems.search import Wanted

NOISE = (0.01, 0.05)
"""Noise over the RMS of the rate."""

SHARE = 0.3
"""RMS of the force over that of the rate."""

FADES_AT = (0.3, 0.6)
"""Speed at which a stalled resistance fades, as a share of the largest."""


def power(role: str, exponent: float) -> Hidden:
    """An odd law of one column: sign(x) |x|^p."""
    return Hidden(f"power-{exponent:g}", (role,), lambda c, _: np.sign(c[role]) * np.abs(c[role]) ** exponent)


def _stall(speed: Any, at: Any) -> Any:
    return speed * np.exp(-((speed / at) ** 4))


LAWS = {
    "stiffness 1.5": power("position", 1.5),
    "stiffness 2.3": power("position", 2.3),
    "drag 1.6": power("velocity", 1.6),
    "drag 1.75": power("velocity", 1.75),
    "stall": Hidden("stall", ("velocity",), lambda c, at: _stall(c["velocity"], at), Inner("velocity", *FADES_AT)),
}


def _settings() -> Iterator[Setting]:
    hosts = ("machine", "forced-oscillator", "swept-oscillator")
    for turn, breach in enumerate(LAWS):
        for place, noise in enumerate(NOISE):
            effect = SMOOTH_EFFECTS[(2 * turn + place) % len(SMOOTH_EFFECTS)]
            yield Setting(breach, SHARE, hosts[(turn + place) % 3], noise, effects=(effect,))


def _beside(case: AssumptionCase, rng: np.random.Generator) -> tuple[Wanted, ...]:
    effect = LAWS[case.breach]
    inner = effect.inner
    fraction = float("nan") if inner is None else float(np.exp(rng.uniform(np.log(inner.low), np.log(inner.high))))
    return (Wanted(effect, case.size, -1.0, fraction),)


def _power_law(case: AssumptionCase) -> tuple[str, ...]:
    kind = case.breach.split()[0]
    return (f"power-law-{kind}",) if kind in ("stiffness", "drag") else ()


FAMILY = Family("other laws", _settings, white, beside=_beside, excused=_power_law, silent=lambda case: ())
