"""Samples at which a sensor was at its end, and shows less than there is."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.trajectories import Trajectories

from .sample_noise import sample_noise

CLIPPED_IN_A_ROW = 3
"""So many samples in a row at the very end of a sensor's range are clipped."""

MOST_CLIPPED = 0.5
"""Share of the samples from which on a channel rests and is not clipped."""

MANY_LEVELS = 0.5
"""Different values over samples below which a sensor is coarse."""


def clipped(values: Mapping[str, Float[np.ndarray, " n"]], run: np.ndarray) -> dict[str, Bool[np.ndarray, " n"]]:
    """Rows at which a channel's sensor was at its end, by channel; channels without any are left out.

    Args:
        values: Samples by channel.
        run: Run of each row.
    """
    found: dict[str, Any] = {}
    for name, x in values.items():
        if len(np.unique(x)) < MANY_LEVELS * len(x):
            # A coarse sensor stays on its last level at every turn.
            continue
        at_end = np.zeros(len(x), bool)
        for end in (float(np.max(x)), float(np.min(x))):
            here = x == end
            for r in np.unique(run):
                own = here[run == r]
                # Where it stays there once, every sample there is clipped.
                if np.any(np.convolve(own, np.ones(CLIPPED_IN_A_ROW), "valid") >= CLIPPED_IN_A_ROW):
                    at_end |= here
        if 0 < np.mean(at_end) < MOST_CLIPPED:
            found[name] = at_end
    return found


def clipped_states(samples: Trajectories) -> dict[str, Bool[np.ndarray, " n_obs"]]:
    """Samples at which the sensor of a state was at its end, by state; states that are never clipped are left out.

    Args:
        samples: What the sensors showed.
    """
    names = samples.state_names
    noise = sample_noise(samples.time, samples.matrix(names), samples.run_lengths)
    # Without noise a state at rest stays to the last bit.
    noisy = {name: samples.states[name] for name, s in zip(names, noise, strict=True) if s > 0}
    return clipped(noisy, samples.run)


def clipped_in_words(name: str, rows: Bool[np.ndarray, " n"]) -> str:
    """What is said of a channel whose sensor was at its end.

    Args:
        name: The channel.
        rows: Where it was.
    """
    return f"{name} is clipped at {int(np.sum(rows))} samples, which are left out"


def seen_samples(samples: Trajectories) -> Bool[np.ndarray, " n_obs"]:
    """Samples that no sensor clipped; what a clipped one would have shown is not known.

    Args:
        samples: What the sensors showed.
    """
    if samples.unseen is not None:
        return ~samples.unseen
    return ~np.any([np.zeros(samples.n_obs, bool), *clipped_states(samples).values()], axis=0)
