"""Integration of a host with what is hidden in it, to tight tolerances; no code of the package's own integrator."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

from .hidden import Hidden
from .hosts import Host, term_value

TIGHT, ROUGH = 1e-10, 1e-6
"""Relative tolerances of the data, and of the search for coefficients."""

_LIMIT = 30.0
_CALLS = {TIGHT: 150_000, ROUGH: 15_000}
_CROSSINGS = 300


class LostError(Exception):
    """The system left its bounds, came to rest where its equation jumps, or became too stiff to follow."""


@dataclass(frozen=True)
class Acting:
    """A hidden effect at work: its coefficient and the value of its nonlinear parameter."""

    effect: Hidden
    coefficient: float
    inner: float = float("nan")


@dataclass(frozen=True)
class HostODE:
    """dx/dt of a host with its true coefficients and the effects hidden in one of its equations.

    Attributes:
        host: The host.
        rates: Its true coefficients.
        acting: Effects hidden in the studied equation.
    """

    host: Host
    rates: Mapping[str, Mapping[str, float]]
    acting: tuple[Acting, ...] = ()

    @property
    def memories(self) -> tuple[Acting, ...]:
        """Effects with a state of their own, which follows the host's."""
        return tuple(act for act in self.acting if act.effect.memory is not None)

    @property
    def steps(self) -> int:
        """Least number of steps in which the integrator follows a run."""
        return max((act.effect.steps for act in self.acting), default=Hidden.steps)

    def known(self, columns: Mapping[str, Any]) -> dict[str, Any]:
        """Return the rates by the host's own terms."""
        return {
            state: sum(value * term_value(text, columns) for text, value in terms.items())
            for state, terms in self.rates.items()
        }

    def values(self, columns: Mapping[str, Any], memory: Any = 0.0) -> list[Any]:
        """Return the value of each hidden effect, before its coefficient."""
        roles = {**self.host.in_roles(columns), "t": columns["t"], "memory": memory}
        if "side" in columns:
            roles["side"] = columns["side"]
        return [act.effect.value(roles, act.inner) for act in self.acting]

    def rate(self, columns: Mapping[str, Any], memory: Any = 0.0) -> np.ndarray:
        """Return rates of all states, and of the effects' own; as `columns` are numbers or one value for each run."""
        rates = self.known(columns)
        for act, value in zip(self.acting, self.values(columns, memory), strict=True):
            rates[self.host.equation] = rates[self.host.equation] + act.coefficient * value
        own = []
        if memories := self.memories:
            roles = {**self.host.in_roles(columns), "memory": memory}
            own = [act.effect.memory(roles, act.inner) for act in memories if act.effect.memory is not None]
        return np.array([*rates.values(), *own])


def paths(
    ode: HostODE,
    starts: Float[np.ndarray, "n_run n_state"],
    signal: Callable[[float], Any] | None,
    tolerance: float = TIGHT,
) -> Float[np.ndarray, "n_run n_all n_time"]:
    """Integrate the states of all runs at the host's times, followed by those of effects with a memory.

    Raises:
        LostError: Nothing that could serve as data.
    """
    full = np.column_stack([starts, np.zeros((len(starts), len(ode.memories)))])
    jump = next((act.effect.jump for act in ode.acting if act.effect.jump), None)
    with np.errstate(over="ignore", invalid="ignore"):
        if jump is None:
            found = _smooth(ode, full, signal, tolerance)
        else:
            state = list(ode.rates).index(ode.host.roles[jump])
            found = np.stack([_jumping(ode, full, signal, tolerance, run, state) for run in range(len(full))])
    for name in ode.host.positive:
        if np.min(found[:, list(ode.rates).index(name)]) <= 0.0:
            raise LostError(f"{name} reached zero.")
    return found


def _columns(ode: HostODE, t: Any, x: np.ndarray, u: Any) -> dict[str, Any]:
    columns = {"t": t, **dict(zip(ode.rates, x, strict=False))}
    if u is not None:
        columns[ode.host.inputs[0]] = u
    return columns


class _Guard:
    """Counts calls and watches the bounds; the integrator itself would go on for ever."""

    def __init__(self, starts: np.ndarray, tolerance: float) -> None:
        self.limit = _LIMIT * max(1.0, float(np.max(np.abs(starts))))
        self.left = _CALLS.get(tolerance, _CALLS[TIGHT])

    def check(self, x: np.ndarray) -> None:
        self.left -= 1
        if self.left < 0 or not np.abs(x).max() < self.limit:
            raise LostError("The system left its bounds.")


def _solve(slope: Callable[[float, np.ndarray], np.ndarray], span: Any, start: np.ndarray, **options: Any) -> Any:
    tolerance = options.pop("tolerance")
    result = solve_ivp(
        slope,
        span,
        start,
        method="DOP853",
        rtol=tolerance,
        atol=tolerance * max(1e-3, float(np.max(np.abs(start)))),
        **options,
    )
    if result.status < 0:
        raise LostError(result.message)
    return result


def _smooth(ode: HostODE, full: np.ndarray, signal: Any, tolerance: float) -> np.ndarray:
    times = ode.host.times
    n_run, n_all = full.shape
    n_state = len(ode.rates)
    guard = _Guard(full, tolerance)

    def slope(t: float, packed: np.ndarray) -> np.ndarray:
        x = packed.reshape(n_all, n_run)
        guard.check(packed)
        u = None if signal is None else signal(t)
        memory = x[n_state] if n_all > n_state else 0.0
        return ode.rate(_columns(ode, t, x, u), memory).ravel()

    result = _solve(
        slope, (times[0], times[-1]), full.T.ravel(), t_eval=times, max_step=times[-1] / ode.steps, tolerance=tolerance
    )
    return result.y.reshape(n_all, n_run, len(times)).swapaxes(0, 1)


def _jumping(ode: HostODE, full: np.ndarray, signal: Any, tolerance: float, run: int, state: int) -> np.ndarray:
    """Integrate one run, from each zero of the state at which the equation jumps to the next."""
    times = ode.host.times
    guard = _Guard(full, tolerance)

    def rate(t: float, x: np.ndarray, side: float) -> np.ndarray:
        guard.check(x)
        u = None if signal is None else signal(t)[run]
        return ode.rate({**_columns(ode, t, x, u), "side": side})

    def side_of(t: float, x: np.ndarray, before: float) -> float:
        """Return the side to which the state goes from zero: on through it, or back."""
        for side in (-before, before):
            if side * rate(t, x, side)[state] > 0:
                return side
        raise LostError("The system sticks.")

    now, x = float(times[0]), full[run].copy()
    side = float(np.sign(x[state])) or side_of(now, x, 1.0)
    pieces = [x[:, None]]
    for _ in range(_CROSSINGS):
        crossing: Any = lambda t, x: x[state]  # noqa: E731
        crossing.terminal, crossing.direction = True, -side
        result = _solve(
            lambda t, x, side=side: rate(t, x, side),
            (now, times[-1]),
            x,
            t_eval=times[times > now],
            events=crossing,
            max_step=times[-1] / ode.steps,
            tolerance=tolerance,
        )
        pieces.append(np.asarray(result.y).reshape(len(x), -1))
        if result.status == 0:
            return np.column_stack(pieces)
        now, x = float(result.t_events[0][0]), result.y_events[0][0].copy()
        x[state] = 0.0
        side = side_of(now, x, side)
    raise LostError("The system crosses zero too often.")
