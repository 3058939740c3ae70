"""The library of an FMU, loaded, with its words heard."""

import os
from collections import deque
from collections.abc import Callable
from ctypes import byref
from typing import Any

from bayes_greybox.physics.simulation.fmu.description import Description
from bayes_greybox.physics.simulation.fmu.files import fmpy

DEAD, FATAL = 3, 4
"""Status of FMI from which on an instance is of no use, and from which on nothing may be asked of it at all."""


def instantiated(description: Description, said: deque[str]) -> Any:
    """An instance by FMPy.

    Args:
        description: Of the FMU.
        said: Where its words are kept.
    """
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
    # It keeps them as long as it lives.
    fmu.instantiate(callbacks=_callbacks(said.append))
    return fmu


def left(fmu: Any, error: Exception | None = None) -> None:
    """Free an instance that is of no use.

    Args:
        fmu: The instance, if there is one.
        error: What it failed by; after a fatal one nothing may be asked of it.
    """
    if fmu is not None and getattr(fmu, "component", None) and getattr(error, "status", DEAD) < FATAL:
        fmu.freeInstance()


def _callbacks(hear: Callable[[str], None]) -> Any:
    """Callbacks of an instance, whose words are kept."""
    from fmpy import fmi2, logging

    library = fmpy()

    def heard(environment: Any, instance: bytes, status: int, category: bytes, message: bytes) -> None:
        if status > 1 and message:
            hear(message.decode("utf-8", "replace").strip())

    found = fmi2.fmi2CallbackFunctions()
    found.logger = fmi2.fmi2CallbackLoggerTYPE(heard)
    found.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(library.calloc)
    found.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(library.free)
    logging.addLoggerProxy(byref(found))
    return found
