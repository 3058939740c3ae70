"""One equation on a few rows, with what it lacks known, for tests of the study's parts."""

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.evaluations import Evaluations
from bayes_greybox.discovery.evidence.with_discrepancy import Evaluator, Integrated
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.discovery.sufficient_statistics import sufficient_statistics
from bayes_greybox.model.discrepancy import OrthogonalGP
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effects import BoundEffect, Effect, InnerParameter

WIDTH = InnerParameter("gap", "width", of="r", low=0.1, high=0.9, unit_of="r")
"""Inner parameter of the dead zone."""

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


def tiny_evaluations(effects=(), hidden=np.zeros_like, noise=0.05, n=60, seed=1, odds=None, **model) -> Evaluations:
    """Evidence on these data; effects are bound to x unless they are bound already."""
    bound = [effect if isinstance(effect, BoundEffect) else on(effect) for effect in effects]
    statistics = sufficient_statistics(tiny_model(**model), tiny_data(hidden, noise, n, seed), "x", bound)
    evaluator = Evaluator(statistics.prior, statistics.kernel, np.asarray(statistics.basis.frequency))
    return Evaluations(statistics, odds or Odds(), evaluator)


def integrated(log_evidence=0.0, sigma=1.0, se=0.0) -> Integrated:
    """Evidence with f, written down by hand; the mode's noise is `sigma`."""
    return Integrated(log_evidence, se, log_evidence, np.array([np.log(sigma), 0.0, 0.0]), np.eye(3))
