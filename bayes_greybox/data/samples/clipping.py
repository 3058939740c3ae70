"""Samples at which a sensor was at the end of its range, so that the true value was beyond it."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.trajectories import Trajectories

from .sample_noise import sample_noise

CLIPPED_IN_A_ROW = 3  # samples in a row at the very end of a sensor's range from which on they are clipped
MOST_CLIPPED = 0.5  # share of samples at the ends from which on a channel rests and is not clipped
MANY_LEVELS = 0.5  # ratio of different values to samples below which a sensor is coarse


def clipped(values: Mapping[str, Float[np.ndarray, " n"]], run: np.ndarray) -> dict[str, Bool[np.ndarray, " n"]]:
    """Mark the rows at which a channel's sensor was at its end, by channel; channels without any are left out."""
    rows: dict[str, np.ndarray] = {}
    for name, x in values.items():
        if len(np.unique(x)) < MANY_LEVELS * len(x):
            continue  # a coarse sensor stays on its last level at every turn
        at_end = np.zeros(len(x), bool)
        for end in (float(np.max(x)), float(np.min(x))):
            here = x == end
            stays = (np.convolve(here[run == r], np.ones(CLIPPED_IN_A_ROW), "valid") for r in np.unique(run))
            # If it stays there once, every sample there is clipped.
            if any(np.any(count >= CLIPPED_IN_A_ROW) for count in stays):
                at_end |= here
        if 0 < np.mean(at_end) < MOST_CLIPPED:
            rows[name] = at_end
    return rows


def clipped_states(samples: Trajectories) -> dict[str, Bool[np.ndarray, " n_obs"]]:
    """Mark the samples at which the sensor of a state was at its end, by state; others are left out."""
    names = samples.state_names
    noise = sample_noise(samples.time, samples.matrix(names), samples.run_lengths)
    # Without noise a state at rest stays to the last bit.
    noisy = {name: samples.states[name] for name, s in zip(names, noise, strict=True) if s > 0}
    return clipped(noisy, samples.run)


def clipped_in_words(name: str, rows: Bool[np.ndarray, " n"]) -> str:
    """Return the remark on a channel that was clipped at some rows."""
    return f"{name} is clipped at {int(np.sum(rows))} samples, which are left out"


def seen_samples(samples: Trajectories) -> Bool[np.ndarray, " n_obs"]:
    """Mark the samples that no sensor clipped; the true value behind a clipped one is unknown."""
    if samples.unseen is not None:
        return ~samples.unseen
    return ~np.any([np.zeros(samples.n_obs, bool), *clipped_states(samples).values()], axis=0)
