"""The pendulum with friction that stands for the measured one, by NumPy and SciPy alone.

FMIZoo's SpringFrictionPendulum1D: a mass of 1 kg on a spring of 10 N/m whose length at rest is 1 m, fixed at 0, with
the friction of Modelica's MassWithStopAndFriction,

    s″ = c (1 − s) − F_prop v − sign(v) (F_Coulomb + F_Stribeck exp(−fexp |v|))   while it moves,

and it stays where it stopped while the spring pulls less than F_Coulomb + F_Stribeck. Its simulation, SpringPendulum1D,
is fixed at 0.1 instead and has no friction, so that it lacks a constant force of −1 m/s² as well.
"""

from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

SPRING_RATE, REST_LENGTH, MASS = 10.0, 1.0, 1.0
"""Stiffness of the spring in N/m, its length at rest in m, the mass in kg."""

PROPORTIONAL, COULOMB, STRIBECK, DECAY = 0.05, 0.25, 0.5, 2.0
"""F_prop in N s/m, F_Coulomb and F_Stribeck in N, fexp in s/m: those of FMIZoo's fricScale = 20."""

MISPLACED = 0.1
"""Place of the wall in the simulation, in m; it is at 0."""

PENDULUM_STEP = 0.01
"""Time between two samples, in s."""

TIGHTEST_DOP853 = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12}

LEGS = 1000
"""Most ways from one stop to the next."""


def truth() -> dict[str, float]:
    """Return coefficients of the effects that the simulation lacks, over the mass, by slug of the catalogue."""
    return {
        "constant-force": -SPRING_RATE * MISPLACED / MASS,
        "viscous-damping": -PROPORTIONAL / MASS,
        "coulomb-friction": -COULOMB / MASS,
        "exponential-stribeck-friction": -STRIBECK / MASS,
    }


def without_friction(start: tuple[float, float], end: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the path of the simulation, as `path` does."""
    t = PENDULUM_STEP * np.arange(round(end / PENDULUM_STEP) + 1)
    w, rest = np.sqrt(SPRING_RATE / MASS), REST_LENGTH + MISPLACED
    swing, push = start[0] - rest, start[1] / w
    s = rest + swing * np.cos(w * t) + push * np.sin(w * t)
    return t, np.array([s, w * (push * np.cos(w * t) - swing * np.sin(w * t))])


def path(start: tuple[float, float], end: float) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "2 n"]]:
    """Return times, and positions and speeds of the pendulum at them, every `PENDULUM_STEP`."""
    t = PENDULUM_STEP * np.arange(round(end / PENDULUM_STEP) + 1)
    found = np.empty((2, len(t)))
    now, state = 0.0, np.array(start, float)
    for _ in range(LEGS):
        pull = SPRING_RATE * (REST_LENGTH - state[0])
        side = np.sign(state[1])
        if not side and abs(pull) <= COULOMB + STRIBECK:
            # It sticks: nothing moves it any more.
            found[:, t >= now] = state[:, None]
            return t, found
        leg = _leg(now, state, side or np.sign(pull), t[-1])
        inside = (t >= now) & (t <= leg.t[-1])
        found[:, inside] = leg.sol(t[inside])
        if leg.status == 0:
            return t, found
        now, state = float(leg.t[-1]), np.array([leg.y[0, -1], 0.0])
    raise RuntimeError(f"The pendulum turned {LEGS} times.")


def _leg(now: float, state: np.ndarray, side: float, end: float) -> Any:
    """Integrate the motion in one direction, to its stop or to the end."""

    def motion(_: float, x: np.ndarray) -> tuple[float, float]:
        v = x[1]
        friction = PROPORTIONAL * v + side * (COULOMB + STRIBECK * np.exp(-DECAY * abs(v)))
        return v, (SPRING_RATE * (REST_LENGTH - x[0]) - friction) / MASS

    def stopped(_: float, x: np.ndarray) -> float:
        return x[1]

    # A leg begins at a stop; only the next one, on the way down, ends it.
    stopped.terminal, stopped.direction = True, -side  # pyright: ignore[reportFunctionMemberAccess]
    return solve_ivp(motion, (now, end), state, events=stopped, dense_output=True, max_step=0.1, **TIGHTEST_DOP853)
