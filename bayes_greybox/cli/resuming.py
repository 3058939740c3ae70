"""Runs that are stopped, and go on."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import typer

from bayes_greybox.config import Config
from bayes_greybox.inference.checkpoint import Checkpoint, checkpoint_in
from bayes_greybox.running.errors import InputError

CHECKPOINT = "checkpoint"
"""Folder in that of the results, while a run is not complete."""

NOTHING_YET = "there were no draws yet, and nothing else is kept; the same command starts from the beginning."
"""What is said of a command that was stopped before it sampled."""


@contextmanager
def resumable(folder: Path, settings: Config, resume: bool, name: str = "") -> Iterator[Checkpoint]:
    """The checkpoint of a command; whoever is stopped or refused while it holds draws is told how to go on.

    Args:
        folder: Of the results.
        settings: The configuration.
        resume: Whether to go on with what is there.
        name: Of the model, where the command fits several.

    Raises:
        InputError: What `checkpoint_in` refuses.
    """
    place, every = folder / CHECKPOINT / name, settings.output.checkpoint_every
    with checkpoint_in(place, resume=resume, every=every) as checkpoint:
        try:
            yield checkpoint
        except KeyboardInterrupt:
            kept = checkpoint.accepted and checkpoint.holds_draws
            said = f'the draws so far are in "{place}"; the same command with --resume goes on.'
            typer.echo(f"Stopped: {said if kept else NOTHING_YET}", err=True)
            raise
        except InputError as error:
            if not (checkpoint.accepted and checkpoint.holds_draws):
                raise
            raise InputError(f"{error} Then the same command with --resume goes on with the draws so far.") from error


def complete(folder: Path, names: Iterable[str]) -> None:
    """Remove the checkpoints of several models, whose results are all written.

    Args:
        folder: Of the results.
        names: Of the models.
    """
    for name in names:
        with checkpoint_in(folder / CHECKPOINT / name, resume=True) as checkpoint:
            checkpoint.complete()
    with suppress(OSError):
        (folder / CHECKPOINT).rmdir()
