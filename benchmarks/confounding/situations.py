"""Three situations in which dictionary and discrepancy compete, in plain NumPy: no code is shared with the inference.

A forced oscillator, dv/dt = F(t) + Φ(y, v)ᵀ θ + δ(y, v), is integrated once for each situation; a replicate measures
its rate with noise of its own. States and force are exact, so that nothing but δ and the noise is between θ and its
estimate.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

RATE_NOISE = 0.05
"""Standard deviation of the measured rate's noise over the RMS of its learned part."""

RECORD_ROWS, DURATION = 150, 30.0
"""Rows of a record, and its length in seconds."""

_SUBSTEPS = 20

Function = Callable[[np.ndarray, np.ndarray], np.ndarray]

TERM_VALUES: Mapping[str, Function] = {"y": lambda y, v: y, "v": lambda y, v: v, "y**3": lambda y, v: y**3}
"""Terms of the dictionaries, written here as NumPy functions."""


@dataclass(frozen=True)
class Situation:
    """Terms of a dictionary, and the part that it lacks.

    Attributes:
        name: Name.
        theta: True coefficient of each term of the dictionary.
        missing: δ(y, v), which no term of the dictionary is meant to be.
    """

    name: str
    theta: Mapping[str, float]
    missing: Function


SITUATIONS = (
    Situation("complete", {"y": -2.0, "v": -0.3, "y**3": -1.0}, lambda y, v: np.zeros_like(y)),
    Situation("dissimilar", {"y": -2.0, "v": -0.3}, lambda y, v: np.cos(1.5 * y)),
    Situation("overlapping", {"y": -2.0, "v": -0.3}, lambda y, v: -(y**3)),
)


@dataclass(frozen=True)
class Records:
    """Replicates of one situation: the same path, noise of its own each.

    Attributes:
        situation: The situation.
        t: Times.
        y: Positions.
        v: Velocities.
        force: F.
        rates: Measured dv/dt of each replicate.
        noise: Standard deviation of their noise.
    """

    situation: Situation
    t: Float[np.ndarray, " n_obs"]
    y: Float[np.ndarray, " n_obs"]
    v: Float[np.ndarray, " n_obs"]
    force: Float[np.ndarray, " n_obs"]
    rates: Float[np.ndarray, "n_replicate n_obs"]
    noise: float

    def overlap(self) -> float:
        """Return the share of ‖δ‖² on the record that a least-squares fit of the dictionary can copy; 0 where δ = 0."""
        delta = self.situation.missing(self.y, self.v)
        if not np.any(delta):
            return 0.0
        copied = self._Phi(self.y, self.v) @ self.projected("empirical")
        return float(np.sum(copied**2) / np.sum(delta**2))

    def projected(self, measure: str) -> Float[np.ndarray, " n_term"]:
        """Return the addition of δ to θ when δ is projected on the dictionary: H⁻¹⟨Φ, δ⟩, by a measure.

        That is "empirical", the states of the record, or "box", uniform on their bounding box.
        """
        y, v = self.y, self.v
        if measure == "box":
            # A midpoint rule, fine enough that its error is far below the coefficients' scatter.
            sides = [np.linspace(x.min(), x.max(), 801) for x in (y, v)]
            y, v = (side.ravel() for side in np.meshgrid(*((s[1:] + s[:-1]) / 2 for s in sides), indexing="ij"))
        return np.linalg.lstsq(self._Phi(y, v), self.situation.missing(y, v), rcond=None)[0]

    def _Phi(self, y: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.column_stack([TERM_VALUES[name](y, v) for name in self.situation.theta])


def records(situation: Situation, replicates: int, seed: int) -> Records:
    """Measure replicates of one situation; the first of many are the same as those of few."""
    t = np.linspace(0.0, DURATION, RECORD_ROWS)
    y, v = _integrated(situation, t)
    learned = _rate(situation, y, v)
    noise = RATE_NOISE * float(np.sqrt(np.mean(learned**2)))
    rng = np.random.default_rng([seed, SITUATIONS.index(situation)])
    measured = learned + _force(t) + noise * rng.standard_normal((replicates, len(t)))
    return Records(situation, t, y, v, _force(t), measured, noise)


def _force(t: np.ndarray) -> np.ndarray:
    # Two frequencies without a common period: the record fills its box of states instead of tracing one orbit.
    return np.asarray(1.5 * np.cos(1.1 * t) + 1.5 * np.cos(2.7 * t + 1.0))


def _rate(situation: Situation, y: np.ndarray, v: np.ndarray) -> np.ndarray:
    return sum((value * TERM_VALUES[name](y, v) for name, value in situation.theta.items()), situation.missing(y, v))


def _integrated(situation: Situation, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Integrate by Runge–Kutta of order four from rest at y = 1."""

    def rate(time: float, x: np.ndarray) -> np.ndarray:
        y, v = x[:1], x[1:]
        return np.concatenate([v, _force(np.array([time])) + _rate(situation, y, v)])

    x, path = np.array([1.0, 0.0]), []
    h = (t[1] - t[0]) / _SUBSTEPS
    for start in t:
        path.append(x)
        for i in range(_SUBSTEPS):
            s = start + i * h
            k1 = rate(s, x)
            k2 = rate(s + h / 2, x + h / 2 * k1)
            k3 = rate(s + h / 2, x + h / 2 * k2)
            k4 = rate(s + h, x + h * k3)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return tuple(np.array(path).T)
