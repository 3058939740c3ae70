"""Runs parted where they have a gap in which their inputs are not known."""

import numpy as np
from jaxtyping import Float, Int

NEW_RUN_STEPS = 10.0
"""A step so many times as long as the usual ones of its run is a gap, after which it begins anew.

It is more than the four of `filters.GAP`, from which on no sample is invented between two: that is refused, and this is
done without being asked. Samples are taken at the times that they have, which may be random ones (of exponential steps
6 % are longer than four medians), a short gap costs a stretch of the inputs alone, and a start that is not needed takes
away what a run says of its beginning.
"""

USUAL_STEPS_SHARE = 0.9
"""Share of the steps of a run that are no gaps, whatever the rest are: stamps may be uneven."""

COMPARED_STEPS = 5
"""Steps on either side of one that it is compared with."""

FEWEST_PART_ROWS = 25
"""Rows that a part has at least: a shorter one says little and would need a start of its own."""


def after_gaps(time: Float[np.ndarray, " n"], usual: float = USUAL_STEPS_SHARE) -> list[int]:
    """Rows of one run that are the first after a gap.

    Args:
        time: Its stamps.
        usual: Share of its steps that are no gaps, whatever the rest are.
    """
    steps = np.diff(time)
    if not len(steps):
        return []
    return (np.flatnonzero(steps > NEW_RUN_STEPS * np.quantile(steps, usual)) + 1).tolist()


def parted(
    time: Float[np.ndarray, " n"], run: Int[np.ndarray, " n"], names: tuple[str, ...]
) -> tuple[Int[np.ndarray, " n"], tuple[str, ...], tuple[str, ...]]:
    """Runs that begin anew after a gap.

    A line or a held value from one end of a gap to the other is no measurement of an input, and a path that is driven
    by it comes out elsewhere: what follows has a start of its own. Where the spacing of the stamps changes for good,
    there is no gap.

    Args:
        time: Stamps of all runs.
        run: Number of each row's run.
        names: Their names.

    Returns:
        Number of each row's part, names of the parts, and what was done, or not, in words.
    """
    number, parts, told = np.zeros_like(run), [], []
    for r, name in enumerate(names):
        own = np.flatnonzero(run == r)
        t, edges = time[own], [0]
        for row in after_gaps(t):
            if t[row] - t[row - 1] <= NEW_RUN_STEPS * _usual_beside(t, row):
                continue
            gap = f'"{name}" has no rows from {t[row - 1]:.12g} to {t[row]:.12g}'
            if row - edges[-1] >= FEWEST_PART_ROWS and len(own) - row >= FEWEST_PART_ROWS:
                edges.append(row)
                told.append(f"run {gap}: it begins anew after them")
            else:
                told.append(f"run {gap}, and fewer than {FEWEST_PART_ROWS} beside them: its inputs are taken across")
        for k, (first, last) in enumerate(zip(edges, [*edges[1:], len(own)], strict=True)):
            number[own[first:last]] = len(parts)
            called = f"{name}, part {k + 1}" if k else name
            while called in parts or (k and called in names):
                called += "'"
            parts.append(called)
    return number, tuple(parts), tuple(told)


def _usual_beside(time: Float[np.ndarray, " n"], row: int) -> float:
    """The larger of the usual steps on either side of one."""
    steps = np.diff(time)
    sides = (steps[max(row - 1 - COMPARED_STEPS, 0) : row - 1], steps[row : row + COMPARED_STEPS])
    return max((float(np.median(side)) for side in sides if len(side)), default=np.inf)
