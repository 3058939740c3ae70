"""Calls of one function in as many threads as there are cores: NumPy and JAX leave Python free while they compute."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Return the function's value for each item, in their order; the first error is raised once all have ended.

    The function may change nothing that another item's call reads.
    """
    listed = list(items)
    number = min(len(listed), os.cpu_count() or 1)
    if number < 2:
        return [function(item) for item in listed]
    with ThreadPoolExecutor(number) as pool:
        return list(pool.map(function, listed))
