"""Positions and their velocities, where the simulation is code and its equations cannot be read."""

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.simulation.protocol import Simulation

ROUNDING = 1e-9
"""Two columns whose difference has less than this share of their RMS are one."""

ALIKE = 0.02
"""The slope between samples of a state is another state if their difference has less than this share of its RMS."""


def pairs_in_data(simulation: Simulation, data: Trajectories) -> dict[str, str]:
    """States whose rate is another state, with that state.

    The simulation's rate tells it first, evaluated on the data; then the measured rate; then the samples, whose slope
    between neighbours is the mean of the velocity at both: noise on the samples hides it.

    Args:
        simulation: Code that gives the rates of the states.
        data: Measurements.
    """
    within = np.diff(data.run) == 0
    found = {}
    for state in data.state_names:
        known = [simulation.on(data, state), *([data.derivatives[state]] if state in data.derivatives else [])]
        others = [name for name in data.state_names if name != state]
        exact = [name for name in others if any(_apart(data.states[name], rate) < ROUNDING for rate in known)]
        far = {name: _from_slope(data, state, name, within) for name in others}
        near = [name for name in sorted(far, key=lambda name: far[name]) if far[name] < ALIKE]
        if exact or near:
            found[state] = (exact or near)[0]
    return found


def _from_slope(data: Trajectories, state: str, other: str, within: Bool[np.ndarray, " n_step"]) -> float:
    """How far another state is from the slope of a state."""
    if not np.any(within):
        return np.inf
    slope = np.diff(data.states[state])[within] / np.diff(data.time)[within]
    velocity = data.states[other]
    return _apart(((velocity[1:] + velocity[:-1]) / 2)[within], slope)


def _apart(column: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"]) -> float:
    """Difference of two columns over the size of the first; infinite where that is at rest."""
    size = float(np.linalg.norm(column))
    return float(np.linalg.norm(column - other)) / size if size > 0 else np.inf
