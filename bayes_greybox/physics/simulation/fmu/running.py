"""One instance of an FMU in a process, which is used again for every point."""

import math
import os
import threading
from collections import deque
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_greybox.physics.simulation.fmu.description import Description
from bayes_greybox.running.errors import InputError

from .exchange import Exchange
from .ports import Key, Ports, key_of
from .stepping import Stepping, rounding

LIKE = 1e-6
"""Share of its size by which a rate may differ when it is asked again: what an FMU solves for in steps is no nearer."""

ALIKE = 16
"""Points at which an FMU is asked in one order and in the other: a right-hand side remembers nothing."""

NEAR = 1e-3
"""Share of its size by which a rate after a step may differ from the one of an instance that is started there."""

COARSE = 1e-2
"""Share of its size by which rates by steps and by half as long ones may differ."""

AWAY = 10
"""Steps after which this is looked at."""

HEARD = 8
"""Words of an FMU that are kept."""

REMEMBERED = 64
"""Sets of parameters of which it is kept what was found of the FMU with them."""

Points = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Times, states and inputs."""

Read = Callable[[Any], list[float]]
"""From an instance at a point to values."""


class Running:
    """The instance of one file.

    Args:
        description: The FMU's.
    """

    def __init__(self, description: Description) -> None:
        self._lock = threading.RLock()
        self._description = description
        self.said: deque[str] = deque(maxlen=HEARD)
        self._instance = (Exchange if description.exchanged else Stepping)(description, self.said)
        self._trusted: dict[tuple[Key, Ports], bool] = {}
        self._right: dict[Key, bool] = {}

    def at_each(
        self, parameters: Mapping[str, float], points: Points, ports: Ports, width: int, read: Read
    ) -> Float[np.ndarray, "n k"]:
        """What is read at points, NaN where the FMU refuses one; one thread at a time.

        Args:
            parameters: What is set before it starts, by name.
            points: Times, its states and its inputs, in its order.
            ports: What is set at a point.
            width: How many values are read at a point.
            read: From the instance at a point to values.

        Raises:
            InputError: It cannot be started, it remembers, or its steps are too long.
        """
        key = key_of(parameters)
        with self._lock:
            self.said.clear()
            if (key, ports) not in self._trusted and len(points[0]) > 1:
                self._require_forgetful(key, points, ports, width, read)
                _keep(self._trusted, (key, ports), True)
            return self._values(key, points, ports, width, read)

    def right(self, parameters: Mapping[str, float]) -> bool | None:
        """Whether the FMU's own derivatives were found to be those of its rates; None if nobody looked."""
        return self._right.get(key_of(parameters))

    def found_right(self, parameters: Mapping[str, float], right: bool) -> None:
        """Keep whether they are."""
        _keep(self._right, key_of(parameters), right)

    def _require_forgetful(self, key: Key, points: Points, ports: Ports, width: int, read: Read) -> None:
        """Refuse an FMU whose rates are not those of its states and inputs alone."""
        some = np.unique(np.linspace(0, len(points[0]) - 1, ALIKE).astype(int))
        if isinstance(self._instance, Stepping):
            self._instance.noted.clear()
        first = self._values(key, _taken(points, some), ports, width, read)
        again = self._values(key, _taken(points, some[::-1]), ports, width, read)[::-1]
        if not _alike(first, again, LIKE):
            raise InputError(
                f"The FMU {self._description.name} remembers: at the same states and time it gives other rates after "
                "it was asked at other points (a delay, a mode of friction, a discrete state), and a right-hand side "
                "must not; export it without, and leave what remembers to the study."
            )
        if isinstance(self._instance, Stepping):
            self._require_whole(self._instance, key, _taken(points, some), ports, width, read)

    def _require_whole(self, steps: Stepping, key: Key, points: Points, ports: Ports, width: int, read: Read) -> None:
        """Refuse steps that are too long, and states that are not all: a start elsewhere then is another motion."""
        if steps.noted:
            whole, half, unsure = (np.array(each) for each in zip(*steps.noted, strict=True))
            apart = np.abs(whole - half) / np.maximum(np.max(np.abs(half), axis=0), np.finfo(float).tiny)
            # The rate of a state that stands still is rounding, and other rounding by half as long steps.
            apart[:, np.all(np.maximum(np.abs(whole), np.abs(half)) <= unsure, axis=0)] = 0.0
            # A jump of the force within the steps of some points is no fault.
            if (typical := float(np.median(np.max(apart, axis=1)))) > COARSE:
                raise InputError(
                    f"Steps of {ports.step:g} s of the FMU {self._description.name} are too long or too rough: rates "
                    f"by half as long ones differ by {100 * typical:.2g} %; give others, bg.FMU(..., step=...), or "
                    "export it for Model Exchange."
                )
        if not ports.step:
            return
        went, started, least = [], [], 0.0
        for t, x, u in zip(*points, strict=True):
            try:
                steps.place(key, ports, float(t), x, u)
                steps.advance(AWAY)
                there = np.array(steps.real(ports.states))
                one = read(steps)
                steps.place(key, ports, float(t) + AWAY * ports.step, there, u)
                # As one that has gone on, so that both are by whole steps.
                steps.advance(0)
                started.append(read(steps))
                went.append(one)
                # Values that are no rates by steps are not told apart by rounding.
                least = np.maximum(least, rounding(there, ports.step)) if steps.noted else least
            except InputError:
                raise
            except Exception as error:
                steps.failed(error)
        if went and not _alike(np.array(went), np.array(started), NEAR, least):
            raise InputError(
                f"The FMU {self._description.name} has more states than it was given: after some steps it gives other "
                "rates than started at the same states; name all of them, bg.FMU(..., states={'column': 'variable'}), "
                "or export it for Model Exchange."
            )

    def _values(self, key: Key, points: Points, ports: Ports, width: int, read: Read) -> np.ndarray:
        found = np.full((len(points[0]), width), math.nan)
        for k, (t, x, u) in enumerate(zip(*points, strict=True)):
            try:
                self._instance.place(key, ports, float(t), x, u)
                found[k] = read(self._instance)
            except InputError:
                raise
            except Exception as error:
                # FMPy has classes of its own only for some of what goes wrong.
                self.said.append(str(error))
                self._instance.failed(error)
        return found


def running(description: Description) -> Running:
    """The instance of an FMU's file in this process."""
    return _running(description, os.getpid())


@lru_cache(maxsize=16)
def _running(description: Description, process: int) -> Running:
    return Running(description)


def _taken(points: Points, some: np.ndarray) -> Points:
    t, x, u = (each[some] for each in points)
    return t, x, u


def _alike(first: np.ndarray, again: np.ndarray, share: float, least: np.ndarray | float = 0.0) -> bool:
    """Whether values are the same up to a share of their sizes, or up to the least that can be told apart."""
    size = np.max(np.abs(np.nan_to_num(first)), axis=0, initial=0.0)
    return bool(np.all(np.isclose(first, again, rtol=share, atol=np.maximum(share * size, least), equal_nan=True)))


def _keep(known: dict[Any, bool], key: Any, value: bool) -> None:
    """Keep what was found of a key, in the place of the oldest if there are many."""
    if len(known) >= REMEMBERED:
        known.pop(next(iter(known)))
    known[key] = value
