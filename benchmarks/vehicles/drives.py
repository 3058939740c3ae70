"""Vehicles that are driven and roll on, and their speed; integrated by SciPy, apart from the package."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

SECONDS, STEP, HELD, NOISE = 300.0, 0.5, 5.0, 0.05
"""Duration, time between samples and time for which a command is held, s; noise of the speedometer, m/s."""

GRAVITY = 9.81


@dataclass(frozen=True)
class Vehicle:
    """v' = F/m − rolling sign(v) − loss v − drag v|v| − g sin(α) + push; rates per unit of mass, SI.

    F follows its command with a lag, up to a limit and beyond a dead zone; parts of zero are not there.
    """

    mass: float
    rolling: float
    loss: float
    drag: float
    slope: float = 0.0
    push: float = 0.0
    limit: float = np.inf
    dead: float = 0.0
    lag: float = 0.0


def vehicle(rng: np.random.Generator) -> Vehicle:
    """Draw a whole vehicle: rolling resistance, a loss in the driveline and drag of the air."""
    scale = np.exp(0.2 * rng.standard_normal(4))
    mass, rolling, loss, drag = np.array([1200.0, 0.12, 0.004, 4e-4]) * scale
    return Vehicle(float(mass), float(rolling), float(loss), float(drag))


def lacking(each: Vehicle, hidden: str, rng: np.random.Generator) -> tuple[Vehicle, float | None]:
    """Return the vehicle with what its simulation lacks, and the coefficient of that; see `known`."""
    some = float(np.exp(0.3 * rng.standard_normal()))
    if hidden == "grade":
        return replace(each, slope=1.0), -GRAVITY
    if hidden == "steady-push":
        return replace(each, push=0.15 * some), 0.15 * some
    if hidden == "input-saturation":
        return replace(each, limit=900.0 * some), -1.0 / each.mass
    if hidden == "drive-dead-zone":
        return replace(each, dead=120.0 * some), -1.0 / each.mass
    if hidden == "drive-lag":
        return replace(each, lag=2.0 * some), 1.0 / each.mass
    sizes = {"rolling-resistance": -each.rolling, "driveline-loss": -each.loss, "aerodynamic-drag": -each.drag}
    return each, sizes.get(hidden)


def known(each: Vehicle, hidden: str) -> dict[str, str]:
    """Return the simulation without what is hidden."""
    parts = {
        "rolling-resistance": f"{each.rolling!r}*sign(v)",
        "driveline-loss": f"{each.loss!r}*v",
        "aerodynamic-drag": f"{each.drag!r}*v*abs(v)",
    }
    return {"v": f"F/{each.mass!r}" + "".join(f" - {part}" for name, part in parts.items() if name != hidden)}


def measured(each: Vehicle, rng: np.random.Generator) -> dict[str, Any]:
    """Return time, speed, commanded force and slope of a drive, part of it backwards."""
    t = np.arange(0.0, SECONDS, STEP)
    commands = rng.uniform(-400.0, 1500.0, round(SECONDS / HELD))
    commands[0], commands[20:26] = 1200.0, -1200.0
    phases = rng.uniform(0.0, 2 * np.pi, 3)

    def angle(time: Any) -> Any:
        waves = [
            np.sin(2 * np.pi * time / period + phase) for period, phase in zip((37.0, 61.0, 97.0), phases, strict=True)
        ]
        return 0.01 * sum(waves)

    def rates(time: float, x: np.ndarray, command: float) -> list[float]:
        v, follows = x
        asked = follows if each.lag else command
        given = float(np.clip(np.sign(asked) * max(abs(asked) - each.dead, 0.0), -each.limit, each.limit))
        v_rate = given / each.mass + each.push - each.slope * GRAVITY * np.sin(angle(time))
        # Near rest the resistance holds: it is steep, not a jump.
        v_rate -= each.rolling * np.tanh(v / 0.01) + each.loss * v + each.drag * v * abs(v)
        return [v_rate, (command - follows) / each.lag if each.lag else 0.0]

    # The command jumps: the integrator starts anew at each.
    x, path = np.array([8.0, 0.0]), []
    for k, command in enumerate(commands):
        at = HELD * k + STEP * np.arange(round(HELD / STEP) + 1)
        found = solve_ivp(
            rates, (at[0], at[-1]), x, args=(float(command),), t_eval=at, rtol=1e-8, atol=1e-8, method="LSODA"
        )
        path.append(found.y[0, :-1])
        x = found.y[:, -1]
    v = np.concatenate(path) + NOISE * rng.standard_normal(len(t))
    return {"t": t, "v": v, "F": np.repeat(commands, round(HELD / STEP)), "slope": angle(t)}
