"""A chain so far, and the file from which it goes on as if it had never been stopped."""

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
    """A chain between two iterations.

    Attributes:
        state: Leaves of the sampler's state, all that its further draws depend on beside the model's argument.
        done: Iterations, those of the warm-up among them.
        records: Of the iterations after the warm-up, in pieces.
    """

    state: list[Any]
    done: int
    records: tuple[dict[str, np.ndarray], ...] = ()

    def record(self) -> dict[str, np.ndarray]:
        """The pieces as one."""
        return {name: np.concatenate([part[name] for part in self.records]) for name in self.records[0]}

    @property
    def divergences(self) -> int:
        """After the warm-up."""
        return sum(int(part["diverging"].sum()) for part in self.records)


class ChainFile:
    """Where one chain is kept: arrays only, and whole at any moment."""

    def __init__(self, path: Path, every: float, name: str) -> None:
        """Write nothing yet.

        Args:
            path: The file.
            every: Seconds between two times that it is written.
            name: Of what is sampled, from `name_of`.
        """
        self.path, self._every, self._name = path, every, name
        self._last = time.monotonic()
        self._failed = False

    def read(self) -> SoFar | None:
        """The chain that the file holds; None where there is none.

        Raises:
            InputError: It is damaged, or the chain of something else.
        """
        if not self.path.is_file():
            return None
        try:
            with self.path.open("rb") as opened, np.load(opened, allow_pickle=False) as found:
                name, done, names = str(found["name"]), int(found["done"]), [str(each) for each in found["names"]]
                state = [found[f"state_{k}"] for k in range(int(found["leaves"]))]
                record = {each: found[f"record_{k}"] for k, each in enumerate(names)}
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
        """Keep the chain, if it is time to; what cannot be written is said once, and tried again.

        Args:
            chain: The chain.
            now: Whether it is time in any case.
        """
        if not now and time.monotonic() - self._last < self._every:
            return
        record = chain.record() if chain.records else {}
        arrays = {f"state_{k}": np.asarray(leaf) for k, leaf in enumerate(chain.state)}
        arrays |= {f"record_{k}": each for k, each in enumerate(record.values())}
        about = {
            "name": self._name,
            "done": chain.done,
            "leaves": len(chain.state),
            "names": np.array(list(record), str),
        }
        try:
            with whole_file(self.path) as part, part.open("wb") as opened:
                np.savez(opened, **about, **arrays)  # pyright: ignore[reportArgumentType]
        except OSError as error:
            # Hours of sampling are worth more than a copy of them: what was kept before is still there.
            if not self._failed:
                announce(f'Sampling goes on, but cannot be kept in "{self.path}" ({error.strerror or error}).')
            log.info("%s cannot be written: %s", self.path, error)
            self._failed = True
        self._last = time.monotonic()


def name_of(argument: Any, state: list[Any], tune: int, draws: int) -> str:
    """A digest of what a chain is of: the model's argument, where it starts and how long it is.

    Where it starts says what the argument does not: the density there, its gradient, and how the machine rounds.

    Args:
        argument: The model's argument.
        state: Leaves of the state that the chain starts from.
        tune: Iterations of warm-up.
        draws: Draws kept.
    """
    digest = hashlib.sha256(repr((tune, draws)).encode())
    for leaf in (*jax.tree.leaves(argument), *state):
        value = np.asarray(leaf)
        digest.update(repr((value.shape, value.dtype.str)).encode() + value.tobytes())
    return digest.hexdigest()
