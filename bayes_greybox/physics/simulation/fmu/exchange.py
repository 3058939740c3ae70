"""An instance for Model Exchange: it is started once, and set to one point after the other."""

import math
from collections import deque
from collections.abc import Sequence
from ctypes import c_double
from typing import Any

import numpy as np

from .description import Description
from .loaded import DEAD, Instance, Key, Ports


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
