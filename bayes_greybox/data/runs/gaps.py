"""Runs parted at gaps in which their inputs are unknown."""

import numpy as np
from jaxtyping import Float, Int

# Ratio of a step to the usual ones of its run from which on the run begins anew behind it. It is more than the four of
# `filters.GAP_STEPS`: a differentiator refuses shorter gaps, while this one parts a run unasked. Times may be random
# (of exponential steps 6 % exceed four medians), a short gap costs only a stretch of the inputs, and a new start that
# is not needed costs information.
NEW_RUN_STEPS = 10.0
USUAL_STEPS_SHARE = 0.9  # share of the steps of a run that are certainly no gaps; stamps may be uneven
COMPARED_STEPS = 5  # steps on either side of one that it is compared with
FEWEST_PART_ROWS = 25  # fewest rows of a part: a shorter one has little information and would need a start of its own


def after_gaps(time: Float[np.ndarray, " n"], usual: float = USUAL_STEPS_SHARE) -> list[int]:
    """Return the rows of one run that are the first after a gap; a share `usual` of its steps is certainly no gap."""
    steps = np.diff(time)
    if not len(steps):
        return []
    return (np.flatnonzero(steps > NEW_RUN_STEPS * np.quantile(steps, usual)) + 1).tolist()


def parted(
    time: Float[np.ndarray, " n"], run: Int[np.ndarray, " n"], names: tuple[str, ...]
) -> tuple[Int[np.ndarray, " n"], tuple[str, ...], tuple[str, ...]]:
    """Part runs at gaps, and return the number of each row's part, names of the parts, and remarks.

    A line or a held value from one end of a gap to the other is no measurement of an input, and a path that it drives
    comes out elsewhere: the rows after the gap have a start of their own. Where the spacing of the stamps changes for
    good, there is no gap.
    """
    number, parts, remarks = np.zeros_like(run), [], []
    for r, name in enumerate(names):
        rows = np.flatnonzero(run == r)
        t, edges = time[rows], [0]
        steps = np.diff(t)
        for row in after_gaps(t):
            sides = (steps[max(row - 1 - COMPARED_STEPS, 0) : row - 1], steps[row : row + COMPARED_STEPS])
            usual = max((float(np.median(side)) for side in sides if len(side)), default=np.inf)
            if steps[row - 1] <= NEW_RUN_STEPS * usual:
                continue
            gap = f'"{name}" has no rows from {t[row - 1]:.12g} to {t[row]:.12g}'
            if row - edges[-1] >= FEWEST_PART_ROWS and len(rows) - row >= FEWEST_PART_ROWS:
                edges.append(row)
                remarks.append(f"run {gap}: it begins anew after them")
            else:
                remarks.append(f"run {gap}, and fewer than {FEWEST_PART_ROWS} beside them: its inputs are taken across")
        for k, (first, last) in enumerate(zip(edges, [*edges[1:], len(rows)], strict=True)):
            number[rows[first:last]] = len(parts)
            part_name = f"{name}, part {k + 1}" if k else name
            while part_name in parts or (k and part_name in names):
                part_name += "'"
            parts.append(part_name)
    return number, tuple(parts), tuple(remarks)
