"""Checkpoints: folders that keep the chains of a run, so that a stopped run can be resumed."""

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
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
from .sampler.nuts import Files
from .settings import Sampling

CHECKPOINT_EVERY = 10.0
"""Seconds between two checkpoints of a chain."""

FILES = re.compile(r"(of-[a-z]+\.json|chain-\d+-\d+\.npz)")
"""Names of the files in the folder."""


class Checkpoint:
    """The folder of one run, which may sample more than once; made by `checkpoint_in`.

    Attributes:
        accepted: True if the chains in the folder belong to the run that was last passed to `require`.
    """

    def __init__(self, folder: Path, resume: bool, every: float) -> None:
        """Touch no file yet; see `checkpoint_in` for the arguments."""
        self.folder, self.resume, self.every = folder, resume, every
        self._runs, self._begun, self._complete, self.accepted = 0, False, False, False

    def require(self, what: str, record: Mapping[str, Any]) -> None:
        """Require that this run, described by a record in the file `what`, is the one whose chains the folder keeps.

        InputError is raised if it keeps the chains of another run, or cannot be written to.
        """
        if not self._begun:
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
            named = "; ".join(differences[:3] + (["…"] if len(differences) > 3 else []))
            raise InputError(
                f'The draws in "{self.folder}" are of another run: {named}. Go on with what it was, or start anew '
                "without resuming."
            )
        self.accepted = True

    def next_run(self) -> Files:
        """Return the files of the next run of the sampler, by number of the chain and name of its target."""
        self._runs += 1
        run = self._runs
        return lambda chain, name: ChainFile(self.folder / f"chain-{run}-{chain}.npz", self.every, name)

    @property
    def holds_draws(self) -> bool:
        """True if the folder has chains that a run can resume from."""
        return any(file.suffix == ".npz" for file in self._files())

    def complete(self) -> None:
        """Mark the run as finished and its results as stored, so that closing removes the files."""
        self._complete = True

    def close(self) -> None:
        """Remove files that are no longer needed."""
        if self._complete or not self.holds_draws:
            self._remove()

    def _begin(self) -> None:
        self._begun = True
        if self.resume and self.holds_draws:
            return
        if self.resume:
            announce(f'There are no draws in "{self.folder}": sampling starts at the beginning.')
        elif self.holds_draws:
            announce(f'The draws of a stopped run in "{self.folder}" are removed: sampling starts anew.')
        self._remove()

    def _files(self) -> list[Path]:
        return [file for file in self.folder.glob("*") if FILES.fullmatch(file.name)]

    def _remove(self) -> None:
        # Chains first: without the records they would be taken for those of any run.
        for file in sorted(self._files()):
            with suppress(OSError):
                file.unlink()


@contextmanager
def checkpoint_in(
    folder: str | os.PathLike[str], *, resume: bool = False, every: float = CHECKPOINT_EVERY
) -> Iterator[Checkpoint]:
    """Lock the folder of a checkpoint for the duration of a run; `every` are seconds between two of a chain.

    The folder is made if missing, and removed at the end if nothing in it is needed any more. Without `resume`, chains
    in it are removed before sampling. InputError is raised if it cannot be written to, another process uses it, or
    `every` is negative.
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
    place: "str | os.PathLike[str] | Checkpoint | None", resume: bool, every: float
) -> Iterator[Checkpoint | None]:
    """Yield the checkpoint of a call: an open one as it is, that of a folder opened and completed with the call."""
    if place is None and resume:
        raise InputError("resume=True needs checkpoint=, the folder that the run was kept in.")
    if place is None or isinstance(place, Checkpoint):
        yield place
        return
    with checkpoint_in(place, resume=resume, every=every) as checkpoint:
        yield checkpoint
        checkpoint.complete()


def run_facts(model: Program, data: Trajectories, sampling: Sampling, **further: Any) -> dict[str, Any]:
    """Return everything that the draws of a run depend on, `further` included, as plain values."""
    return {
        **asdict(sampling),
        "model": describe(model, data),
        "data": data_facts(data),
        **further,
        "versions": versions(),
    }


def data_facts(data: Trajectories | None) -> str | None:
    """Return the number of rows and a digest of the data, metadata included."""
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
