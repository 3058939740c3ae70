"""Forces that remember: Bouc–Wen hysteresis, an attached absorber, a Maxwell damper and LuGre friction.

None of them is in the catalogue, so that every name of the catalogue's for what they do is wrong.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.hidden_effects.assumptions.case import AssumptionCase, Family, Setting, white
from benchmarks.hidden_effects.assumptions.hosts import SMOOTH_EFFECTS
from benchmarks.hidden_effects.systems.hidden import Hidden, Inner
from benchmarks.hidden_effects.systems.hosts import Columns
from benchmarks.hidden_effects.systems.search import Wanted

NOISE = (0.01, 0.02, 0.05)
"""Noise over the RMS of the rate."""

SHARES = {"Bouc-Wen mild": 0.15, "Bouc-Wen strong": 0.4, "Maxwell": 0.25, "LuGre": 0.2}
"""RMS of each force over that of the rate."""

ABSORBER = "absorbed-machine"
"""Host with a second mass that nobody measures."""


def bouc_wen(low: float, high: float) -> Hidden:
    """Hysteresis whose elastic part ends at a displacement between these shares of the largest one."""
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
    """A spring and a damper in series that forget with this time constant."""
    return Hidden(
        "maxwell",
        ("velocity",),
        lambda c, _: c["memory"],
        memory=lambda c, _: c["velocity"] - c["memory"] / time,
    )


def lugre() -> Hidden:
    """Bristles that bend by a share of the largest displacement before they slip; more force is needed from rest."""

    def bending(c: Columns, s: Any) -> Any:
        slipping = s * (1.0 + 0.5 * np.exp(-((c["velocity"] / (5.0 * s)) ** 2)))
        return c["velocity"] - np.abs(c["velocity"]) * c["memory"] / slipping

    return Hidden(
        "lugre",
        ("velocity", "position"),
        lambda c, s: c["memory"] + 0.02 * bending(c, s),
        Inner("position", 0.12, 0.25),
        memory=bending,
    )


def _settings() -> Iterator[Setting]:
    hosts = ("machine", "forced-oscillator", "swept-oscillator")
    for turn, (breach, share) in enumerate(SHARES.items()):
        for place, noise in enumerate(NOISE):
            # An effect with a jump beside one with a memory is more than the integrator follows.
            effect = SMOOTH_EFFECTS[(3 * turn + place) % len(SMOOTH_EFFECTS)]
            yield Setting(breach, share, hosts[(turn + place) % 3], noise, effects=(effect,))
    for noise in NOISE:
        yield Setting("absorber", 0.15, ABSORBER, noise)


def _beside(case: AssumptionCase, rng: np.random.Generator) -> tuple[Wanted, ...]:
    if case.breach == "absorber":
        return ()
    # A time constant about that of the motion, where a Maxwell damper is neither a spring nor a damper.
    time = float(np.exp(rng.uniform(np.log(0.15), np.log(0.6))))
    effect = {
        "Bouc-Wen mild": bouc_wen(0.4, 0.8),
        "Bouc-Wen strong": bouc_wen(0.1, 0.3),
        "Maxwell": maxwell(time),
        "LuGre": lugre(),
    }[case.breach]
    inner = effect.inner
    fraction = float("nan") if inner is None else float(np.exp(rng.uniform(np.log(inner.low), np.log(inner.high))))
    return (Wanted(effect, case.size, -1.0, fraction),)


FAMILY = Family("memory", _settings, white, beside=_beside, silent=lambda case: ())
