"""Order of probabilities and evidence, where rounding does not choose.

Two effects that are one column on the data, such as cubic stiffness and cubic damping of a state that is position and
velocity in one, have one evidence. Its last digits, which depend on the processor, are no reason to name one of them:
values that differ by less than `TIE` stay in their order, which for effects is the catalogue's.
"""

from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np
import pandas as pd

TIE = 1e-6
"""Nats, or share of a probability, up to which two are equal: far above rounding, and far below any evidence."""

SORTED_DIGITS = 6
"""Digits of probabilities that tables and answers are sorted by."""

Item = TypeVar("Item")


def ranked(items: Iterable[Item], nats: Callable[[Item], float]) -> list[Item]:
    """Return items by their nats, largest first; ties stay in their order."""
    in_order = list(items)
    values = np.array([nats(item) for item in in_order], float)
    order = np.argsort(-values, kind="stable")
    with np.errstate(invalid="ignore"):
        # Two impossible ones are a tie.
        falls = -np.diff(values[order]) > TIE
    place = np.concatenate([[0], np.cumsum(falls)])[: len(in_order)]
    return [in_order[i] for i in order[np.lexsort((order, place))]]


def likeliest_first(items: Iterable[Item], probability: Callable[[Item], float]) -> list[Item]:
    """Return items by their probability, largest first; ties stay in their order."""
    return sorted(items, key=lambda item: -round(probability(item), SORTED_DIGITS))


def sorted_by_probability(table: pd.DataFrame, ignore_index: bool = False) -> pd.DataFrame:
    """Return a table by its column `probability`, largest first; ties stay in their order."""
    rounded = table["probability"].round(SORTED_DIGITS).to_numpy(float)
    ordered = table.iloc[np.argsort(-rounded, kind="stable")]
    return ordered.reset_index(drop=True) if ignore_index else ordered
