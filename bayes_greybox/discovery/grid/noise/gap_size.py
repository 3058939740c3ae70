"""Size of the gap as a force, on rows that a force reaches only along a path.

A sample shows the force since the start of its run: the size of the residual says little of the size of the force.
"""

import numpy as np
from jaxtyping import Float

from .latent_force import LatentForce
from .points import TIME_SCALES

FORCE_SIZES = 10.0 ** np.arange(-6.0, 0.6, 0.5)
"""Standard deviations of the force, over that of the target, that are tried: from a millionth to all of it. Half a step
is worth 0.6 nats to the prior of an effect."""

MOTION_SCALES = TIME_SCALES[1:3]
"""Time scales of the force, in periods of the motion: those of the grid that are next to the motion's own."""

PLAUSIBLE = 2.0
"""Nats behind the likeliest size within which a size is plausible: two standard deviations."""


def gap_size(force: LatentForce, target: Float[np.ndarray, " n_row"], free: Float[np.ndarray, "n_row n_free"]) -> float:
    """Return the RMS that the gap may have as a force, over that of the target.

    √(mean(E[w]² + Var[w])) of a latent force w beside the user's model without effects, whose free coefficients are at
    their likeliest: the largest value over plausible time scales and sizes. If nothing is missing, it is the largest
    force that the noise can hide. It is 1 where the residual is zero.

    Args:
        force: Latent force and noise on the rows.
        target: Measurements less the simulation.
        free: The user's own terms at the rows.
    """
    table, ratios, tried = np.column_stack([target, free]), FORCE_SIZES / force.noise, []
    for scale in (force.period * share for share in MOTION_SCALES):
        white, logs = force.whiten(table, scale, ratios)
        for k, ratio in enumerate(ratios.tolist()):
            y, X = white[:, k, 0], white[:, k, 1:]
            theta = np.linalg.lstsq(X, y, rcond=None)[0]
            v = float(np.mean((y - X @ theta) ** 2))
            if v > 0:
                log_evidence = -0.5 * (len(y) * np.log(v) + float(np.sum(logs[:, k])))
                tried.append((log_evidence, scale, ratio, theta, v))
    best, sizes = max((log_evidence for log_evidence, *_ in tried), default=0.0), []
    for log_evidence, scale, ratio, theta, v in tried:
        if log_evidence >= best - PLAUSIBLE:
            mean, variance = force.smooth((target - free @ theta)[:, None], scale, ratio)
            sizes.append(float(np.sqrt(np.mean(mean[:, 0] ** 2 + v * variance))))
    size = max(sizes, default=1.0)
    return size if np.isfinite(size) and size > 0 else 1.0
