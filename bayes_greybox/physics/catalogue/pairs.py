"""Positions and their velocities, where the simulation is code and its equations cannot be read."""

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.simulation.protocol import Simulation

SAME_SLOPE = 0.02
"""Share of its RMS by which another state may differ from the slope between samples of a state."""


def pairs_in_data(simulation: Simulation, data: Trajectories) -> dict[str, str]:
    """Return the states whose rate, given by code, is another state, with that state.

    The simulation's rate, evaluated on the data, is decisive; then the measured rate; then the samples, whose slope
    between neighbours is the mean of the velocity at both: noise on the samples hides it.
    """
    within = np.diff(data.run) == 0
    pairs = {}
    for state in data.state_names:
        rates = [simulation.on(data, state), *([data.derivatives[state]] if state in data.derivatives else [])]
        others = [name for name in data.state_names if name != state]
        # Columns that differ by rounding are one.
        exact = [name for name in others if any(_apart(data.states[name], rate) < 1e-9 for rate in rates)]
        distance = {name: _from_slope(data, state, name, within) for name in others}
        near = [name for name in sorted(others, key=lambda name: distance[name]) if distance[name] < SAME_SLOPE]
        if exact or near:
            pairs[state] = (exact or near)[0]
    return pairs


def _from_slope(data: Trajectories, state: str, other: str, within: Bool[np.ndarray, " n_step"]) -> float:
    """Return the difference of another state from the slope of a state."""
    if not np.any(within):
        return np.inf
    slope = np.diff(data.states[state])[within] / np.diff(data.time)[within]
    velocity = data.states[other]
    return _apart(((velocity[1:] + velocity[:-1]) / 2)[within], slope)


def _apart(column: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"]) -> float:
    """Return the difference of two columns over the size of the first; infinite where that is at rest."""
    size = float(np.linalg.norm(column))
    return float(np.linalg.norm(column - other)) / size if size > 0 else np.inf
