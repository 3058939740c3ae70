"""Two effects that show only together: over the data's range most of one is cancelled by the other."""

from collections.abc import Iterator

from benchmarks.hidden_effects.assumptions.case import Family, Setting, white

PAIRS = (
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
"""Hosts, pairs, and signs that make them cancel."""

NOISE = (0.01, 0.02)
"""Noise over the RMS of the rate; more would hide what is left of such a pair."""


def _settings() -> Iterator[Setting]:
    for noise in NOISE:
        for host, effects, signs in PAIRS:
            yield Setting("pair", 2.0, host, noise, effects=effects, signs=signs, bare=noise == NOISE[0])


FAMILY = Family("only together", _settings, white)
