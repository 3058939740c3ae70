"""Sensors that bend: their reading is no straight line, as of a float arm or a coil at its end.

    reading = g x + o + a (x − c)² + b (x − c)³

with g the gain, a the quadratic and b the cubic error, and c the zero of a sensor that passes it, else the middle of
the measured range: about the zero of its unit a temperature in kelvin would have a gain for a bend. No right answer is
beyond the turns next to c; from there on the reading goes on with its gain alone, so that each reading is of one x.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

QUADRATIC, CUBIC = BEND_ERRORS = ("quadratic error", "cubic error")

BEND_POWERS = {QUADRATIC: 2, CUBIC: 3}
"""Power of the measured state that an error grows with."""

BEND_SD = 0.05
"""Prior standard deviation of a bend where the measured state is furthest from c, over that distance."""


@dataclass(frozen=True)
class Curve:
    """Reading of a sensor as a function of the state that it measures, beyond its offset; errors by `BEND_POWERS`."""

    errors: Mapping[int, float] = field(default_factory=dict)
    center: float = 0.0
    gain: float = 1.0

    def bend(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Return the part of the reading beyond a straight line."""
        z = np.clip(x - self.center, *self._turns)
        return sum((size * z**power for power, size in self.errors.items()), np.zeros_like(z))

    def slope(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Return the derivative of `bend`."""
        z, (low, high) = x - self.center, self._turns
        rising = sum((power * size * z ** (power - 1) for power, size in self.errors.items()), np.zeros_like(z))
        return np.where((z > low) & (z < high), rising, 0.0)

    def shown(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Return the reading of x."""
        return self.gain * x + self.bend(x)

    def measured(self, reading: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the x of each reading that is free of its offset."""
        if not any(self.errors.values()) or not self.gain > 0:
            return reading / self.gain
        # Halve an interval about the center that holds every answer; Newton's steps give the last digits.
        finite = np.isfinite(reading)
        at = reading[finite] - self.gain * self.center
        reach = float(np.max(np.abs(at), initial=0.0)) / self.gain + np.finfo(float).tiny
        ends = self.center + np.array([-reach, reach])
        while self.shown(ends)[0] > np.min(reading[finite], initial=np.inf):
            ends[0] -= reach
        while self.shown(ends)[1] < np.max(reading[finite], initial=-np.inf):
            ends[1] += reach
        low, high = (np.full(len(reading), end) for end in ends)
        # Halvings of the interval that holds the state, then Newton's steps for the last digits.
        for _ in range(30):
            middle = 0.5 * (low + high)
            above = self.shown(middle) > reading
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        x = 0.5 * (low + high)
        for _ in range(2):
            slope = self.gain + self.slope(x)
            steep = slope > 1e-6 * self.gain
            x = x + np.where(
                steep & finite, (np.where(finite, reading, 0.0) - self.shown(x)) / np.where(steep, slope, 1.0), 0.0
            )
        return np.where(finite, x, reading)

    @property
    def _turns(self) -> tuple[float, float]:
        """Return the turns of the reading on either side of the center: g + 2 a z + 3 b z² = 0."""
        if not any(self.errors.values()):
            return -np.inf, np.inf
        roots = np.roots([3 * self.errors.get(3, 0.0), 2 * self.errors.get(2, 0.0), self.gain])
        roots = np.real(roots[np.isreal(roots)])
        return max(roots[roots < 0], default=-np.inf), min(roots[roots > 0], default=np.inf)
