"""Unfinished chains, and the files from which they are resumed without any change in their draws."""

import hashlib
import logging
import time
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from bayes_greybox.running.errors import InputError
from bayes_greybox.running.stages import announce
from bayes_greybox.running.whole_files import whole_file

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SoFar:
    """A chain between two iterations: leaves of the sampler's state, iterations done, records after the warm-up."""

    state: list[Any]
    done: int
    records: tuple[dict[str, np.ndarray], ...] = ()

    def record(self) -> dict[str, np.ndarray]:
        """Return the records as one."""
        names = self.records[0] if self.records else {}
        return {name: np.concatenate([part[name] for part in self.records]) for name in names}

    @property
    def divergences(self) -> int:
        """Number of divergences after the warm-up."""
        return sum(int(part["diverging"].sum()) for part in self.records)


class ChainFile:
    """The file of one chain: it holds arrays only, and is complete at any moment."""

    def __init__(self, path: Path, every: float, name: str) -> None:
        """Write nothing yet; `every` are seconds between two writes, `name` is from `name_of`."""
        self.path, self._every, self._name = path, every, name
        self._last, self._failed = time.monotonic(), False

    def read(self) -> SoFar | None:
        """Return the chain in the file, None without file; raise InputError if it is damaged or of another run."""
        if not self.path.is_file():
            return None
        try:
            with self.path.open("rb") as opened, np.load(opened, allow_pickle=False) as arrays:
                name, done = str(arrays["name"]), int(arrays["done"])
                state = [arrays[each] for each in arrays.files if each.startswith("state_")]
                record = {each[7:]: arrays[each] for each in arrays.files if each.startswith("record_")}
                whole = len(state) == int(arrays["leaves"]) and (not record or "diverging" in record)
                if not whole:
                    raise KeyError("its state or its record is not whole")
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise InputError(
                f'"{self.path}" is damaged ({error}): remove it, and its chain is sampled from the beginning.'
            ) from error
        if name != self._name:
            raise InputError(
                f'"{self.path}" is the chain of another model or other data, or was begun on a machine that rounds '
                "otherwise: run what was run there, or start anew without resuming."
            )
        return SoFar(state, done, (record,) if record else ())

    def write(self, chain: SoFar, *, now: bool = False) -> None:
        """Write the chain if the last write was long enough ago, or `now`; report a failure once, and go on."""
        if not now and time.monotonic() - self._last < self._every:
            return
        arrays = {f"state_{k}": np.asarray(leaf) for k, leaf in enumerate(chain.state)}
        arrays |= {f"record_{name}": each for name, each in chain.record().items()}
        try:
            with whole_file(self.path) as part, part.open("wb") as opened:
                np.savez(opened, name=self._name, done=chain.done, leaves=len(chain.state), **arrays)  # pyright: ignore[reportArgumentType]
        except OSError as error:
            # Hours of sampling are worth more than a copy of them, and the previous copy is still there.
            if not self._failed:
                announce(f'Sampling goes on, but cannot be kept in "{self.path}" ({error.strerror or error}).')
            log.info("%s cannot be written: %s", self.path, error)
            self._failed = True
        self._last = time.monotonic()


def name_of(argument: Any, state: list[Any], tune: int, draws: int) -> str:
    """Return a digest of the model's argument, the initial state of a chain and its length.

    The initial state has what the argument lacks: the density, its gradient, and how the machine rounds.
    """
    digest = hashlib.sha256(repr((tune, draws)).encode())
    for leaf in (*jax.tree.leaves(argument), *state):
        value = np.asarray(leaf)
        digest.update(repr((value.shape, value.dtype.str)).encode() + value.tobytes())
    return digest.hexdigest()
