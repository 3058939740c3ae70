"""Diffrax, whose import takes half a second that a command without free runs need not wait for."""

from typing import Any

import jax


def diffrax() -> Any:
    """The module."""
    # Numbers that its modules make when they are first read are those of no program that is being traced just then.
    with jax.ensure_compile_time_eval():
        import diffrax as module
    return module
