"""Split of a first configuration: rows that are held out, and runs that are too short for any."""

from collections.abc import Mapping
from typing import NamedTuple

SHARES = (0.2, 0.25, 0.3, 0.4)
"""Shares of each run that may be held out: the first one that leaves enough rows in both parts."""

FEWEST_RATES, FEWEST_TRAINED = 4, 20
"""Rows of rates that each part of a run should have; rows of training data: fewer tell little from noise."""

SMALLEST_WINDOW, LARGEST_WINDOW = 7, 301
"""Bounds on the window of a filter, which is no longer than a quarter of the shortest run that it is chosen for."""


class Split(NamedTuple):
    """Rows that are held out.

    Attributes:
        share: Share of the data; None if there are too few rows to hold any out.
        whole_runs: True if whole runs are held out, in place of the end of each.
        left_out: Names of runs with too few rows to be studied at all.
        needed: Rows that each part of a run must have.
    """

    share: float | None
    whole_runs: bool
    left_out: tuple[str, ...]
    needed: int


def split_of(lengths: Mapping[str, int], n_state: int | None, filtered: bool) -> Split:
    """Choose the split of runs, by their numbers of rows.

    `n_state` is the number of states whose path is followed along samples, None for rows of rates, which may be
    computed by a filter from the samples around them.
    """
    needed = FEWEST_RATES if n_state is None else 2 * n_state + 2
    whole = needed + SMALLEST_WINDOW - 1 if filtered else needed
    left_out = tuple(name for name, rows in lengths.items() if rows < whole)
    kept = [rows for name, rows in lengths.items() if name not in left_out]
    if not kept:
        return Split(None, False, (), needed)
    shortest = min(kept)
    for share in SHARES:
        first = round((1.0 - share) * shortest)
        # The held-out part is filtered by the window of the first one.
        window = min(max(first // 4 + 2, SMALLEST_WINDOW), LARGEST_WINDOW) if filtered else 1
        training = sum(round((1.0 - share) * rows) - window + 1 for rows in kept)
        if min(first, shortest - first) - window + 1 >= needed and training >= FEWEST_TRAINED:
            return Split(share, False, left_out, needed)
    share = None if len(kept) < 3 or sum(kept) < 2 * FEWEST_TRAINED else max(SHARES[0], 1.0 / len(kept))
    return Split(share and round(share, 2), share is not None, left_out, needed)
