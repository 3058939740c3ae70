"""Diffrax and what our integrations need of it: its import takes half a second that not every command waits for."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import jax

_one_at_a_time = threading.RLock()


def diffrax() -> Any:
    """Import Diffrax."""
    # Numbers that its modules make when they are first read are those of no program that is being traced just then.
    with jax.ensure_compile_time_eval():
        import diffrax as module
    return module


@contextmanager
def ordered_times() -> Iterator[None]:
    """Keep Diffrax's test that times are in order out of a program, where they are known to be.

    The test would call Python from the program, and a program that does is compiled anew in every process. It is the
    only one that Diffrax makes of a solution that may fail (`throw=False`) with steps as they come (`dt0=None`).
    """
    from equinox import internal

    names: Any = internal
    # Two threads that trace at once would put each other's replacement back in the place of the test.
    with _one_at_a_time:
        tested = names.error_if
        names.error_if = _untested
        try:
            yield
        finally:
            names.error_if = tested


def _untested(values: Any, *_: Any, **__: Any) -> Any:
    return values
