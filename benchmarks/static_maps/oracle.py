"""Probabilities of the hidden law to one who knows all else: the noise, the simulation, and how large laws are.

Laws φ_k of the catalogue compete, each with a coefficient of which the size is drawn as the maps draw it:

    y − g = c φ_k + σ W⁻¹ e,   m_k = ∫ p(c) exp(c φ̃ᵀr − c² φ̃ᵀφ̃/2) dc,   r = W(y − g)/σ, φ̃ = W φ_k/σ,

and nothing, m = 1, is as likely beforehand as all laws together. No study that does not know this much can be surer on
average of what is there and be right.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from benchmarks.sampled_systems.samples import CORRELATION

from .maps import HIDDEN, Measured, StaticMap, known, rms

SIZE_NODES, BEND_NODES = 60, 20
"""Points at which sizes and inner parameters are summed over, evenly spaced in their logarithms."""

Values = Float[np.ndarray, " n"]


class Law(NamedTuple):
    """A law of the catalogue.

    Attributes:
        of: The column that its inner parameter is over the largest value of.
        shape: φ, of columns and of that parameter.
        bends: Least and most of it; (1, 1) of a law that has none.
    """

    of: str
    shape: Callable[[dict[str, Values], float], Values]
    bends: tuple[float, float] = (1.0, 1.0)


FORCES = {
    "linear-stiffness": Law("x", lambda c, b: c["x"]),
    "quadratic-stiffness": Law("x", lambda c, b: c["x"] ** 2),
    "cubic-stiffness": Law("x", lambda c, b: c["x"] ** 3),
    "quintic-stiffness": Law("x", lambda c, b: c["x"] ** 5),
    "signed-quadratic-stiffness": Law("x", lambda c, b: c["x"] * np.abs(c["x"])),
    "dead-zone": Law("x", lambda c, b: np.sign(c["x"]) * np.maximum(np.abs(c["x"]) - b, 0), (0.1, 0.8)),
    "bilinear-stiffness": Law("x", lambda c, b: np.maximum(c["x"], 0)),
    "viscous-damping": Law("v", lambda c, b: c["v"]),
    "coulomb-friction": Law("v", lambda c, b: np.sign(c["v"])),
    "smooth-friction": Law("v", lambda c, b: np.tanh(c["v"] / b), (0.02, 0.5)),
    "stribeck-friction": Law("v", lambda c, b: np.sign(c["v"]) * np.exp(-((c["v"] / b) ** 2)), (0.05, 0.6)),
    "exponential-stribeck-friction": Law("v", lambda c, b: np.sign(c["v"]) * np.exp(-np.abs(c["v"]) / b), (0.05, 0.6)),
    "quadratic-drag": Law("v", lambda c, b: c["v"] * np.abs(c["v"])),
    "cubic-damping": Law("v", lambda c, b: c["v"] ** 3),
    "direction-dependent-friction": Law("v", lambda c, b: np.abs(c["v"])),
    "van-der-pol-damping": Law("v", lambda c, b: c["x"] ** 2 * c["v"]),
    "velocity-squared": Law("v", lambda c, b: c["v"] ** 2),
    "position-velocity-coupling": Law("v", lambda c, b: c["x"] * c["v"]),
    "constant-force": Law("x", lambda c, b: np.ones_like(c["x"])),
}
"""Laws of a force over position and speed; a pendulum's sine is a linear spring at these amplitudes."""

FLOWS = {
    "linear-outflow": Law("p", lambda c, b: c["p"]),
    "torricelli-outflow": Law("p", lambda c, b: np.sqrt(c["p"])),
    "overflow": Law("p", lambda c, b: np.maximum(c["p"] - b, 0), (0.5, 0.95)),
    "weir-overflow": Law("p", lambda c, b: np.maximum(c["p"] - b, 0) ** 1.5, (0.5, 0.95)),
    "constant-inflow": Law("p", lambda c, b: np.ones_like(c["p"])),
}
"""Laws of a flow over a pressure."""


def posterior(each: StaticMap, data: Measured) -> dict[str, float]:
    """Return the probability of each law, "" for none, likeliest first."""
    train, laws = data.train, FORCES if each.output == "F" else FLOWS
    columns = dict(train.columns)
    rho = CORRELATION if each.sensor == "correlated" else 0.0
    simulated = known(each, columns)
    r = _white(train, train.rate(each.output) - simulated, rho) / data.noise
    share = np.geomspace(HIDDEN[0], HIDDEN[1], SIZE_NODES) * rms(simulated)
    log_odds = {"": float(np.log(len(laws)))}
    for slug, law in laws.items():
        every, largest = [], float(np.max(np.abs(columns[law.of])))
        for bend in np.unique(np.geomspace(law.bends[0], law.bends[1], BEND_NODES)):
            shape = law.shape(columns, float(bend) * largest)
            c, phi = share / rms(shape), _white(train, shape, rho) / data.noise
            every += [sign * c * (phi @ r) - 0.5 * c**2 * (phi @ phi) for sign in (-1.0, 1.0)]
        log_odds[slug] = float(np.logaddexp.reduce(np.concatenate(every)) - np.log(np.size(every)))
    total = np.logaddexp.reduce(list(log_odds.values()))
    ranked = sorted(log_odds.items(), key=lambda item: -item[1])
    return {slug: float(np.exp(value - total)) for slug, value in ranked}


def _white(train: Trajectories, values: Values, rho: float) -> Values:
    """Return innovations of noise that is correlated from row to row of a run."""
    before = np.concatenate([[0.0], values[:-1]])
    first = np.concatenate([[True], np.diff(train.run) != 0])
    return np.where(first, values, (values - rho * before) / np.sqrt(1 - rho**2))
