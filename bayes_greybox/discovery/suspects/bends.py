"""Sensors that bend: what they show is no straight line of what they measure, as of a float arm or a coil at its end.

    reading = (1 + κ) x + o + a x² + b x³

with a the quadratic and b the cubic error. What is read is put right by the root x on the branch through zero, on
which the reading rises. No right answer is beyond its turning point: what is over is put right by the gain alone there.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

QUADRATIC, CUBIC = KINDS = ("quadratic error", "cubic error")

POWERS = {QUADRATIC: 2, CUBIC: 3}
"""Power of what is measured that an error grows with."""

BEND_SD = 0.05
"""Prior standard deviation of a bend at the largest reading, over that reading."""

_HALVINGS = 60


def bent(x: Float[np.ndarray, "*shape"], errors: Mapping[int, float]) -> Float[np.ndarray, "*shape"]:
    """What a sensor that bends shows beyond a straight line, Σ e_p x^p.

    Args:
        x: What is measured.
        errors: Coefficients by power.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return sum((size * x**power for power, size in errors.items()), np.zeros_like(x))


def straightened(reading: Float[np.ndarray, " n"], errors: Mapping[int, float], gain: float = 1.0) -> np.ndarray:
    """What a sensor measured when it read g x + Σ e_p x^p, on the rising branch through zero.

    Args:
        reading: Free of its offset.
        errors: Coefficients by power, of `POWERS`; nothing bends without any.
        gain: g, positive.
    """
    if not any(errors.values()) or not gain > 0:
        return reading / gain
    # Where the reading turns: g + 2 a x + 3 b x² = 0.
    turns = np.roots([3 * errors.get(3, 0.0), 2 * errors.get(2, 0.0), gain])
    turns = np.real(turns[np.isreal(turns)])
    largest = float(np.max(np.abs(reading[np.isfinite(reading)]), initial=0.0)) / gain
    ends = []
    for side in (-1.0, 1.0):
        turn = min((side * each for each in turns if side * each > 0), default=np.inf)
        end = max(largest, np.finfo(float).tiny)
        while end < turn and gain * end + side * float(bent(np.array(side * end), errors)) < gain * largest:
            end *= 2
        ends.append(side * min(end, turn))
    low, high = (np.full(len(reading), end) for end in ends)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        above = gain * middle + bent(middle, errors) > reading
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    x = 0.5 * (low + high)
    # Halving an interval leaves the last digits of what is small in it to Newton's step.
    slope = gain + 2 * errors.get(2, 0.0) * x + 3 * errors.get(3, 0.0) * x**2
    inside = slope > 1e-6 * gain
    step = np.where(inside, (reading - gain * x - bent(x, errors)) / np.where(inside, slope, 1.0), 0.0)
    x = np.clip(x + step, *ends)
    # Values that stayed at an end would look like those of a sensor at its end.
    least, most = (gain * end + float(bent(np.array(end), errors)) for end in ends)
    over = np.maximum(reading - most, 0.0) + np.minimum(reading - least, 0.0)
    return np.where(np.isfinite(reading), x + over / gain, reading)
