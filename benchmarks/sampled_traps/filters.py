"""Rates that a filter computed from positions, of a machine whose rate jumps."""

import numpy as np

from bayes_greybox.data.trajectories import Trajectories

from .trap import Trap, generator, multisine, noisy

FINER = 200
"""Plain steps between two samples: a mass that sticks has no smooth equation that a solver could follow."""


def filter_traps() -> list[Trap]:
    """All of them."""
    return [_filtered_coulomb()]


def _filtered_coulomb() -> Trap:
    """Friction of 0.55 N on 1 kg under some 2 N; the position with 2 % noise."""

    def data(seed: int) -> Trajectories:
        rng = generator(seed, 28)
        n, step = 2000, 0.01
        u = multisine(rng, 2.0, 9.0, 4, 1.7)
        fine = u(step / FINER * np.arange(n * FINER))
        x, v, h, found = 0.02, 0.0, step / FINER, np.empty(n)
        for i, push in enumerate(fine.tolist()):
            if i % FINER == 0:
                found[i // FINER] = x
            pull = push - 40 * x - 0.4 * v
            if v == 0.0:
                v = 0.0 if abs(pull) <= 0.55 else h * (pull - np.copysign(0.55, pull))
            else:
                after = v + h * (pull - np.copysign(0.55, v))
                # What would turn round within a step comes to rest first.
                v = after if after * v > 0 else 0.0
            x += h * v
        return Trajectories.from_arrays(
            step * np.arange(n), states={"x": noisy(rng, found, 0.02)}, inputs={"u": fine[::FINER]}
        )

    return Trap(
        "filtered-coulomb",
        "Dry friction that sticks, behind rates that a filter computed: what is smoothed there looks rounded.",
        {"x": "v", "v": "-40*x - 0.4*v + u"},
        "v",
        data,
        rates={"x": "v"},
        allowed=frozenset({"coulomb-friction"}),
    )
