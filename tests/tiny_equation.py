"""One equation on a few rows, with what it lacks known, for tests of the study's parts."""

from functools import cache

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.equation_study import EquationStudy
from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.discovery.equation import Question, study_equation
from bayes_greybox.discovery.grid.sets import Reach
from bayes_greybox.discovery.grid.weigh import weigh
from bayes_greybox.discovery.linearise.near import Near, Point
from bayes_greybox.discovery.linearise.rates import RateRows
from bayes_greybox.discovery.linearise.source import regressors_of
from bayes_greybox.discovery.linearise.visits import table_of
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.discovery.regressors.regressors import Regressors
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effects import BoundEffect, Effect
from bayes_greybox.physics.catalogue.inner_parameter import InnerParameter

WIDTH = InnerParameter("gap", "width", of="r", low=0.1, high=0.9, unit_of="r")
"""Nonlinear parameter of the dead zone."""

DEAD_ZONE = Effect(
    slug="dead-zone", name="Dead zone", domain="test", expression="sign(r)*max(abs(r) - gap, 0)", inner=(WIDTH,)
)
CUBE = Effect(slug="cube", name="Cube", domain="test", expression="r**3")
SQUARE = Effect(slug="square", name="Square", domain="test", expression="r**2")


def on(effect: Effect, column: str = "x") -> BoundEffect:
    """The effect with its role played by a column."""
    return effect.bind({"r": column})


def tiny_model(**changes) -> Program:
    return Program(**({"simulation": {"x": "-x"}, "discrepancy": OrthogonalGP(features=5)} | changes))


def tiny_data(hidden=np.zeros_like, noise=0.05, n=60, seed=1) -> Trajectories:
    """ẋ = −x + hidden(x) with white noise, x evenly spread over [−1, 1] in random order."""
    rng = np.random.default_rng(seed)
    x = rng.permutation(np.linspace(-1, 1, n))
    rate = -x + hidden(x) + noise * rng.standard_normal(n)
    return Trajectories.from_arrays(np.arange(n) * 0.1, states={"x": x}, derivatives={"x": rate})


def tiny_regressors(effects=(), hidden=np.zeros_like, noise=0.05, n=60, seed=1, **model) -> Regressors:
    """Regressors on these data; effects are bound to x unless they are bound already."""
    bound = [effect if isinstance(effect, BoundEffect) else on(effect) for effect in effects]
    return regressors_of(tiny_model(**model), tiny_data(hidden, noise, n, seed), "x", bound)


def tiny_near(effects=(), hidden=np.zeros_like, noise=0.05, n=60, seed=1, most=2, odds=None, **model) -> Near:
    """Hypotheses on these data, weighed once."""
    bound = [effect if isinstance(effect, BoundEffect) else on(effect) for effect in effects]
    rows = RateRows(tiny_model(**model), tiny_data(hidden, noise, n, seed), "x", bound).near(Point())
    return Near(rows, weigh(table_of(rows), odds or Odds(), Reach(effects=most), rows.floor))


def tiny_study_of(effects=(), data=None, most=2, **model) -> EquationStudy:
    """The study of such data; effects are bound to x unless they are bound already."""
    bound = [effect if isinstance(effect, BoundEffect) else on(effect) for effect in effects]
    data = tiny_data() if data is None else data
    return study_equation(
        Question(tiny_model(**model), data, "x", bound, Odds(), most, 0, Criteria()), lambda text: None
    )


MOTION = {"simulation": {"y": "v", "v": "F - 2*y - 0.15*v"}}
"""Simulation of the motion below."""


def forced(
    hidden=lambda y, v: 0.0 * y, n=200, step=0.1, noise=0.02, late=None, jump=None, seed=0, n_run=1
) -> Trajectories:
    """v̇ = F − 2 y − 0.15 v + hidden(y, v) along a motion that is known at all times; the force is what it takes.

    Args:
        hidden: What the simulation lacks.
        n: Rows of each run.
        step: Between samples.
        noise: SD of the measured rate's.
        late: Delay of "d(v)/dt", of "states" or of "F", in steps.
        jump: SD of the noise on samples of y, of v.
        seed: Of the noise.
        n_run: Runs, one after the other along the motion.
    """
    late, rng = late or {}, np.random.default_rng(seed)
    waves = np.array([[0.9, 1.1, 0.3], [0.5, 2.3, 1.0], [0.4, 0.47, 2.0]])

    def motion(t):
        size, w, p = (part[:, None] for part in waves.T)
        y, v = np.sum(size * np.sin(w * t + p), axis=0), np.sum(size * w * np.cos(w * t + p), axis=0)
        a = np.sum(-size * w**2 * np.sin(w * t + p), axis=0)
        return y, v, a, a + 2 * y + 0.15 * v - hidden(y, v)

    times = [step * (np.arange(n) + k * n) for k in range(n_run)]

    def at(channel, which):
        return [motion(t - late.get(channel, 0.0) * step)[which] for t in times]

    states = {"y": at("states", 0), "v": at("states", 1)}
    for name, sd in zip(states, jump or (), strict=False):
        states[name] = [x + sd * rng.standard_normal(n) for x in states[name]]
    rates = [a + noise * rng.standard_normal(n) for a in at("d(v)/dt", 2)]
    units = {"t": "s", "y": "m", "v": "m/s", "F": "m/s**2"}
    given = {"states": states, "inputs": {"F": at("F", 3)}, "derivatives": {"v": rates}}
    return Trajectories.from_arrays(times, **given, units=units)


def forced_model(**changes) -> Program:
    return Program(**(MOTION | {"discrepancy": OrthogonalGP(variables=("y", "v"), features=5)} | changes))


def soft(y, v):
    """A spring that the simulation lacks."""
    return -0.3 * y**3


@cache
def forced_study(missing: bool, late: str = "", steps: float = 0.5) -> EquationStudy:
    """The study of the motion above, with the cubic spring missing or nothing, and one channel late; made once."""
    data = forced(soft, late={late: steps}) if missing else forced(late={late: steps})
    return studied_motion(data)


def studied_motion(data: Trajectories, effects=(CUBE, SQUARE), most=2, **model) -> EquationStudy:
    """The study of such data; effects are bound to y."""
    bound = [on(effect, "y") for effect in effects]
    return study_equation(
        Question(forced_model(**model), data, "v", bound, Odds(), most, 0, Criteria()), lambda text: None
    )
