"""Shapes of the noise that are not white and normal: heavy tails, and noise that grows with something.

They are found on the white residual of the likeliest hypothesis, and become further points of the noise grid, each with
its prior and with what its parameters cost.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.noise.weighted import correlation_and_sd
from bayes_greybox.data.noise.white import WhiteNoise
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.model.gp.hyper import NoisePrior
from bayes_greybox.model.noise.noise_model import NoiseModel, Suspicion
from bayes_greybox.model.noise.suspicions import LEAST_ROWS, heavy, varying

WORTH = -3.0
"""Log posterior odds of a shape over white noise below which it is not added: odds of twenty."""

FLOOR = 1e-6
"""Least scale of whitened residuals, of unit variance."""


class Shape(NamedTuple):
    """One shape of the noise.

    Attributes:
        name: What it is.
        spread: Relative standard deviation of the noise of each row as it came.
        log_prior: What it adds to the log prior of a noise point: its prior odds, and its parameters' cost.
        about: Its parameters, by name.
    """

    name: str
    spread: Float[np.ndarray, " n_row"]
    log_prior: float
    about: Mapping[str, Any]


def noise_shapes(
    white: Float[np.ndarray, " n_row"], quantities: Mapping[str, Float[np.ndarray, " n_row"]], odds: Odds
) -> tuple[Shape, ...]:
    """Return the shapes that a residual speaks for.

    Args:
        white: Whitened residual of the likeliest hypothesis.
        quantities: What the noise may grow with, at the rows.
        odds: Prior probabilities.
    """
    if len(white) < LEAST_ROWS or not np.all(np.isfinite(white)):
        return ()
    known, prior = NoiseModel(WhiteNoise((len(white),))), NoisePrior(FLOOR, 1.0)
    log_odds = math.log(odds.noise) - math.log1p(-odds.noise)
    found: list[Suspicion | None] = [varying(white, known, quantities, prior), heavy(white, known, prior)]
    worth = [s for s in found if s is not None and s.log_bayes_factor + log_odds > WORTH]
    if len(worth) == 2:
        # Noise that grows with something has heavy tails, too: beside it tails are what is left of them.
        first = max(worth, key=lambda s: s.log_bayes_factor)
        again = (
            heavy(white, first.model, prior) if first is worth[0] else varying(white, first.model, quantities, prior)
        )
        if again is not None and again.log_bayes_factor + log_odds > WORTH:
            worth.append(again)
    return tuple(_shape(s, log_odds) for s in worth)


def _shape(suspicion: Suspicion, log_odds: float) -> Shape:
    model = suspicion.model
    _, sd = correlation_and_sd(model.noise)
    return Shape(" + ".join(model.names), np.asarray(sd), len(model.names) * log_odds + model.constant, model.about)
