"""The rate of the whole model, simulation + dictionary + f, inside an integrator."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from bayes_greybox.physics.simulation.protocol import Simulation

from .posterior import Learned

WholeRate = Callable[[Array, Array, Array, Any], Array]
"""(t, x [n_state], u [n_input], scaled (θ, weights of f) by learned state) -> dx/dt [n_state]."""


def whole_rate(
    simulation: Simulation, learned: Mapping[str, Learned], columns: Mapping[str, Float[np.ndarray, " n"]]
) -> WholeRate:
    """dx/dt = g(x, u) + e_k (Φ(x, u) θ_k + Ψ̃(x, u) w_k), summed over the learned states k; jumps are rounded.

    Args:
        simulation: g.
        learned: Frames by learned state.
        columns: Values of states and inputs, which say how jumps are rounded.
    """
    smooth, states, inputs = simulation.rounded(columns), simulation.states, simulation.inputs
    frames = {
        name: replace(each.frame, dictionary=each.frame.dictionary.rounded(columns)) for name, each in learned.items()
    }

    def rate_of(t: Array, x: Array, u: Array, args: Mapping[str, tuple[Array, Array]]) -> Array:
        rate = smooth.rate(t, x, u)
        columns = {name: value[None] for name, value in zip((*states, *inputs), (*x, *u), strict=True)}
        for name, (theta, weight) in args.items():
            frame = frames[name]
            Phi, Psi = frame.rows(columns)
            added = frame.target_scale * (Phi[0] @ theta + Psi[0] @ weight)
            rate = rate.at[states.index(name)].add(added)
        return rate

    return rate_of
