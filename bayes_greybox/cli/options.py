"""Options and arguments that several commands have, and the end of each one's help."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Scheme(StrEnum):
    """Cross-validation schemes."""

    loo = "loo"
    block = "block"
    trajectory = "trajectory"
    future = "future"


ConfigFile = Annotated[Path, typer.Argument(help="Configuration file (TOML).")]
Output = Annotated[
    Path | None, typer.Option("--output", "-o", help="Folder for the results, instead of the config's own.")
]
Seed = Annotated[int | None, typer.Option(help="Seed, instead of the config's own.")]
Draws = Annotated[int | None, typer.Option(help="Posterior draws of each chain.")]
Tune = Annotated[int | None, typer.Option(help="Warm-up draws of each chain.")]
Chains = Annotated[int | None, typer.Option(help="Number of chains.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on with the draws of a run that was stopped.")]
NoProgress = Annotated[bool, typer.Option("--no-progress", help="Show no progress bar.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show nothing but errors, and where the results are.")]
Verbose = Annotated[
    int, typer.Option("--verbose", "-v", count=True, help="Say on stderr what is being done; -vv in more detail.")
]
SchemeOption = Annotated[
    Scheme | None, typer.Option(help="What is left out: single rows (loo), blocks, trajectories, or the future.")
]
BlockOption = Annotated[
    int | None, typer.Option(min=1, help="Rows of a block, or time stamps of a step into the future.")
]
MaxRefits = Annotated[
    int | None, typer.Option(min=0, help="Most exact refits of what the draws cannot predict (10 by default).")
]


@dataclass(frozen=True)
class Run:
    """Options that every command has; `output` is None for the usual folder, `quiet` shows the results' place alone."""

    output: Path | None
    progress: bool
    quiet: bool
    resume: bool = False


def ending(example: str, after: str) -> str:
    """Return the last lines of a command's help: arguments of an example, and of the command that comes next."""
    return f"Example: bayes-greybox {example}\n\nThen: bayes-greybox {after}"
