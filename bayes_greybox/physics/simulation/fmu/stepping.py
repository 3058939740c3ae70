"""An instance for Co-Simulation: it is started anew at every point, with the states as its start."""

from collections import deque
from collections.abc import Sequence

import numpy as np

from bayes_greybox.running.errors import InputError

from .description import Description
from .loaded import Instance, Key, Ports


class Stepping(Instance):
    """An instance for Co-Simulation."""

    def __init__(self, description: Description, messages: deque[str]) -> None:
        super().__init__(description, messages)
        self._now, self._step = 0.0, 0.0
        # The point at which it was started, until it goes on from there.
        self._at: tuple[Key, Ports, float, np.ndarray, np.ndarray] | None = None
        # Rates of the last points by whole steps, by half ones, and the rounding error that these may have.
        self.noted: deque[tuple[np.ndarray, np.ndarray, np.ndarray]] = deque(maxlen=16)

    def place(self, key: Key, ports: Ports, t: float, x: np.ndarray, u: np.ndarray) -> None:
        """Start the instance at a point: parameters, time, states, inputs."""
        try:
            self._reset()
        except Exception as error:
            raise self._not_started(error) from error
        fmu, inputs = self._fmu, [float(each) for each in u]
        self._set_parameters(key)
        fmu.setReal(ports.starts, [float(each) for each in x])
        if ports.inputs:
            fmu.setReal(ports.inputs, inputs)
        self._enter_initialization(tolerance=1e-9, startTime=t)
        if ports.inputs:
            fmu.setReal(ports.inputs, inputs)
        fmu.exitInitializationMode()
        self._now, self._step, self._at = t, ports.step, (key, ports, t, x, u)
        self._require_start(ports, x)

    def advance(self, steps: int = 1) -> None:
        """Take steps."""
        self._at = None
        for _ in range(steps):
            self._fmu.doStep(self._now, self._step)
            self._now += self._step

    def stepped(self, refs: Sequence[int]) -> list[float]:
        """Return rates of states where it was started, by steps of two lengths (Richardson); by one once it went on.

        x′ = 2 D(h/2) − D(h) with D of `differences`: an error in proportion to h cancels, such as that of one step of
        Euler's method in each communication step. An FMU that takes steps of its own within these, of a length d < h
        that h does not change, errs by the same in D(h) and in D(h/2): nothing cancels, nothing shows, and by Euler's
        method −d/2 · x″ stays. Such an FMU needs h ≤ d.
        """
        started = self._at
        whole = self.differences(refs)
        if started is None:
            return whole.tolist()
        key, ports, t, x, u = started
        self.place(key, ports._replace(step=ports.step / 2), t, x, u)
        half = self.differences(refs)
        self.noted.append((whole, half, rounding(x, ports.step / 2)))
        return (2 * half - whole).tolist()

    def differences(self, refs: Sequence[int]) -> np.ndarray:
        """Return rates of states at the present time, by three steps.

        D(h) = (−11 x(t) + 18 x(t + h) − 9 x(t + 2h) + 2 x(t + 3h)) / 6h = x′(t) + O(h³)
        """
        path = [np.array(self.real(refs))]
        for _ in range(3):
            self.advance()
            path.append(np.array(self.real(refs)))
        a, b, c, d = path
        return (-11 * a + 18 * b - 9 * c + 2 * d) / (6 * self._step)

    def failed(self, error: Exception) -> None:
        """Discard the instance after a failure at a point."""
        self._discard(error)

    def _require_start(self, ports: Ports, x: np.ndarray) -> None:
        """Refuse an instance that starts elsewhere."""
        states, atol = np.array(self.real(ports.states)), 1e-9 * np.max(np.abs(x), initial=0.0)
        away = np.flatnonzero(~np.isclose(states, x, rtol=1e-9, atol=atol))
        if len(away):
            every, ref = self._description.variables.values(), ports.states[away[0]]
            name = next(each.name for each in every if each.kind == "Real" and each.ref == ref)
            raise InputError(
                f"{name!r} of the FMU {self._description.name} is {states[away[0]]:.6g} where its start was set to "
                f"{x[away[0]]:.6g}: say which parameter sets it, bg.FMU(..., starts={{'column': 'parameter'}}), or "
                "export the FMU for Model Exchange."
            )


def rounding(x: np.ndarray, step: float) -> np.ndarray:
    """Return the largest effect of rounded states on rates by `Stepping.differences`: ε (11 + 18 + 9 + 2) |x| / 6h."""
    return 40 * np.finfo(float).eps * np.abs(x) / (6 * step)
