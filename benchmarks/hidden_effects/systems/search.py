"""The coefficient that gives a hidden effect its wanted size; an effect changes the path it is measured on."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .hidden import Hidden
from .ode import ROUGH, Acting, HostODE, LostError
from .trajectories import Excited, Runs, follow, rms

CLOSE = 1e-3
"""Relative error of the size at which the search ends."""

_STEPS = 30
_FREE = 8
_LOSSES = 6
_LONGEST = 1.2


@dataclass(frozen=True)
class Wanted:
    """An effect and its wanted size.

    Attributes:
        effect: The effect.
        share: RMS of its addition over the RMS of the whole derivative.
        sign: Sign of its coefficient.
        fraction: Its nonlinear parameter, as a fraction of the largest value of its role in the training data.
    """

    effect: Hidden
    share: float
    sign: float
    fraction: float


def coefficients(ode: HostODE, excited: Excited, wanted: Sequence[Wanted]) -> tuple[Acting, ...]:
    """Search coefficients, and with them nonlinear parameters, by secants in their logarithms.

    Raises:
        LostError: The host cannot be followed with effects of these sizes.
    """
    acting = tuple(Acting(item.effect, 0.0) for item in wanted)
    runs = follow(ode, excited, ROUGH)
    acting = _scaled(acting, wanted, runs, ode)
    runs = follow(HostODE(ode.host, ode.rates, acting), excited, ROUGH)
    shares = np.array([item.share for item in wanted])
    log_size = np.log(shares * rms(runs.rates[ode.host.equation]) / _units(runs))
    slope = np.ones(len(wanted))
    before: tuple[np.ndarray, np.ndarray] | None = None
    lost = 0
    for step in range(_STEPS):
        acting = tuple(
            Acting(item.effect, item.sign * float(np.exp(size)), act.inner)
            for item, size, act in zip(wanted, log_size, acting, strict=True)
        )
        try:
            runs = follow(HostODE(ode.host, ode.rates, acting), excited, ROUGH)
        except LostError:
            lost += 1
            if lost > _LOSSES:
                raise
            # Back to where it still held together; without such a place, downwards.
            log_size = log_size - 0.7 if before is None else (log_size + before[0]) / 2
            continue
        error = log_size + np.log(_units(runs) / rms(runs.rates[ode.host.equation]) / shares)
        if np.all(np.abs(error) < CLOSE):
            return acting
        if before is not None:
            moved = log_size - before[0]
            known = np.abs(moved) > 1e-9
            slope[known] = np.clip((error - before[1])[known] / moved[known], 0.3, 3.0)
        before = (log_size, error)
        log_size = log_size - np.clip(error / slope, -_LONGEST, _LONGEST)
        if step < _FREE:
            acting = _scaled(acting, wanted, runs, ode)
    raise LostError("No coefficient gives the wanted size.")


def _units(runs: Runs) -> np.ndarray:
    sizes = np.array([rms(value) for value in runs.values])
    if not np.all(np.isfinite(sizes) & (sizes > 0)):
        raise LostError("The effect does not act on this path.")
    return sizes


def _scaled(acting: tuple[Acting, ...], wanted: Sequence[Wanted], runs: Runs, ode: HostODE) -> tuple[Acting, ...]:
    """Return the effects with nonlinear parameters as fractions of the path's range."""
    columns = {**ode.host.in_roles(runs.columns), "t": runs.columns["t"]}

    def inner(act: Acting, fraction: float) -> float:
        given = act.effect.inner
        return act.inner if given is None else fraction * float(np.max(np.abs(columns[given.role])))

    return tuple(
        Acting(act.effect, act.coefficient, inner(act, item.fraction)) for act, item in zip(acting, wanted, strict=True)
    )
