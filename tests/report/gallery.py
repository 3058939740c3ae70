"""A page of every kind of verdict, from data made here with code that the package does not share.

`python tests/report/gallery.py FOLDER [KIND ...]` writes them, to be looked at; `test_gallery.py` holds each to the
rules for pages.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

import bayes_greybox as bg
from bayes_greybox.report.pages.comparison_page import comparison_html

sys.path.append(str(Path(__file__).parents[1]))
from static_map import KNOWN, rig

SHORT = {"draws": 250, "tune": 250, "chains": 2, "progress": False}
SIMULATION = {"y": "v", "v": "F - 4*y - 0.3*v"}
UNITS = {"t": "s", "y": "m", "v": "m/s", "F": "m/s/s"}


def oscillator(
    seed: int,
    missing: Callable[[float, float], float] = lambda y, v: 0.0,
    stiffness: float = 4.0,
    late: float = 0.0,
    size: float = 1.0,
    n: int = 300,
    noise: float = 0.05,
) -> bg.Trajectories:
    """A forced oscillator, y'' = F − k y − 0.3 y' − missing(y, y'), with its rate as a sensor gives it.

    Args:
        seed: Of the noise.
        missing: What the simulation lacks.
        stiffness: k; the simulation has 4.
        late: Seconds that the rate's sensor is late.
        size: Of the force.
        n: Rows in 20 s.
        noise: Of the rate, over its standard deviation.
    """
    time = np.linspace(0.0, 20.0, n)

    def force(t):
        return size * (2.0 * np.sin(1.3 * t) + np.cos(0.7 * t))

    def rate(t, x):
        return [x[1], force(t) - stiffness * x[0] - 0.3 * x[1] - missing(x[0], x[1])]

    path = solve_ivp(rate, (0.0, 20.0), [0.5 * size, 0.0], dense_output=True, rtol=1e-9, atol=1e-10)
    y, v = path.sol(time)
    seen = np.clip(time - late, 0.0, None)
    a = np.array([rate(t, x)[1] for t, x in zip(seen, path.sol(seen).T, strict=True)])
    a = a + noise * np.std(a) * np.random.default_rng(seed).standard_normal(n)
    return bg.Trajectories.from_arrays(
        time, states={"y": y, "v": v}, inputs={"F": force(time)}, derivatives={"v": a}, units=UNITS
    )


def hysteresis(seed: int, n: int = 300) -> bg.Trajectories:
    """The oscillator with a Bouc–Wen force 2 z, ż = ẏ − 3 |ẏ| |z| z, which a function of the state cannot be."""
    time = np.linspace(0.0, 20.0, n)

    def force(t):
        return 2.0 * np.sin(1.3 * t) + np.cos(0.7 * t)

    def rate(t, x):
        y, v, z = x
        return [v, force(t) - 4.0 * y - 0.3 * v - 2.0 * z, v - 3.0 * abs(v) * abs(z) * z]

    path = solve_ivp(rate, (0.0, 20.0), [0.5, 0.0, 0.0], t_eval=time, rtol=1e-8, atol=1e-9)
    a = np.array([rate(t, x)[1] for t, x in zip(time, path.y.T, strict=True)])
    a = a + 0.05 * np.std(a) * np.random.default_rng(seed).standard_normal(n)
    states = {"y": path.y[0], "v": path.y[1]}
    return bg.Trajectories.from_arrays(
        time, states=states, inputs={"F": force(time)}, derivatives={"v": a}, units=UNITS
    )


def populations(seed: int, n: int = 160) -> bg.Trajectories:
    """Prey that crowd each other, and predators, with the rates of both."""
    time = np.linspace(0.0, 16.0, n)

    def rate(t, x):
        return [1.1 * x[0] - 0.4 * x[0] * x[1] - 0.1 * x[0] ** 2, -0.6 * x[1] + 0.2 * x[0] * x[1]]

    path = solve_ivp(rate, (0.0, 16.0), [5.0, 1.0], t_eval=time, rtol=1e-9, atol=1e-10)
    rates = np.array([rate(0.0, x) for x in path.y.T]).T
    rates = rates + 0.03 * rates.std(axis=1, keepdims=True) * np.random.default_rng(seed).standard_normal(rates.shape)
    return bg.Trajectories.from_arrays(
        time,
        states={"prey": path.y[0], "predator": path.y[1]},
        derivatives={"prey": rates[0], "predator": rates[1]},
        units={"t": "yr"},
    )


def _bump(y: float, v: float) -> float:
    return 4.0 * np.exp(-((y - 0.35) ** 2) / 0.01)


def _study(train: bg.Trajectories, test: bg.Trajectories, simulation=None, **settings) -> bg.Study:
    model = bg.GreyBox(simulation=simulation or SIMULATION)
    return bg.find_missing_effects(model, train, test, seed=0, **{**SHORT, **settings})


def _pair(**changes) -> bg.Study:
    return _study(oscillator(1, **changes), oscillator(2, **changes))


@cache
def _fit(draws: int = 700, prior: str = "spike") -> bg.Fit:
    data = bg.systems.oscillator().simulate(np.linspace(0.0, 20.0, 300), noise=0.02, seed=1)
    terms = ["y", "ydot", "y**2", "y*ydot", "ydot**2", "y**3", "ydot**3"]
    priors = {"spike": bg.SpikeAndSlab(), "laplace": bg.Laplace()}
    model = bg.GreyBox({"ydot": terms}, prior=priors[prior], discrepancy=bg.OrthogonalGP(features=8))
    return model.fit(data, draws=draws, tune=500 if draws > 100 else 60, chains=2, seed=0, progress=False)


@dataclass(frozen=True)
class _Compared:
    """Fits with what `compare` says of them; writes itself as a study and a fit do."""

    fits: dict[str, bg.Fit]
    table: pd.DataFrame

    def to_html(self, path: Path) -> None:
        """Write the page."""
        comparison_html(self.fits, self.table, path)


def _compared() -> _Compared:
    fits = {"spike and slab": _fit(), "Laplace": _fit(prior="laplace")}
    return _Compared(fits, bg.compare(fits, progress=False))


def _cubic(y: float, v: float) -> float:
    return 1.5 * y**3


MADE: dict[str, Callable[[], Any]] = {
    "named": lambda: _pair(missing=_cubic),
    "no-gap": lambda: _pair(),
    "recalibrate": lambda: _pair(stiffness=4.6),
    "instrument": lambda: _pair(late=0.08),
    "one-of": lambda: _pair(missing=_cubic, size=0.5, noise=0.3, n=150),
    "unknown": lambda: _pair(missing=_bump, n=150),
    "partly-named": lambda: _pair(missing=lambda y, v: 3.0 * v * abs(v) + 0.1 * _bump(y, v), n=150),
    "fit": _fit,
    "fit-not-converged": lambda: _fit(draws=40),
    "comparison": _compared,
    "memory": lambda: _study(hysteresis(1), hysteresis(2)),
    "several-equations": lambda: _study(
        populations(1),
        populations(2),
        {"prey": "1.1*prey - 0.4*prey*predator", "predator": "-0.6*predator + 0.2*prey*predator"},
        catalogue="population",
    ),
    "output": lambda: _study(rig(1), rig(2), KNOWN),
}
"""Studies, fits and a comparison, each of which writes its page by `to_html`."""


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for kind in sys.argv[2:] or MADE:
        MADE[kind]().to_html(folder / f"{kind}.html")
        print(kind, (folder / f"{kind}.html").stat().st_size, flush=True)
