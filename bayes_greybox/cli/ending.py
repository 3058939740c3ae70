"""Common ends of all commands: tables, the log, the exit code."""

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from bayes_greybox.running.collecting import seldom_collected
from bayes_greybox.running.errors import InputError

from .spelling import as_typed

if TYPE_CHECKING:
    from bayes_greybox.inference.posterior import Posterior

DONE, BAD_INPUT, NOT_CONVERGED = 0, 2, 3
"""Exit codes; 3 means that results were written but the verdict on convergence is bad."""


def run_app(app: typer.Typer, name: str, arguments: Sequence[str] | None = None) -> int:
    """Run a command line and return the exit code; an error in its words, or in what they name, is one sentence."""
    words = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    try:
        with seldom_collected():
            return int(app(words, prog_name=name, standalone_mode=False) or DONE)
    except InputError as error:
        return _refused(as_typed(words[0], str(error)))
    except typer.Abort:
        return 130
    except Exception as error:
        # A wrong option or argument; Typer's class for these has changed its home, its method has not.
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        return _refused(message())


def _refused(message: str) -> int:
    typer.echo(f"Error: {' '.join(message.split())}", err=True)
    return BAD_INPUT


def exit_code(fits: Mapping[str, "Posterior"]) -> int:
    """Return the exit code for fits: done if the chains of all can be trusted."""
    from bayes_greybox.criticism.convergence import convergence

    return DONE if all(convergence(fit).mixed for fit in fits.values()) else NOT_CONVERGED


def show(*parts: Any) -> None:
    """Print texts and tables; a path is one word, whatever the width, so that a script can read it."""
    from rich.console import Console

    # Rich leaves bold letters where NO_COLOR asks for no colour; without a colour system it writes letters alone.
    console = Console(highlight=False, markup=False, color_system=None if os.environ.get("NO_COLOR") else "auto")
    for part in parts:
        console.print(str(part) if isinstance(part, Path) else part, soft_wrap=isinstance(part, Path))


def log_to_stderr(verbose: int) -> None:
    """Show what the package logs: nothing but warnings at 0, its stages from 1 on, details from 2 on."""
    import logging

    logger, name = logging.getLogger("bayes_greybox"), "bayes-greybox on stderr"
    for handler in [each for each in logger.handlers if each.name == name]:
        logger.removeHandler(handler)
    logger.setLevel({0: logging.NOTSET, 1: logging.INFO}.get(verbose, logging.DEBUG))
    if verbose:
        handler = logging.StreamHandler()
        handler.name = name
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s", "%H:%M:%S"))
        logger.addHandler(handler)
