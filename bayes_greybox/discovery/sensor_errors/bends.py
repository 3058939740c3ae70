"""Sensors that bend: what they show is no straight line of what they measure, as of a float arm or a coil at its end.

    reading = g x + o + a (x − c)² + b (x − c)³

with g the gain, a the quadratic and b the cubic error, and c the zero of a sensor that passes it, else the middle of
what was measured: about the zero of its unit a temperature in kelvin would have a gain for a bend. No right answer is
beyond the turns next to c; from there on the reading goes on with its gain alone, so that each reading is of one x.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

QUADRATIC, CUBIC = KINDS = ("quadratic error", "cubic error")

POWERS = {QUADRATIC: 2, CUBIC: 3}
"""Power of what is measured that an error grows with."""

BEND_SD = 0.05
"""Prior standard deviation of a bend where what was measured is furthest from c, over how far that is."""

_HALVINGS = 60


@dataclass(frozen=True)
class Curve:
    """What a sensor shows of what it measures, beyond its offset.

    Attributes:
        errors: Coefficients by power, of `POWERS`; nothing bends without any.
        center: c, in the unit of the state.
        gain: g, positive.
    """

    errors: Mapping[int, float] = field(default_factory=dict)
    center: float = 0.0
    gain: float = 1.0

    def bend(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """What is shown beyond a straight line."""
        z = np.clip(x - self.center, *self._turns)
        return sum((size * z**power for power, size in self.errors.items()), np.zeros_like(z))

    def slope(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Derivative of `bend`."""
        z, (low, high) = x - self.center, self._turns
        rising = sum((power * size * z ** (power - 1) for power, size in self.errors.items()), np.zeros_like(z))
        return np.where((z > low) & (z < high), rising, 0.0)

    def shown(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """What the sensor shows of x."""
        return self.gain * x + self.bend(x)

    def measured(self, reading: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """What it measured: the x that it shows so.

        Args:
            reading: Free of its offset.
        """
        if not any(self.errors.values()) or not self.gain > 0:
            return reading / self.gain
        # About the center, on an interval that holds every answer, by halves; the last digits by Newton's step.
        at, finite = reading - self.gain * self.center, np.isfinite(reading)
        reach = float(np.max(np.abs(at[finite]), initial=0.0)) / self.gain + np.finfo(float).tiny
        whole = self.center + np.array([-reach, reach])
        while self.shown(whole)[0] > np.min(reading[finite], initial=np.inf):
            whole[0] -= reach
        while self.shown(whole)[1] < np.max(reading[finite], initial=-np.inf):
            whole[1] += reach
        low, high = (np.full(len(reading), end) for end in whole)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            above = self.shown(middle) > reading
            low, high = np.where(above, low, middle), np.where(above, middle, high)
        x = 0.5 * (low + high)
        slope = self.gain + self.slope(x)
        steep = slope > 1e-6 * self.gain
        better = x + np.where(steep, (reading - self.shown(x)) / np.where(steep, slope, 1.0), 0.0)
        return np.where(finite, better, reading)

    @property
    def _turns(self) -> tuple[float, float]:
        """Where the reading turns on either side of the center, from there: g + 2 a z + 3 b z² = 0."""
        if not any(self.errors.values()):
            return -np.inf, np.inf
        found = np.roots([3 * self.errors.get(3, 0.0), 2 * self.errors.get(2, 0.0), self.gain])
        found = np.real(found[np.isreal(found)])
        return max(found[found < 0], default=-np.inf), min(found[found > 0], default=np.inf)
