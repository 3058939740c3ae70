"""The period of a motion, which time scales of what remains are shares of."""

import numpy as np

from bayes_greybox.data.trajectories import Trajectories

PLAY = 0.1
"""Share of its range that a state moves between two turns, or it is noise and no turn."""


def period_of(data: Trajectories, equation: str) -> float:
    """Return the time in which the studied state goes to and fro; of one that does not, that of the longest run.

    Args:
        data: States along time.
        equation: The studied state; of an output the state that turns most often.
    """
    names = [equation] if equation in data.state_names else list(data.state_names) or list(data.input_names)
    runs = [np.flatnonzero(data.run == r) for r in dict.fromkeys(data.run.tolist())]
    total = sum(float(np.ptp(data.time[own])) for own in runs)
    turns = max((sum(_turns(data.column(name)[own]) for own in runs) for name in names), default=0)
    longest = max(float(np.ptp(data.time[own])) for own in runs)
    return float(min(2 * total / turns, longest)) if turns else longest


def _turns(values: np.ndarray) -> int:
    """Return how often values turn by more than a share of their range."""
    play = PLAY * np.ptp(values)
    if play <= 0:
        return 0
    turns, rising, extreme = 0, 0, values[0]
    for value in values.tolist():
        if rising >= 0 and value > extreme or rising <= 0 and value < extreme:
            if rising == 0 and abs(value - values[0]) < play:
                continue
            rising = rising or (1 if value > values[0] else -1)
            extreme = value
        elif rising and abs(value - extreme) > play:
            turns, rising, extreme = turns + 1, -rising, value
    return turns
