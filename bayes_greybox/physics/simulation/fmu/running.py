"""One instance of an FMU in a process, which is used again for every point."""

import math
import os
import threading
from collections.abc import Callable, Hashable
from ctypes import byref, c_double
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.fmu.description import MODEL_EXCHANGE
from bayes_greybox.data.fmu.reading import fmpy, unpacked

from .given import FMU

ITERATIONS = 100
"""Turns of an event, at most."""

ALIKE = 16
"""Points at which an FMU is asked in one order and in the other: a right-hand side remembers nothing."""

DEAD = 3
"""Status of FMI from which on an instance is of no use."""

Key = Hashable
"""What an FMU and its parameters are known by."""


class Running:
    """The instance of one file; parameters of another user of it are set by starting it anew.

    Args:
        given: The first user.
    """

    def __init__(self, given: FMU) -> None:
        self._lock, self._trusted = threading.RLock(), set()
        self._fmu: Any = None
        self._key: Any = None
        self._description, self._eventful, self._began = given.description, False, math.inf
        self.said: list[str] = []

    def at_each(
        self,
        given: FMU,
        key: Key,
        points: tuple[np.ndarray, np.ndarray, np.ndarray],
        read: Callable[[Any], list[float]],
    ) -> Float[np.ndarray, "n k"]:
        """What is read at points, NaN where the FMU refuses one; one thread at a time.

        Args:
            given: The FMU, with its parameters.
            key: What these are known by.
            points: Times, its states and its inputs, in its order.
            read: From the instance at a point to values.

        Raises:
            InputError: It cannot be started, or it remembers.
        """
        with self._lock:
            if key not in self._trusted and len(points[0]) > 1:
                some = np.unique(np.linspace(0, len(points[0]) - 1, ALIKE).astype(int))
                first = self._values(given, key, tuple(x[some] for x in points), read)
                again = self._values(given, key, tuple(x[some[::-1]] for x in points), read)[::-1]
                if not np.allclose(first, again, rtol=1e-9, atol=1e-12, equal_nan=True):
                    raise InputError(
                        f"The FMU {self._description.name} remembers: at the same states and time it gives other rates "
                        "after it was asked at other points (a delay, a mode of friction, a discrete state), and a "
                        "right-hand side must not; export it without, and leave what remembers to the study."
                    )
                self._trusted.add(key)
            return self._values(given, key, points, read)

    def _values(self, given: FMU, key: Key, points: Any, read: Callable[[Any], list[float]]) -> np.ndarray:
        rows, size = [], 0
        for t, x, u in zip(*points, strict=True):
            if self._fmu is None or key != self._key or t < self._began:
                self._start(given, key, float(t))
            try:
                self._move(float(t), x, u, [v.ref for v in given.input_columns.values()])
                rows.append(read(self._fmu))
                size = len(rows[-1])
            except Exception as error:
                # FMPy has classes of its own only for some of what goes wrong.
                self.said.append(str(error))
                rows.append(None)
                if getattr(error, "status", DEAD) >= DEAD:
                    self._fmu = None
        return np.array([[math.nan] * size if row is None else row for row in rows]).reshape(len(rows), size)

    def _start(self, given: FMU, key: Key, t: float) -> None:
        from fmpy.fmi2 import FMU2Model

        found, interface = self._description, self._description.interfaces[MODEL_EXCHANGE]
        try:
            if self._fmu is None:
                self._fmu = FMU2Model(
                    guid=found.guid, unzipDirectory=str(unpacked(found)), modelIdentifier=interface.identifier
                )
                self._callbacks = _callbacks(self.said)
                self._fmu.instantiate(callbacks=self._callbacks)
            else:
                self._fmu.reset()
            for name, value in given.parameters.items():
                self._fmu.setReal([found.variables[name].ref], [float(value)])
            self._began = min(found.start, t)
            self._fmu.setupExperiment(startTime=self._began)
            self._fmu.enterInitializationMode()
            self._fmu.exitInitializationMode()
            timed = self._settled()
            self._fmu.enterContinuousTimeMode()
        except Exception as error:
            self._fmu = None
            words = "; ".join(self.said[-2:]) or str(error)
            raise InputError(f"The FMU {found.name} cannot be started ({words}): check its parameters.") from error
        self._eventful, self._key = found.eventful or timed, key

    def _move(self, t: float, x: np.ndarray, u: np.ndarray, refs: list[int]) -> None:
        fmu = self._fmu
        fmu.setTime(t)
        fmu.setContinuousStates((c_double * len(x))(*x), len(x))
        if refs:
            fmu.setReal(refs, [float(each) for each in u])
        if self._eventful:
            # Relations such as v > 0 are what they were until an event is gone through.
            fmu.enterEventMode()
            self._settled()
            fmu.enterContinuousTimeMode()

    def _settled(self) -> bool:
        """Go through an event, and whether another one is due at some time."""
        for _ in range(ITERATIONS):
            again, ended, _, moved, timed, _ = self._fmu.newDiscreteStates()
            if ended:
                raise RuntimeError("it asks for the simulation to end")
            if moved:
                raise RuntimeError("it sets its states anew at an event, which no rate can say")
            if not again:
                return timed
        raise RuntimeError("its events do not come to rest")


def running(given: FMU) -> Running:
    """The instance of an FMU's file in this process."""
    return _running(given.description, os.getpid())


@lru_cache(maxsize=16)
def _running(description: Any, process: int) -> Running:
    return Running(FMU(description.file))


def _callbacks(said: list[str]) -> Any:
    """Callbacks of an instance, whose words are kept."""
    from fmpy import fmi2, logging

    library = fmpy()

    def hear(environment: Any, instance: bytes, status: int, category: bytes, message: bytes) -> None:
        if status > 1 and message:
            said.append(message.decode("utf-8", "replace").strip())

    found = fmi2.fmi2CallbackFunctions()
    found.logger = fmi2.fmi2CallbackLoggerTYPE(hear)
    found.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(library.calloc)
    found.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(library.free)
    logging.addLoggerProxy(byref(found))
    return found
