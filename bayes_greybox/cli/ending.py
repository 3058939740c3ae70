"""How every command ends: what it shows, and its exit code."""

from collections.abc import Mapping
from typing import Any

DONE, BAD_INPUT, NOT_CONVERGED = 0, 2, 3
"""Exit codes; 3 means that results were written but the verdict on convergence is bad."""


def exit_code(fits: Mapping[str, Any]) -> int:
    """Whether the chains of all fits can be trusted."""
    return DONE if all(result.verdict.ok for result in fits.values()) else NOT_CONVERGED


def show(*parts: Any) -> None:
    """Print texts and tables."""
    from rich.console import Console

    console = Console(highlight=False, markup=False)
    for part in parts:
        console.print(part)
