"""Channels that are late: the rate, the states or the input, or a rate that was differenced from exact velocities."""

from collections.abc import Iterator

import numpy as np

from benchmarks.hidden_effects.assumptions.case import (
    AssumptionCase,
    Family,
    Measured,
    Scene,
    Setting,
    Suspect,
    rate_channel,
    seen,
)

STEPS = (0.1, 0.25, 0.5, 1.0, 2.0)
"""Delays, in sampling steps."""

NOISE = (0.01, 0.02, 0.05)
"""Noise of the rate over its RMS."""

FORCED = ("machine", "forced-oscillator", "swept-oscillator")
"""Hosts whose input tells late from early."""

BACKWARD, FORWARD = "backward differences", "forward differences"
"""Rates that are half a step late, and half a step early."""


def _settings() -> Iterator[Setting]:
    # Two rates late, a state alone, the input: a delay of a tenth of a step is asked for only where it can be seen.
    turns = [
        *(("rate", late) for late in STEPS),
        *(("states", late) for late in STEPS),
        *(("position", late) for late in STEPS[1:]),
        *(("input", late) for late in STEPS[1:]),
    ]
    for turn, (breach, late) in enumerate(turns):
        yield Setting(breach, late, FORCED[turn % 3], NOISE[0] if late < 0.25 else NOISE[turn // 2 % 3])
    for turn, (breach, late) in enumerate(((BACKWARD, 0.5), (FORWARD, -0.5)) * 2):
        yield Setting(breach, late, FORCED[(turn // 2 + turn) % 2], NOISE[turn // 2 + 1])
    yield Setting("rate", 0.5, "tank", NOISE[0])
    yield Setting("input", 2.0, "tank", NOISE[0])
    yield Setting("input", 0.5, "series-rlc", NOISE[1])
    yield Setting("rate", 1.0, "series-rlc", NOISE[1])


def _measure(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    case, host = scene.case, scene.case.system
    now, late = seen(scene, part), seen(scene, part, case.size)
    columns, rate = dict(now.columns), now.rate
    if case.breach == "rate":
        rate = late.rate
    elif case.breach in (BACKWARD, FORWARD):
        there = seen(scene, part, np.sign(case.size)).columns[host.equation]
        rate = np.sign(case.size) * (columns[host.equation] - there) / scene.paths[part].step
    else:
        columns |= {name: late.columns[name] for name in _late(case)}
    return Measured(columns, rate + scene.sigma * rng.standard_normal(len(rate)))


def _late(case: AssumptionCase) -> tuple[str, ...]:
    host = case.system
    return {"states": host.states, "position": host.states[:1], "input": host.inputs}[case.breach]


def _suspects(case: AssumptionCase) -> tuple[Suspect, ...]:
    either = not case.system.inputs
    if case.breach in ("rate", BACKWARD, FORWARD):
        return (Suspect("delay", rate_channel(case), case.size, either),)
    # All states late: any of them says so, as the first one's term is by far the largest.
    return (Suspect("delay", (case.breach, *_late(case)), case.size, either),)


FAMILY = Family("delay", _settings, _measure, _suspects)
