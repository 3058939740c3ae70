"""Points of the noise grid: the discrepancy beside every set of regressors, integrated out.

y = X θ + d + e,  e ~ N(0, v I),  d one of: nothing; sensor noise that hangs together, an Ornstein–Uhlenbeck process; a
latent force w(t) of standard deviation r √v and time scale τ (Álvarez, Luengo & Lawrence 2009), a Matérn-3/2 process on
rates and an Ornstein–Uhlenbeck process along paths; a law f(x) of the states, a Gaussian process with a
squared-exponential kernel of standard deviation r √v (Solin & Särkkä 2020, eq. 59); a force that remembers. Scales of d
are ratios r to the sensor's noise, so that v is common to all points and is integrated out for each set by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

KINDS = NONE, SENSOR, TIME, LAW, MEMORY = "none", "sensor", "time", "law", "memory"
"""Kinds of discrepancy beside a set: none, correlated sensor noise, a latent force, a law, a force that remembers."""

REMAINS = (TIME, LAW, MEMORY)
"""What remains of the system, and is no noise."""

TIME_SCALES = (0.05, 0.2, 1.0, 4.0)
"""Time scales of the latent force, in periods of the motion."""

SENSOR_SCALES = (0.05, 0.2)
"""Time scales of a sensor's noise, in periods: what is slower than the motion is a drift, which has a regressor."""

LENGTH_SCALES = (0.3, 0.6, 1.2)
"""Length scales of f, in half-widths of the box that the data fill."""

STEP = 0.4
"""Decades from one standard deviation of a discrepancy to the next."""

RATIOS = 10.0 ** np.arange(-2.4, 0.41, STEP)
"""Standard deviations of the discrepancy, over the RMS of the gap."""

FEWEST_STEPS = 0.7
"""Time scales below so many sampling steps are white noise."""


@dataclass(frozen=True)
class NoisePoint:
    """One noise model R of the rows, y ~ N(X θ, v R).

    Attributes:
        kind: One of `KINDS`.
        ratio: Standard deviation of the discrepancy over √v.
        scale: Time scale, or length scale in half-widths of the box.
        memory: What is remembered, of a memory.
        shape: Number of the noise's shape: white, or of one of the robust kinds that were found.
        log_prior: Log prior probability among the points of the same kind, with what is known of the shape.
    """

    kind: str
    ratio: float = 0.0
    scale: float = 0.0
    memory: str = ""
    shape: int = 0
    log_prior: float = 0.0

    @property
    def remains(self) -> bool:
        """Return whether it leaves something of the system without a name."""
        return self.kind in REMAINS


def noise_points(
    period: float, step: float, ratios: Sequence[float] | Float[np.ndarray, " n_ratio"], law: bool,
    memories: Sequence[str] = (), shapes: Sequence[float] = (0.0,), noise: float | None = 0.05,
    sensor: Sequence[float] | Float[np.ndarray, " n_ratio"] | None = None,
) -> tuple[NoisePoint, ...]:  # fmt: skip
    """Return the points of the grid.

    Args:
        period: Period of the motion, in units of time.
        step: Sampling step.
        ratios: Standard deviations of the discrepancy over that of the noise.
        law: Whether there are features of f.
        memories: What may be remembered.
        shapes: Log prior of each shape of the noise.
        noise: Prior probability that a sensor's noise hangs together; None where that is known, and no force in time is
            weighed.
        sensor: Standard deviations of noise that hangs together, over that of the noise; `ratios` if it is not given.
    """

    def scales(shares: Sequence[float]) -> list[float]:
        return [period * s for s in shares if period * s > FEWEST_STEPS * step] or [step]

    points = []
    for shape, log_shape in enumerate(shapes):
        points.append(NoisePoint(NONE, shape=shape, log_prior=log_shape + float(np.log1p(-(noise or 0.0)))))
        # Under a shape of the noise that is found and not given, coarser ratios of a discrepancy do.
        coarse = ratios[::2]
        of_force = coarse if shape else ratios
        lengths = LENGTH_SCALES if law else ()
        together = ratios if sensor is None else sensor
        for kind, each, own, log_prior in (
            (
                SENSOR,
                [] if shape or noise is None else scales(SENSOR_SCALES),
                together,
                log_shape + float(np.log(noise or 1.0)),
            ),
            (TIME, [] if noise is None else scales(TIME_SCALES), of_force, log_shape),
            (LAW, lengths, of_force, log_shape),
        ):
            share = log_prior - float(np.log(max(len(each) * len(own), 1)))
            points += [NoisePoint(kind, float(r), float(s), "", shape, share) for s in each for r in own]
        some = () if shape else memories
        share = log_shape - float(np.log(max(len(some) * len(coarse), 1)))
        points += [NoisePoint(MEMORY, float(r), 0.0, m, shape, share) for m in some for r in coarse]
    return tuple(points)
