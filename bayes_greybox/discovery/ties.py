"""Order of what is compared, where rounding does not choose.

Two effects that are one column on the data, such as cubic stiffness and cubic damping of a state that is position and
velocity in one, have one evidence. What a processor's kernels make of its last digits is no reason to name one of them:
what differs by less than `TIE` is a tie, and stays in the order that it came in, which for effects is the catalogue's.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import TypeVar

import numpy as np
import pandas as pd

TIE = 1e-6
"""Nats, or share of a probability, up to which two are equal: rounding makes far less of it, and no evidence says so
little."""

DIGITS = 6
"""Of probabilities that tables are sorted by again."""

Item = TypeVar("Item")
Key = TypeVar("Key")


def ranked(items: Iterable[Item], nats: Callable[[Item], float]) -> list[Item]:
    """Items, those of most nats first; those that tie stay in their order.

    Args:
        items: In the order that ties stay in.
        nats: What each is compared by.
    """
    found = list(items)
    values = np.array([nats(item) for item in found], float)
    order = np.argsort(-values, kind="stable")
    with np.errstate(invalid="ignore"):
        # What is impossible ties with what else is.
        falls = -np.diff(values[order]) > TIE
    place = np.concatenate([[0], np.cumsum(falls)])[: len(found)]
    return [found[i] for i in order[np.lexsort((order, place))]]


def likeliest_first(probabilities: Mapping[Key, float]) -> dict[Key, float]:
    """The same probabilities, the largest first; those that tie stay in their order.

    Args:
        probabilities: By what they are of.
    """
    with np.errstate(divide="ignore"):
        return dict(ranked(probabilities.items(), lambda item: float(np.log(max(item[1], 0.0)))))


def sorted_by_probability(table: pd.DataFrame, ignore_index: bool = False) -> pd.DataFrame:
    """A table with its likeliest rows first; those that tie stay in their order.

    Args:
        table: With a column `probability`.
        ignore_index: Whether to number its rows anew.
    """
    rounded = table["probability"].round(DIGITS).to_numpy(float)
    found = table.iloc[np.argsort(-rounded, kind="stable")]
    return found.reset_index(drop=True) if ignore_index else found
