"""An instance for Model Exchange: it is started once, and set to one point after the other."""

import math
from collections import deque
from collections.abc import Sequence
from ctypes import c_double
from typing import Any

import numpy as np

from bayes_greybox.physics.simulation.fmu.description import Description
from bayes_greybox.running.errors import InputError

from .loaded import DEAD, instantiated, left
from .ports import Key, Ports

ITERATIONS = 100
"""Turns of an event, at most."""

STAY = 1e-9
"""Share of its size by which an event may move a state that it says it moved, and still leave it where it was."""


class Exchange:
    """An instance for Model Exchange; other parameters are set by starting it anew.

    Args:
        description: The FMU's.
        said: Where its words are kept.
    """

    def __init__(self, description: Description, said: deque[str]) -> None:
        self._description, self._said = description, said
        self._fmu: Any = None
        self._key: Key | None = None
        self._eventful, self._began = False, math.inf

    def place(self, key: Key, ports: Ports, t: float, x: np.ndarray, u: np.ndarray) -> None:
        """Take the instance to a point.

        Args:
            key: Parameters.
            ports: What its inputs are called.
            t: Time.
            x: States, in its order.
            u: Inputs.

        Raises:
            InputError: It cannot be started.
        """
        if self._fmu is None or key != self._key or t < self._began:
            self._start(key, t)
        fmu: Any = self._fmu
        fmu.setTime(t)
        fmu.setContinuousStates((c_double * len(x))(*x.tolist()), len(x))
        if ports.inputs:
            fmu.setReal(ports.inputs, u.tolist())
        if self._eventful:
            # Relations such as v > 0 are what they were until an event is gone through.
            fmu.enterEventMode()
            self._settled(x)
            fmu.enterContinuousTimeMode()

    def real(self, refs: Sequence[int]) -> list[float]:
        """Values of variables where it is."""
        return self._fmu.getReal(refs)

    def along(self, refs: Sequence[int], known: Sequence[int]) -> list[float]:
        """Directional derivatives of variables along others, all by one."""
        found = [self._fmu.getDirectionalDerivative(refs, [ref], [1.0]) for ref in known]
        return [sum(each) for each in zip(*found, strict=True)]

    def failed(self, error: Exception) -> None:
        """It failed at a point: an instance that refused within an event is still in it."""
        if self._eventful or getattr(error, "status", DEAD) >= DEAD:
            self._fmu, fmu = None, self._fmu
            left(fmu, error)

    def _start(self, key: Key, t: float) -> None:
        found = self._description
        try:
            if self._fmu is not None:
                self._reset(self._fmu)
            if self._fmu is None:
                self._fmu = instantiated(found, self._said)
            for name, value in key:
                self._fmu.setReal([found.variables[name].ref], [value])
            self._began = min(found.start, t)
            self._fmu.setupExperiment(startTime=self._began)
            self._fmu.enterInitializationMode()
            self._fmu.exitInitializationMode()
            # It may set its states at its own start: every point has its own.
            timed = self._settled(None)
            self._fmu.enterContinuousTimeMode()
        except Exception as error:
            words = "; ".join([*self._said][-2:]) or str(error)
            self._fmu, fmu = None, self._fmu
            left(fmu, error)
            raise InputError(f"The FMU {found.name} cannot be started ({words}): check its parameters.") from error
        self._eventful, self._key = found.eventful or timed, key

    def _reset(self, fmu: Any) -> None:
        """Reset an instance, or leave one that cannot be."""
        try:
            fmu.reset()
        except Exception as error:
            self._fmu = None
            left(fmu, error)

    def _settled(self, x: np.ndarray | None) -> bool:
        """Go through an event at states that it must leave as they are, and whether another one is due at some time."""
        changed = False
        for _ in range(ITERATIONS):
            again, ended, _, moved, timed, _ = self._fmu.newDiscreteStates()
            changed = changed or bool(moved)
            if ended:
                raise RuntimeError("it asks for the simulation to end")
            if not again:
                if x is not None and changed and not self._stays(x):
                    raise RuntimeError("it sets its states anew at an event, which no rate can say")
                return timed
        raise RuntimeError("its events do not come to rest")

    def _stays(self, x: np.ndarray) -> bool:
        """Whether its states are what they were set to."""
        held = (c_double * len(x))()
        self._fmu.getContinuousStates(held, len(x))
        return bool(np.allclose(np.array(held), x, rtol=STAY, atol=STAY))
