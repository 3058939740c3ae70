"""Points of the noise grid: the discrepancy beside every inclusion set, integrated out.

y = X θ + d + e,  e ~ N(0, v I),  d one of: nothing; correlated sensor noise, an Ornstein–Uhlenbeck process; a latent
force w(t) of standard deviation r √v and time scale τ (Álvarez, Luengo & Lawrence 2009), a Matérn-3/2 process on rates
and an Ornstein–Uhlenbeck process along paths; a law f(x) of the states, a Gaussian process with a squared-exponential
kernel of standard deviation r √v (Solin & Särkkä 2020, eq. 59); a force with memory. Scales of d are ratios r to the
sensor's noise, so that v is common to all points and is integrated out for each set by itself.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float

NO_DISCREPANCY, SENSOR_NOISE, LATENT_FORCE, LAW, MEMORY = "none", "sensor", "time", "law", "memory"

DISCREPANCIES = (NO_DISCREPANCY, SENSOR_NOISE, LATENT_FORCE, LAW, MEMORY)
"""Kinds of discrepancy beside a set: none, correlated sensor noise, a latent force, a law, a force with memory."""

UNNAMED = (LATENT_FORCE, LAW, MEMORY)
"""Discrepancies of the system itself, which have no name and are no noise."""

TIME_SCALES = (0.05, 0.2, 1.0, 4.0)
"""Time scales of the latent force, in periods of the motion."""

SENSOR_SCALES = (0.05, 0.2)
"""Time scales of a sensor's noise, in periods; slower noise may be a force on the machine."""

OUTPUT_SCALES = (0.05, 0.13, 0.32, 0.8)
"""Time scales of an output's noise, which no force reaches through the motion, in periods; slower noise is a drift."""

LENGTH_SCALES = (0.3, 0.6, 1.2)
"""Length scales of f, in half-widths of the box that the data fill."""

RATIO_DECADES = 0.4
"""Decades from one standard deviation of a discrepancy to the next."""

GAP_RATIOS = 10.0 ** np.arange(-2.4, 0.41, RATIO_DECADES)
"""Standard deviations of the discrepancy, over the RMS of the gap."""


@dataclass(frozen=True)
class NoisePoint:
    """One noise model R of the rows, y ~ N(X θ, v R).

    Attributes:
        ratio: Standard deviation of the discrepancy over √v.
        scale: Time scale, or length scale in half-widths of the box.
        shape: Number of the noise's shape: 0 is white, others are robust shapes that a residual spoke for.
        log_prior: Log prior probability among the points of the same kind, with the prior of the shape.
    """

    kind: str
    ratio: float = 0.0
    scale: float = 0.0
    memory: str = ""
    shape: int = 0
    log_prior: float = 0.0

    @property
    def unnamed(self) -> bool:
        """Return true if something of the system remains without a name."""
        return self.kind in UNNAMED


@dataclass(frozen=True)
class NoiseGrid:
    """Settings of a noise grid: standard deviations over that of the white noise, and time scales in periods.

    `correlated` is the prior probability that a sensor's noise is; None where that is known, and no force is weighed.
    """

    period: float
    step: float
    ratios: Float[np.ndarray, " n_ratio"]
    sensor_ratios: Float[np.ndarray, " n_ratio"]
    correlated: float | None = 0.05
    law: bool = True
    memories: tuple[str, ...] = ()
    sensor_scales: tuple[float, ...] = SENSOR_SCALES

    def points(self, shapes: Sequence[float] = (0.0,)) -> tuple[NoisePoint, ...]:
        """Return the points of the grid."""
        points: list[NoisePoint] = []
        for shape, log_shape in enumerate(shapes):
            # A shape found on a residual is weighed on coarser ratios, without correlation or memory.
            coarse = self.ratios[::2]
            ratios = coarse if shape else self.ratios
            families: list[tuple[str, Sequence[float] | np.ndarray, Sequence[float], Sequence[str], float]]
            families = [(NO_DISCREPANCY, (0.0,), (0.0,), ("",), math.log1p(-(self.correlated or 0.0)))]
            if self.correlated is not None:
                if not shape:
                    scales = self._scales(self.sensor_scales)
                    families.append((SENSOR_NOISE, self.sensor_ratios, scales, ("",), math.log(self.correlated)))
                families.append((LATENT_FORCE, ratios, self._scales(TIME_SCALES), ("",), 0.0))
            if self.law:
                families.append((LAW, ratios, LENGTH_SCALES, ("",), 0.0))
            if self.memories and not shape:
                families.append((MEMORY, coarse, (0.0,), self.memories, 0.0))
            for kind, sizes, scales, memories, log_prior in families:
                share = log_shape + log_prior - math.log(len(sizes) * len(scales) * len(memories))
                every = product(memories, scales, sizes)
                points += [NoisePoint(kind, float(r), s, name, shape, share) for name, s, r in every]
        return tuple(points)

    def _scales(self, shares: Sequence[float]) -> list[float]:
        """Return time scales of at least 0.7 sampling steps: shorter noise is white; the step itself without any."""
        return [self.period * s for s in shares if self.period * s > 0.7 * self.step] or [self.step]
