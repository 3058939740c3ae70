"""One instance of an FMU in a process, which is used again for every point."""

import math
import os
import threading
from collections import deque
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.running.errors import InputError

from .description import Description
from .loaded import Exchange, Key, Ports
from .stepping import Stepping, rounding

REPEAT_TOLERANCE = 1e-6
"""Share of its size by which a repeated rate may differ: iterative solvers within an FMU are no more precise."""

RESTART_TOLERANCE = 1e-3
"""Share of its size by which a rate after some steps may differ from that of an instance which is started there."""

STEPS_BEFORE_RESTART = 10
"""Steps after which this is compared."""

COARSE = 1e-2
"""Share of its size by which rates by steps and by half as long ones may differ."""

Points = tuple[np.ndarray, ...]
"""Times, states and inputs."""


class Reading(NamedTuple):
    """Values to be read at points: what is set there, the number of values, and how the instance gives them."""

    ports: Ports
    width: int
    read: Callable[[Any], list[float]]


class Running:
    """The instance of one file.

    Attributes:
        messages: Its last messages.
        derivatives_right: True where its own derivatives are those of its rates, by parameters that were compared.
    """

    def __init__(self, description: Description) -> None:
        self._lock = threading.RLock()
        self._description = description
        self.messages: deque[str] = deque(maxlen=8)
        self._instance = (Exchange if description.exchanged else Stepping)(description, self.messages)
        self._trusted: set[tuple[Key, Ports]] = set()
        self.derivatives_right: dict[Key, bool] = {}

    def at_each(self, key: Key, points: Points, reading: Reading) -> Float[np.ndarray, "n k"]:
        """Read values at points of its states and inputs, NaN where the FMU refuses one; one thread at a time."""
        with self._lock:
            self.messages.clear()
            if (key, reading.ports) not in self._trusted and len(points[0]) > 1:
                self._require_memoryless(key, points, reading)
                self._trusted.add((key, reading.ports))
            return self._values(key, points, reading)

    def _require_memoryless(self, key: Key, points: Points, reading: Reading) -> None:
        """Refuse an FMU whose rates differ in the other order of points: a right-hand side has no memory."""
        some = np.unique(np.linspace(0, len(points[0]) - 1, 16).astype(int))
        if isinstance(self._instance, Stepping):
            self._instance.noted.clear()
        probed, turned = (tuple(each[order] for each in points) for order in (some, some[::-1]))
        first, again = self._values(key, probed, reading), self._values(key, turned, reading)[::-1]
        if not _alike(first, again, REPEAT_TOLERANCE):
            raise InputError(
                f"The FMU {self._description.name} remembers: at the same states and time it gives other rates after "
                "it was asked at other points (a delay, a mode of friction, a discrete state), and a right-hand side "
                "must not; export it without, and leave what remembers to the study."
            )
        if isinstance(self._instance, Stepping):
            self._require_short_steps(self._instance, reading.ports)
            self._require_all_states(self._instance, key, probed, reading)

    def _require_short_steps(self, steps: Stepping, ports: Ports) -> None:
        if not steps.noted:
            return
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

    def _require_all_states(self, steps: Stepping, key: Key, points: Points, reading: Reading) -> None:
        """Refuse an FMU with more states than it was given: a start elsewhere then is another motion."""
        ports = reading.ports
        if not ports.step:
            return
        continued, restarted, least = [], [], 0.0
        for t, x, u in zip(*points, strict=True):
            try:
                steps.place(key, ports, float(t), x, u)
                steps.advance(STEPS_BEFORE_RESTART)
                there = np.array(steps.real(ports.states))
                one = reading.read(steps)
                steps.place(key, ports, float(t) + STEPS_BEFORE_RESTART * ports.step, there, u)
                # No step: it then counts as an instance that has gone on, so that both are by whole steps.
                steps.advance(0)
                restarted.append(reading.read(steps))
                continued.append(one)
                # Rounding matters for rates by steps only.
                least = np.maximum(least, rounding(there, ports.step)) if steps.noted else least
            except InputError:
                raise
            except Exception as error:
                steps.failed(error)
        if continued and not _alike(np.array(continued), np.array(restarted), RESTART_TOLERANCE, least):
            raise InputError(
                f"The FMU {self._description.name} has more states than it was given: after some steps it gives other "
                "rates than started at the same states; name all of them, bg.FMU(..., states={'column': 'variable'}), "
                "or export it for Model Exchange."
            )

    def _values(self, key: Key, points: Points, reading: Reading) -> np.ndarray:
        values = np.full((len(points[0]), reading.width), math.nan)
        for k, (t, x, u) in enumerate(zip(*points, strict=True)):
            try:
                self._instance.place(key, reading.ports, float(t), x, u)
                values[k] = reading.read(self._instance)
            except InputError:
                raise
            except Exception as error:
                # FMPy has classes of its own only for some failures.
                self.messages.append(str(error))
                self._instance.failed(error)
        return values


def running(description: Description) -> Running:
    """Return the instance of an FMU's file in this process."""
    return _running(description, os.getpid())


@lru_cache(maxsize=16)
def _running(description: Description, process: int) -> Running:
    return Running(description)


def _alike(first: np.ndarray, again: np.ndarray, share: float, least: np.ndarray | float = 0.0) -> bool:
    """Compare values up to a share of their sizes, or up to the least difference that can be resolved."""
    size = np.max(np.abs(np.nan_to_num(first)), axis=0, initial=0.0)
    return bool(np.all(np.isclose(first, again, rtol=share, atol=np.maximum(share * size, least), equal_nan=True)))
