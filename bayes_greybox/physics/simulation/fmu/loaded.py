"""The library of an FMU, loaded, with its messages heard; and the variables that are set at a point."""

import os
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from ctypes import byref
from dataclasses import dataclass
from typing import Any

from bayes_greybox.running.errors import InputError

from .description import Description
from .files import fmpy

DEAD, FATAL = 3, 4
"""Status of FMI from which on an instance is of no use, and from which on it may not even be freed."""

Key = tuple[tuple[str, float], ...]
"""Parameters of an FMU, as a key."""


@dataclass(frozen=True)
class Ports:
    """Value references of the variables that are set at a point.

    Attributes:
        inputs: Inputs.
        states: States, in order.
        starts: Variables that set the states where a Co-Simulation starts.
        step: Length of its steps.
    """

    inputs: tuple[int, ...]
    states: tuple[int, ...]
    starts: tuple[int, ...]
    step: float


def key_of(parameters: Mapping[str, float]) -> Key:
    """Return parameters as a key."""
    return tuple(sorted((name, float(value)) for name, value in parameters.items()))


def instantiated(description: Description, messages: deque[str]) -> Any:
    """Instantiate an FMU by FMPy; its messages are appended to the queue."""
    from fmpy.fmi2 import FMU2Model, FMU2Slave

    here, kind = os.getcwd(), FMU2Model if description.exchanged else FMU2Slave
    try:
        # The folder lives as long as the description, as the instance may read its resources at any time.
        fmu = kind(
            guid=description.guid,
            unzipDirectory=str(description.folder),
            modelIdentifier=description.interface.identifier,
        )
    finally:
        # FMPy stays in the folder of a library that cannot be loaded.
        os.chdir(here)
    # FMPy keeps the callbacks as long as the instance lives.
    fmu.instantiate(callbacks=_callbacks(messages.append))
    return fmu


class Instance:
    """An instance of an FMU, once there is one.

    Args:
        description: Description of the FMU.
        messages: Queue for its messages.
    """

    def __init__(self, description: Description, messages: deque[str]) -> None:
        self._description, self._messages = description, messages
        self._fmu: Any = None

    def real(self, refs: Sequence[int]) -> list[float]:
        """Return values of variables at the present point."""
        return self._fmu.getReal(refs)

    def _discard(self, error: Exception) -> None:
        """Free an instance that is of no use; after a fatal error nothing may be asked of it."""
        self._fmu, fmu = None, self._fmu
        if fmu is not None and getattr(fmu, "component", None) and getattr(error, "status", DEAD) < FATAL:
            fmu.freeInstance()

    def _reset(self) -> None:
        """Reset the instance, or discard one that refuses."""
        if self._fmu is not None:
            try:
                self._fmu.reset()
            except Exception as error:
                self._discard(error)

    def _not_started(self, error: Exception, remedy: str = "") -> InputError:
        words = "; ".join([*self._messages][-2:]) or str(error)
        return InputError(f"The FMU {self._description.name} cannot be started ({words}){remedy}.")


def _callbacks(hear: Callable[[str], None]) -> Any:
    from fmpy import fmi2, logging

    library = fmpy()

    def heard(environment: Any, instance: bytes, status: int, category: bytes, message: bytes) -> None:
        if status > 1 and message:
            hear(message.decode("utf-8", "replace").strip())

    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(heard)
    callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(library.calloc)
    callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(library.free)
    logging.addLoggerProxy(byref(callbacks))
    return callbacks
