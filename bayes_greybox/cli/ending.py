"""How every command ends: what it shows, and its exit code."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayes_greybox.inference.posterior import Posterior

DONE, BAD_INPUT, NOT_CONVERGED = 0, 2, 3
"""Exit codes; 3 means that results were written but the verdict on convergence is bad."""


def exit_code(fits: Mapping[str, "Posterior"]) -> int:
    """Whether the chains of all fits can be trusted."""
    from bayes_greybox.criticism.convergence import convergence

    return DONE if all(convergence(fit).ok for fit in fits.values()) else NOT_CONVERGED


def show(*parts: Any) -> None:
    """Print texts and tables."""
    from rich.console import Console

    console = Console(highlight=False, markup=False)
    for part in parts:
        console.print(part)
