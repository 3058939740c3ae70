"""Disturbances for a moment only: a brake that drags, a stop that is touched, an input that is now and then misread.

Most rows know nothing of it. A model that is fitted to all of them spreads it over the record, as a small effect that
is always there.
"""

from collections.abc import Iterator

import numpy as np

from benchmarks.hidden_effects.assumptions.case import AssumptionCase, Family, Measured, Scene, Setting, white
from benchmarks.hidden_effects.systems.hidden import Hidden
from benchmarks.hidden_effects.systems.hosts import Columns
from benchmarks.hidden_effects.systems.ode import ROUGH, Acting, HostODE, LostError
from benchmarks.hidden_effects.systems.trajectories import Excited, follow, rms

from .forces import SMOOTH_FRICTION_SLUG, either_friction

BRAKE, STOP, MISREAD = "brake", "end stop", "input outliers"
"""The size is the share of the record, of the rows of the training data, or of the rows of either part."""

DRAG, TURNING = 0.5, 0.02
"""Force of the brake over the RMS of the rate, and the speed at which it turns over, as a share of the largest."""

BRAKED = (0.3, 0.7)
"""The brake is put on between these parts of the record."""

HARD = 75.0
"""Stiffness of the end stop over that of the spring."""

NEAR, TRIES = 0.005, 14
"""The share of rows at the stop is that close to the wanted one, after so many halvings."""

MISREAD_LEAST, MISREAD_MOST = 1.5, 4.0
"""An input that is misread is recorded so many times too large."""


def _settings() -> Iterator[Setting]:
    tried_in = (
        (BRAKE, 0.04, (("machine", 0.02), ("forced-oscillator", 0.01))),
        (STOP, 0.03, (("forced-oscillator", 0.02), ("swept-oscillator", 0.01))),
        (MISREAD, 0.03, (("swept-oscillator", 0.02), ("machine", 0.05))),
    )
    for breach, size, tried in tried_in:
        for turn, (host, noise) in enumerate(tried):
            # A stop takes much of the motion: what feeds energy in would be left without its size.
            at_stop = (
                {"effects": (("quadratic-drag", "cubic-stiffness")[turn],), "signs": (-1.0,)} if breach == STOP else {}
            )
            yield Setting(breach, size, host, noise, **at_stop)


def brake(start: float, end: float) -> Hidden:
    """Return friction that drags between these times; its nonlinear parameter is the speed at which it turns over."""

    def dragging(c: Columns, turning: float) -> np.ndarray:
        return np.tanh(c["velocity"] / turning) * ((c["t"] >= start) & (c["t"] < end))

    return Hidden("brake", ("velocity",), dragging, steps=100)


END_STOP = Hidden("end-stop", ("position",), lambda c, place: np.maximum(c["position"] - place, 0.0), steps=400)
"""A hard spring beyond a place, its nonlinear parameter."""


def _momentary(case: AssumptionCase, system: HostODE, excited: Excited, rng: np.random.Generator) -> tuple[Acting, ...]:
    if case.breach == BRAKE:
        return (_braking(case, system, excited, rng),)
    return (_stopping(case, system, excited),) if case.breach == STOP else ()


def _braking(case: AssumptionCase, system: HostODE, excited: Excited, rng: np.random.Generator) -> Acting:
    runs, host = follow(system, excited, ROUGH), system.host
    start = float(rng.uniform(*BRAKED))
    fastest = float(np.max(np.abs(runs.columns[host.roles["velocity"]])))
    effect = brake(start * host.stop, (start + case.size) * host.stop)
    return Acting(effect, -DRAG * rms(runs.rates[host.equation]), TURNING * fastest)


def _stopping(case: AssumptionCase, system: HostODE, excited: Excited) -> Acting:
    """Return the stop, at the place where the system touches it in the wanted share of rows."""
    host, position = system.host, system.host.roles["position"]
    stiffness = HARD * abs(system.rates[host.equation][position])
    low, high = 0.0, float(np.max(follow(system, excited, ROUGH).columns[position]))
    for _ in range(TRIES):
        act = Acting(END_STOP, -stiffness, (low + high) / 2.0)
        stopped = HostODE(host, system.rates, (act, *system.acting))
        share = float(np.mean(follow(stopped, excited, ROUGH).columns[position] > act.inner))
        if abs(share - case.size) < NEAR:
            return act
        low, high = (act.inner, high) if share > case.size else (low, act.inner)
    raise LostError("Nowhere is the stop touched in so many rows.")


def _measure(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    clean, case = white(scene, part, rng), scene.case
    if case.breach != MISREAD:
        return clean
    name, rows = case.system.inputs[0], len(clean.rate)
    values = np.array(clean.columns[name])
    hit = rng.choice(rows, round(case.size * rows), replace=False)
    values[hit] *= rng.uniform(MISREAD_LEAST, MISREAD_MOST, len(hit))
    return Measured({**clean.columns, name: values}, clean.rate)


def _excused(case: AssumptionCase) -> tuple[str, ...]:
    # A brake is friction, though not always there.
    return (SMOOTH_FRICTION_SLUG, "coulomb-friction") if case.breach == BRAKE else ()


FOR_A_MOMENT = Family(
    "for a moment",
    _settings,
    _measure,
    momentary=_momentary,
    accepted=either_friction,
    excused=_excused,
    silent=lambda case: (),
)
