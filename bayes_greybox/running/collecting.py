"""How often Python looks for garbage."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

SELDOM = (50_000, 10, 10)
"""New objects between two searches, and searches between two of older objects; the last are Python's own."""


@contextmanager
def seldom_collected() -> Iterator[None]:
    """Search for garbage seldom in some work that makes many objects that stay: modules, programs as they are traced.

    Python searches all 700 new objects, and in a command that is a tenth of what it does before the first answer.
    """
    before = gc.get_threshold()
    if before == SELDOM:
        # Who asked for it first, in whatever thread, ends it.
        yield
        return
    gc.set_threshold(*SELDOM)
    try:
        yield
    finally:
        gc.set_threshold(*before)


def leave_collected() -> None:
    """Spare a process that ends its last search for garbage: the system takes all memory back anyway.

    Of a command's modules and programs that search takes most of a second, in which the user waits for the prompt.
    """
    gc.freeze()
