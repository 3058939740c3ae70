"""One instance of an FMU in a process, which is used again for every point."""

import math
import os
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from ctypes import byref, c_double
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.fmu.description import MODEL_EXCHANGE, Description
from bayes_greybox.data.fmu.reading import fmpy, unpacked

ITERATIONS = 100
"""Turns of an event, at most."""

LIKE = 1e-6
"""Share of its size by which a rate may differ when it is asked again: what an FMU solves for in steps is no nearer."""

ALIKE = 16
"""Points at which an FMU is asked in one order and in the other: a right-hand side remembers nothing."""

DEAD, FATAL = 3, 4
"""Status of FMI from which on an instance is of no use, and from which on nothing may be asked of it at all."""

HEARD = 8
"""Words of an FMU that are kept."""

REMEMBERED = 64
"""Sets of parameters of which it is kept what was found of the FMU with them."""

Key = tuple[tuple[str, float], ...]
"""Parameters of an FMU."""


class Running:
    """The instance of one file; other parameters are set by starting it anew.

    Args:
        description: The FMU's.
    """

    def __init__(self, description: Description) -> None:
        self._lock = threading.RLock()
        self._fmu: Any = None
        self._key: Key | None = None
        self._description, self._eventful, self._began = description, False, math.inf
        self._trusted: dict[Key, bool] = {}
        self._right: dict[Key, bool] = {}
        self.said: deque[str] = deque(maxlen=HEARD)

    def at_each(
        self,
        parameters: Mapping[str, float],
        points: tuple[np.ndarray, np.ndarray, np.ndarray],
        refs: Sequence[int],
        width: int,
        read: Callable[[Any], list[float]],
    ) -> Float[np.ndarray, "n k"]:
        """What is read at points, NaN where the FMU refuses one; one thread at a time.

        Args:
            parameters: What is set before it starts, by name.
            points: Times, its states and its inputs, in its order.
            refs: Value references of these inputs.
            width: How many values are read at a point.
            read: From the instance at a point to values.

        Raises:
            InputError: It cannot be started, or it remembers.
        """
        key = key_of(parameters)
        with self._lock:
            self.said.clear()
            if key not in self._trusted and len(points[0]) > 1:
                some = np.unique(np.linspace(0, len(points[0]) - 1, ALIKE).astype(int))
                first = self._values(key, tuple(x[some] for x in points), refs, width, read)
                again = self._values(key, tuple(x[some[::-1]] for x in points), refs, width, read)[::-1]
                size = np.max(np.abs(np.nan_to_num(first)), axis=0, initial=0.0)
                if not np.all(np.isclose(first, again, rtol=LIKE, atol=LIKE * size, equal_nan=True)):
                    raise InputError(
                        f"The FMU {self._description.name} remembers: at the same states and time it gives other rates "
                        "after it was asked at other points (a delay, a mode of friction, a discrete state), and a "
                        "right-hand side must not; export it without, and leave what remembers to the study."
                    )
                _keep(self._trusted, key, True)
            return self._values(key, points, refs, width, read)

    def right(self, parameters: Mapping[str, float]) -> bool | None:
        """Whether the FMU's own derivatives were found to be those of its rates; None if nobody looked."""
        return self._right.get(key_of(parameters))

    def found_right(self, parameters: Mapping[str, float], right: bool) -> None:
        """Keep whether they are."""
        _keep(self._right, key_of(parameters), right)

    def _values(
        self, key: Key, points: Any, refs: Sequence[int], width: int, read: Callable[[Any], list[float]]
    ) -> np.ndarray:
        found = np.full((len(points[0]), width), math.nan)
        for k, (t, x, u) in enumerate(zip(*points, strict=True)):
            if self._fmu is None or key != self._key or t < self._began:
                self._start(key, float(t))
            try:
                self._move(float(t), x, u, refs)
                found[k] = read(self._fmu)
            except Exception as error:
                # FMPy has classes of its own only for some of what goes wrong.
                self.said.append(str(error))
                # An instance that refused within an event is still in it.
                if self._eventful or getattr(error, "status", DEAD) >= DEAD:
                    self._drop(error)
        return found

    def _drop(self, error: Exception) -> None:
        """Leave an instance that is of no use."""
        fmu, self._fmu = self._fmu, None
        if fmu is not None and getattr(fmu, "component", None) and getattr(error, "status", DEAD) < FATAL:
            fmu.freeInstance()

    def _start(self, key: Key, t: float) -> None:
        from fmpy.fmi2 import FMU2Model

        found, interface = self._description, self._description.interfaces[MODEL_EXCHANGE]
        try:
            if self._fmu is None:
                # The folder has to live as long as the instance, which may read its resources at any time.
                self._folder = unpacked(found)
                here = os.getcwd()
                try:
                    self._fmu = FMU2Model(
                        guid=found.guid, unzipDirectory=self._folder.name, modelIdentifier=interface.identifier
                    )
                finally:
                    # FMPy stays in the folder of a library that cannot be loaded.
                    os.chdir(here)
                self._callbacks = _callbacks(self.said)
                self._fmu.instantiate(callbacks=self._callbacks)
            else:
                self._fmu.reset()
            for name, value in key:
                self._fmu.setReal([found.variables[name].ref], [value])
            self._began = min(found.start, t)
            self._fmu.setupExperiment(startTime=self._began)
            self._fmu.enterInitializationMode()
            self._fmu.exitInitializationMode()
            timed = self._settled()
            self._fmu.enterContinuousTimeMode()
        except Exception as error:
            words = "; ".join([*self.said][-2:]) or str(error)
            self._drop(error)
            raise InputError(f"The FMU {found.name} cannot be started ({words}): check its parameters.") from error
        self._eventful, self._key = found.eventful or timed, key

    def _move(self, t: float, x: np.ndarray, u: np.ndarray, refs: Sequence[int]) -> None:
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


def running(description: Description) -> Running:
    """The instance of an FMU's file in this process."""
    return _running(description, os.getpid())


def key_of(parameters: Mapping[str, float]) -> Key:
    """Parameters as what tells them from others."""
    return tuple(sorted((name, float(value)) for name, value in parameters.items()))


@lru_cache(maxsize=16)
def _running(description: Description, process: int) -> Running:
    return Running(description)


def _keep(known: dict[Key, bool], key: Key, value: bool) -> None:
    """Keep what was found of a key, in the place of the oldest if there are many."""
    if len(known) >= REMEMBERED:
        known.pop(next(iter(known)))
    known[key] = value


def _callbacks(said: deque[str]) -> Any:
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
