"""Runs parted where they have a gap in which their inputs are not known."""

import numpy as np
from jaxtyping import Float, Int

GAP = 10.0
"""A step so many times as long as the usual ones of its run is a gap: nothing is said of what was between."""

USUAL = 0.9
"""Share of the steps of a run that are no gaps, whatever the rest are: stamps may be uneven."""

FEWEST = 25
"""Rows that a part has at least: a shorter one says little and would need a start of its own."""


def after_gaps(time: Float[np.ndarray, " n"], usual: float = USUAL) -> list[int]:
    """Rows of one run that are the first after a gap.

    Args:
        time: Its stamps.
        usual: Share of its steps that are no gaps, whatever the rest are.
    """
    steps = np.diff(time)
    if not len(steps):
        return []
    return (np.flatnonzero(steps > GAP * np.quantile(steps, usual)) + 1).tolist()


def parted(
    time: Float[np.ndarray, " n"], run: Int[np.ndarray, " n"], names: tuple[str, ...]
) -> tuple[Int[np.ndarray, " n"], tuple[str, ...], tuple[str, ...]]:
    """Runs that begin anew after a gap.

    A line or a held value from one end of a gap to the other is no measurement of an input, and a path that is driven
    by it comes out elsewhere: what follows has a start of its own.

    Args:
        time: Stamps of all runs.
        run: Number of each row's run.
        names: Their names.

    Returns:
        Number of each row's part, names of the parts, and what was done, in words.
    """
    number, parts, told = np.zeros_like(run), [], []
    for r, name in enumerate(names):
        own = np.flatnonzero(run == r)
        edges = [0]
        for row in after_gaps(time[own]):
            if row - edges[-1] >= FEWEST and len(own) - row >= FEWEST:
                edges.append(row)
        for first, last in zip(edges, [*edges[1:], len(own)], strict=True):
            number[own[first:last]] = len(parts)
            parts.append(f"{name} from {time[own[first]]:.6g}" if first else name)
            if first:
                before, after = time[own[first - 1]], time[own[first]]
                told.append(
                    f'run "{name}" parted at its gap from {before:.6g} to {after:.6g}, in which no input was measured'
                )
    return number, tuple(parts), tuple(told)
