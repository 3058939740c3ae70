"""Checkpoints: a folder that holds the chains of a run so far, from which a stopped run goes on."""

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.program import Program
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.locking import locked
from bayes_greybox.running.stages import announce
from bayes_greybox.running.whole_files import remove_parts, write_text

from .kept.groups import data_table
from .kept.model_record import describe
from .kept.netcdf import versions
from .sampler.chain_file import ChainFile
from .settings import Sampling

EVERY = 10.0
"""Seconds between two checkpoints of a chain."""

FILES = re.compile(r"(of-[a-z]+\.json|chain-\d+-\d+\.npz)")
"""Names of what is in the folder."""

SAID = 3
"""Differences between two runs that a refusal names."""


class Checkpoint:
    """The folder of one run, which may sample more than once; made by `checkpoint_in`.

    Attributes:
        accepted: Whether chains in it are, or will be, of what was said last.
    """

    def __init__(self, folder: Path, resume: bool, every: float) -> None:
        """Touch nothing yet.

        Args:
            folder: The folder.
            resume: Whether chains in it go on; else they are removed before the first is sampled.
            every: Seconds between two checkpoints of a chain.
        """
        self.folder, self.resume, self.every = folder, resume, every
        self._runs, self._begun, self._complete = 0, False, False
        self.accepted = False

    def require(self, what: str, record: Mapping[str, Any]) -> None:
        """Say what is about to be sampled, which must be what was sampled before.

        Args:
            what: A word for this record.
            record: All that the draws depend on, as plain values.

        Raises:
            InputError: The folder holds the chains of something else; it cannot be written to.
        """
        self._begin()
        self.accepted = False
        file, now = self.folder / f"of-{what}.json", json.loads(json.dumps(record, default=str))
        try:
            before = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else None
            if before is None:
                write_text(file, json.dumps(now, ensure_ascii=False, indent=1))
        except (OSError, ValueError) as error:
            raise _unusable(self.folder, error) from error
        differences = [] if before is None else list(_differences(now, before))
        if differences:
            said = "; ".join(differences[:SAID]) + ("; …" if len(differences) > SAID else "")
            raise InputError(
                f'The draws in "{self.folder}" are of another run: {said}. Go on with what it was, or start anew '
                "without resuming."
            )
        self.accepted = True

    def next_run(self) -> "RunFiles":
        """Files for the next time that chains are run."""
        self._runs += 1
        return RunFiles(self, self._runs)

    @property
    def holds_draws(self) -> bool:
        """Whether a run that begins here can go on with something."""
        return any(file.suffix == ".npz" for file in self._files())

    def complete(self) -> None:
        """The run is over and its results are where they belong: the folder goes when it is closed."""
        self._complete = True

    def close(self) -> None:
        """Remove what is of no more use."""
        if self._complete or not self.holds_draws:
            self._remove()

    def _begin(self) -> None:
        if self._begun:
            return
        self._begun = True
        if self.resume and not self.holds_draws:
            announce(f'There are no draws in "{self.folder}": sampling starts at the beginning.')
        elif not self.resume and self.holds_draws:
            announce(f'The draws of a stopped run in "{self.folder}" are removed: sampling starts anew.')
        if not (self.resume and self.holds_draws):
            self._remove()

    def _files(self) -> list[Path]:
        return [file for file in self.folder.glob("*") if FILES.fullmatch(file.name)]

    def _remove(self) -> None:
        # Chains first: without the records they would be taken for those of any run.
        for file in sorted(self._files()):
            with suppress(OSError):
                file.unlink()


class RunFiles:
    """The chains of one run of the sampler in a checkpoint."""

    def __init__(self, checkpoint: Checkpoint, run: int) -> None:
        """Touch nothing yet."""
        self._checkpoint, self._run = checkpoint, run

    def chain(self, chain: int, name: str) -> ChainFile:
        """The file of a chain.

        Args:
            chain: Its number.
            name: Of what is sampled.
        """
        return ChainFile(self._checkpoint.folder / f"chain-{self._run}-{chain}.npz", self._checkpoint.every, name)


@contextmanager
def checkpoint_in(
    folder: str | os.PathLike[str], *, resume: bool = False, every: float = EVERY
) -> Iterator[Checkpoint]:
    """Hold the folder of a checkpoint for as long as a run lasts.

    Args:
        folder: The folder, made where it is missing. If nothing in it is of use any more, it goes again.
        resume: Whether chains in it go on.
        every: Seconds between two checkpoints of a chain.

    Raises:
        InputError: It cannot be written to; another process writes to it; seconds that are negative.
    """
    if not every >= 0:
        raise InputError(f"checkpoint_every={every:g} must be a number of seconds, 0 or more.")
    place = Path(folder)
    checkpoint = Checkpoint(place, resume, every)
    try:
        place.mkdir(parents=True, exist_ok=True)
        lock = locked(place)
        lock.__enter__()
    except OSError as error:
        raise _unusable(place, error) from error
    try:
        remove_parts(place)
        yield checkpoint
    finally:
        checkpoint.close()
        lock.__exit__(None, None, None)
        with suppress(OSError):
            place.rmdir()


@contextmanager
def given_checkpoint(
    given: "str | os.PathLike[str] | Checkpoint | None", resume: bool, every: float
) -> Iterator[Checkpoint | None]:
    """The checkpoint of a call: one that is held around it, or a folder's, which is complete when the call is.

    Args:
        given: What the call was given.
        resume: Whether chains in the folder go on.
        every: Seconds between two checkpoints of a chain.

    Raises:
        InputError: What `checkpoint_in` refuses; nothing to resume from.
    """
    if given is None and resume:
        raise InputError("resume=True needs checkpoint=, the folder that the run was kept in.")
    if given is None or isinstance(given, Checkpoint):
        with nullcontext(given) as checkpoint:
            yield checkpoint
        return
    with checkpoint_in(given, resume=resume, every=every) as checkpoint:
        yield checkpoint
        checkpoint.complete()


def run_facts(model: Program, data: Trajectories, sampling: Sampling, **further: Any) -> dict[str, Any]:
    """All that the draws of a run depend on, as plain values.

    Args:
        model: Model.
        data: Training data.
        sampling: Settings.
        **further: Whatever else they depend on.
    """
    return {
        **asdict(sampling),
        "model": describe(model, data),
        "data": data_facts(data),
        **further,
        "versions": versions(),
    }


def data_facts(data: Trajectories | None) -> Any:
    """Data as two words: how many rows, and a digest of them and of all that is known of them."""
    if data is None:
        return None
    digest = hashlib.sha256()
    for each in (data, data.samples):
        if each is not None:
            digest.update(json.dumps(each.metadata(), default=str).encode())
            for name, column in data_table(each).items():
                digest.update(name.encode() + np.ascontiguousarray(column).tobytes())
    return f"{data.n_obs} rows ({digest.hexdigest()[:8]})"


def _differences(now: Any, before: Any, place: str = "") -> Iterator[str]:
    if isinstance(now, dict) and isinstance(before, dict):
        for key in dict.fromkeys([*now, *before]):
            yield from _differences(now.get(key), before.get(key), f"{place}.{key}" if place else key)
    elif now != before:
        yield f"{place} is {_short(now)} and was {_short(before)}"


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _unusable(folder: Path, error: Exception) -> InputError:
    reason = getattr(error, "strerror", None) or error
    return InputError(f'Cannot keep the draws in the folder "{folder}" ({reason}); choose another one.')
