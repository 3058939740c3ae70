"""The period of a motion, which time scales of latent forces are shares of."""

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.sensor_errors.channels import run_slices

TURN_SHARE = 0.1
"""Share of its range that a state moves between two turns; less is noise and no turn."""


def period_of(data: Trajectories, equation: str) -> float:
    """Return the time in which the studied state goes to and fro; the longest run if it does not.

    Args:
        data: States along time.
        equation: The studied state; for an output the state that turns most often is used.
    """
    names = [equation] if equation in data.state_names else list(data.state_names) or list(data.input_names)
    runs = run_slices(data.run)
    durations = [float(np.ptp(data.time[rows])) for rows in runs]
    turns = max((sum(_turns(data.column(name)[rows]) for rows in runs) for name in names), default=0)
    return float(min(2 * sum(durations) / turns, max(durations))) if turns else max(durations)


def _turns(values: np.ndarray) -> int:
    """Return the number of turns of values by more than a share of their range."""
    least = TURN_SHARE * np.ptp(values)
    if least <= 0:
        return 0
    turns, rising, extreme = 0, 0, values[0]
    for value in values.tolist():
        if rising >= 0 and value > extreme or rising <= 0 and value < extreme:
            if rising == 0 and abs(value - values[0]) < least:
                continue
            rising = rising or (1 if value > values[0] else -1)
            extreme = value
        elif rising and abs(value - extreme) > least:
            turns, rising, extreme = turns + 1, -rising, value
    return turns
