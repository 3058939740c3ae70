"""Frequency of Python's garbage collection."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

SELDOM = (50_000, 10, 10)
"""New objects between two searches, and searches between two of older objects; the last two are Python's defaults."""


@contextmanager
def seldom_collected() -> Iterator[None]:
    """Search for garbage seldom during work that makes many lasting objects: modules, programs as they are traced.

    Python searches all 700 new objects; in a command that is a tenth of the time before the first answer.
    """
    before = gc.get_threshold()
    if before == SELDOM:
        # The first caller, in whatever thread, ends it.
        yield
        return
    gc.set_threshold(*SELDOM)
    try:
        yield
    finally:
        gc.set_threshold(*before)
