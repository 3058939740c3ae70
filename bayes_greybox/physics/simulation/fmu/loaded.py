"""The library of an FMU, loaded, with its messages heard; and the variables that are set at a point."""

import os
from collections import deque
from collections.abc import Callable, Sequence
from ctypes import byref
from typing import Any, NamedTuple

from bayes_greybox.running.errors import InputError

from .description import Description
from .files import fmpy

DEAD, FATAL = 3, 4
"""Status of FMI from which on an instance is of no use, and from which on it may not even be freed."""

Key = tuple[tuple[str, float], ...]
"""Parameters of an FMU, sorted, as a key."""


class Ports(NamedTuple):
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


def instantiated(description: Description, messages: deque[str]) -> Any:
    """Instantiate an FMU by FMPy, with the calls of FMI 2.0; its messages are appended to the queue."""
    from fmpy import fmi2, fmi3

    def heard(*event: Any) -> None:
        status, _, message = event[-3:]
        if status > 1 and message:
            messages.append(message.decode("utf-8", "replace").strip())

    here, exchanged = os.getcwd(), description.exchanged
    about: dict[str, Any] = {
        "guid": description.guid,
        # It lives as long as the description, as the instance may read its resources at any time.
        "unzipDirectory": str(description.folder),
        "modelIdentifier": description.identifier,
    }
    try:
        if description.version == "3.0":
            kind = fmi3.FMU3Model if exchanged else fmi3.FMU3Slave
            fmu: Any = kind(**about, instanceName=description.name)
        else:
            fmu = (fmi2.FMU2Model if exchanged else fmi2.FMU2Slave)(**about)
    finally:
        # FMPy stays in the folder of a library that cannot be loaded.
        os.chdir(here)
    # FMPy keeps the callbacks as long as the instance lives.
    if description.version == "3.0":
        fmu.instantiate(logMessage=heard)
        fmu.getReal, fmu.setReal, fmu.newDiscreteStates = fmu.getFloat64, fmu.setFloat64, fmu.updateDiscreteStates
    else:
        fmu.instantiate(callbacks=_callbacks(heard))
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

    def _set_parameters(self, key: Key) -> None:
        for name, value in key:
            self._fmu.setReal([self._description.variables[name].ref], [value])

    def _enter_initialization(self, **experiment: float) -> None:
        if self._description.version == "3.0":
            self._fmu.enterInitializationMode(**experiment)
        else:
            self._fmu.setupExperiment(**experiment)
            self._fmu.enterInitializationMode()

    def _discard(self, error: Exception) -> None:
        """Free an instance that is of no use; after a fatal error nothing may be asked of it."""
        self._fmu, fmu = None, self._fmu
        if fmu is not None and getattr(fmu, "component", None) and getattr(error, "status", DEAD) < FATAL:
            fmu.freeInstance()

    def _reset(self) -> None:
        """Reset the instance, or make a new one where there is none or it refuses."""
        if self._fmu is not None:
            try:
                self._fmu.reset()
            except Exception as error:
                self._discard(error)
        if self._fmu is None:
            self._fmu = instantiated(self._description, self._messages)

    def _not_started(self, error: Exception, remedy: str = "") -> InputError:
        words = "; ".join([*self._messages][-2:]) or str(error)
        return InputError(f"The FMU {self._description.name} cannot be started ({words}){remedy}.")


def _callbacks(heard: Callable[..., None]) -> Any:
    from fmpy import fmi2, logging

    library = fmpy()
    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(heard)
    callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(library.calloc)
    callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(library.free)
    logging.addLoggerProxy(byref(callbacks))
    return callbacks
