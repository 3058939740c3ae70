"""Instances of an FMU, with their messages heard; and one for Model Exchange, set to one point after the other."""

import math
import os
from collections import deque
from collections.abc import Callable, Sequence
from ctypes import byref, c_double
from typing import Any, NamedTuple

import numpy as np

from bayes_greybox.running.errors import InputError

from .description import Description
from .files import fmpy

DEAD, FATAL = 3, 4
"""Status of FMI from which on an instance is of no use, and from which on it may not even be freed."""

Key = tuple[tuple[str, float], ...]
"""Parameters of an FMU, sorted, as a key."""


class Ports(NamedTuple):
    """Value references that are set at a point, `starts` where a Co-Simulation starts, and the length of its steps."""

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
    """An instance of an FMU, once there is one, whose messages are appended to a queue."""

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


class Exchange(Instance):
    """An instance for Model Exchange; other parameters are set by starting it anew."""

    def __init__(self, description: Description, messages: deque[str]) -> None:
        super().__init__(description, messages)
        self._key: Key | None = None
        self._eventful, self._began = False, math.inf

    def place(self, key: Key, ports: Ports, t: float, x: np.ndarray, u: np.ndarray) -> None:
        """Set the instance to a point: parameters, time, states in its order, inputs."""
        if self._fmu is None or key != self._key or t < self._began:
            self._start(key, t)
        fmu: Any = self._fmu
        fmu.setTime(t)
        fmu.setContinuousStates((c_double * len(x))(*x.tolist()), len(x))
        if ports.inputs:
            fmu.setReal(ports.inputs, u.tolist())
        if self._eventful:
            # Relations such as v > 0 keep their values until an event is iterated.
            fmu.enterEventMode()
            self._settled(x)
            fmu.enterContinuousTimeMode()

    def along(self, refs: Sequence[int], directions: Sequence[int]) -> list[float]:
        """Return directional derivatives of variables along others, all by one."""
        columns = [self._fmu.getDirectionalDerivative(refs, [ref], [1.0]) for ref in directions]
        return [sum(each) for each in zip(*columns, strict=True)]

    def failed(self, error: Exception) -> None:
        """Discard the instance after a failure that it does not survive."""
        # An instance that refused within an event is still in it.
        if self._eventful or getattr(error, "status", DEAD) >= DEAD:
            self._discard(error)

    def _start(self, key: Key, t: float) -> None:
        description = self._description
        try:
            self._reset()
            self._set_parameters(key)
            self._began = min(description.start, t)
            self._enter_initialization(startTime=self._began)
            self._fmu.exitInitializationMode()
            # It may set its states at its own start: every point has its own.
            timed = self._settled(None)
            self._fmu.enterContinuousTimeMode()
        except Exception as error:
            refusal = self._not_started(error, ": check its parameters")
            self._discard(error)
            raise refusal from error
        self._eventful, self._key = description.eventful or timed, key

    def _settled(self, x: np.ndarray | None) -> bool:
        """Iterate an event at states that it must leave as they are; return True if another is due at some time."""
        changed = False
        for _ in range(100):
            again, ended, _, moved, timed, _ = self._fmu.newDiscreteStates()
            changed = changed or bool(moved)
            if ended:
                raise RuntimeError("it asks for the simulation to end")
            if not again:
                if x is not None and changed:
                    states = (c_double * len(x))()
                    self._fmu.getContinuousStates(states, len(x))
                    if not np.allclose(np.array(states), x, rtol=1e-9, atol=1e-9):
                        raise RuntimeError("it sets its states anew at an event, which no rate can say")
                return timed
        raise RuntimeError("its events do not come to rest")
