"""Sensors with a gain, an offset, a drift, coarse steps, or an end of their range."""

from collections.abc import Iterator

import numpy as np

from benchmarks.hidden_effects.assumptions.case import (
    SILENT,
    AssumptionCase,
    Family,
    Measured,
    Scene,
    Setting,
    Suspect,
    rate_channel,
    seen,
    white,
)

CONSTANTS = ("constant-force", "constant-inflow", "constant-source")
"""Effects that no data could tell from an offset."""

_BREACHES = (
    ("rate gain", 0.02),
    ("rate gain", -0.02),
    ("input gain", 0.02),
    ("rate offset", 0.05),
    ("position offset", 0.05),
    ("rate drift", 0.1),
    ("quantised rate", 40.0),
    ("quantised rate", 20.0),
    ("quantised position", 60.0),
    ("clipped rate", 0.02),
    ("clipped rate", 0.05),
)


def _settings() -> Iterator[Setting]:
    hosts = ("machine", "forced-oscillator", "swept-oscillator")
    for turn, (breach, size) in enumerate(_BREACHES * 2):
        # Coarse steps take the place of noise: with much of it they would only be more noise.
        noise = 0.01 if "quantised" in breach or turn < len(_BREACHES) else 0.02
        yield Setting(breach, size, hosts[(turn + turn // len(_BREACHES)) % 3], noise)


def _measure(scene: Scene, part: str, rng: np.random.Generator) -> Measured:
    case, host = scene.case, scene.case.system
    clean, train = white(scene, part, rng), seen(scene, "train")
    columns, rate, size = dict(clean.columns), clean.rate, case.size
    channel, _, kind = case.breach.partition(" ")
    if kind == "gain" and channel == "rate":
        rate = (1.0 + size) * rate
    elif kind == "gain":
        columns[host.inputs[0]] = (1.0 + size) * columns[host.inputs[0]]
    elif kind == "offset" and channel == "rate":
        rate = rate + size * scene.rate
    elif kind == "offset":
        columns[host.states[0]] = columns[host.states[0]] + size * scene.spread[host.states[0]]
    elif kind == "drift":
        # From one side to the other over the longest a run lasts.
        stamps = scene.paths[part].at().columns["t"]
        rate = rate + size * scene.rate * (2.0 * stamps / host.stop - 1.0)
    elif case.breach == "quantised rate":
        rate = _quantised(rate, train.rate, size)
    elif case.breach == "quantised position":
        name = host.states[0]
        columns[name] = _quantised(columns[name], train.columns[name], size)
    else:
        end = float(np.quantile(np.abs(train.rate), 1.0 - size))
        rate = np.clip(rate, -end, end)
    return Measured(columns, rate)


def _quantised(values: np.ndarray, over: np.ndarray, levels: float) -> np.ndarray:
    """Rounded to so many levels over the range of other values."""
    step = float(np.ptp(over)) / levels
    return step * np.round(values / step)


def _suspects(case: AssumptionCase) -> tuple[Suspect, ...]:
    host, rate = case.system, rate_channel(case)
    if case.breach == "rate drift":
        return (Suspect("offset", rate), Suspect("correlated noise"))
    return {
        # The whole equation scales: the rate read too large is all else read too small.
        "rate gain": (Suspect("gain"),),
        "input gain": (Suspect("gain", ("input", *host.inputs)),),
        "rate offset": (Suspect("offset"),),
        "position offset": (Suspect("offset"),),
    }.get(case.breach, ())


def _silent(case: AssumptionCase) -> tuple[str, ...]:
    # Coefficients that are all off by the same say nothing else.
    return (*SILENT, "recalibrate") if case.breach.endswith("gain") else SILENT


FAMILY = Family(
    "sensor",
    _settings,
    _measure,
    _suspects,
    excused=lambda case: CONSTANTS if "offset" in case.breach or "drift" in case.breach else (),
    silent=_silent,
)
