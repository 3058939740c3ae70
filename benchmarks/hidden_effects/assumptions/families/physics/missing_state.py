"""Two masses of which one is neither measured nor simulated."""

from collections.abc import Iterator

from benchmarks.hidden_effects.assumptions.case import Family, Setting, white

NOISE = (0.01, 0.02, 0.05, 0.1)
"""Noise over the RMS of the rate."""


def _settings() -> Iterator[Setting]:
    for noise in NOISE:
        for host in ("half-seen-forced-chain", "half-seen-free-chain"):
            yield Setting("second mass", 1.0, host, noise)


FAMILY = Family("missing state", _settings, white, silent=lambda case: ())
