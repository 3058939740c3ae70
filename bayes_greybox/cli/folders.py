"""Folders of a command's results, and the checkpoints in them with which a stopped run goes on."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import typer

from bayes_greybox.config import Config
from bayes_greybox.inference.checkpoint import Checkpoint, checkpoint_in
from bayes_greybox.report.folders.holding import free_folder, require_own
from bayes_greybox.running.errors import InputError

CHECKPOINT = "checkpoint"
"""Folder within that of the results, while a run is not complete."""


def place_of(folder: Path, command: str, output: Path | None) -> Path:
    """Return the folder for the results of a command, which overwrites no results but its own.

    The usual folder belongs to the first command that was run with it; that of another is FOLDER-COMMAND.
    """
    if output is None:
        return free_folder(folder, command)
    require_own(output, command)
    return output


@contextmanager
def resumable(folder: Path, settings: Config, resume: bool, name: str = "") -> Iterator[Checkpoint]:
    """Hold the checkpoint of a command; a user who is stopped or refused while it has draws is told how to go on.

    If `resume`, the run goes on with the draws that are there; `name` is that of the model, where there are several.
    """
    place, every = folder / CHECKPOINT / name, settings.output.checkpoint_every
    with checkpoint_in(place, resume=resume, every=every) as checkpoint:
        try:
            yield checkpoint
        except KeyboardInterrupt:
            how = "there were no draws yet, and nothing else is kept; the same command starts from the beginning."
            if checkpoint.accepted and checkpoint.holds_draws:
                how = f'the draws so far are in "{place}"; the same command with --resume goes on.'
            typer.echo(f"Stopped: {how}", err=True)
            raise
        except InputError as error:
            if not (checkpoint.accepted and checkpoint.holds_draws):
                raise
            raise InputError(f"{error} Then the same command with --resume goes on with the draws so far.") from error


def complete(folder: Path, names: Iterable[str]) -> None:
    """Remove the checkpoints of several models from a folder, once all results are written."""
    for name in names:
        with checkpoint_in(folder / CHECKPOINT / name, resume=True) as checkpoint:
            checkpoint.complete()
    with suppress(OSError):
        (folder / CHECKPOINT).rmdir()
