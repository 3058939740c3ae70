"""Shapes of the noise that are not white and normal: heavy tails, and noise that grows with some quantity.

The white residual of the likeliest hypothesis speaks for them. They become further points of the noise grid, each with
its prior and with the cost of its parameters.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.noise.weighted import WhiteNoise, correlation_and_sd
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.model.gp.hyper import NoisePrior
from bayes_greybox.model.noise.noise_model import NoiseModel
from bayes_greybox.model.noise.suspicions import LEAST_ROWS, heavy, varying

LEAST_SHAPE_ODDS = -3.0
"""Log posterior odds of a shape over white noise below which it is not added: odds of twenty."""

LEAST_WHITE_SCALE = 1e-6
"""Least scale of whitened residuals, of unit variance."""


class Shape(NamedTuple):
    """One shape of the noise.

    Attributes:
        name: Name of the shape.
        spread: Relative standard deviation of the noise of each row as it came.
        log_prior: Log prior that it adds to a noise point: its prior odds, and its parameters' cost.
        about: Its parameters, by name.
    """

    name: str
    spread: Float[np.ndarray, " n_row"]
    log_prior: float
    about: Mapping[str, Any]


def noise_shapes(
    white: Float[np.ndarray, " n_row"], quantities: Mapping[str, Float[np.ndarray, " n_row"]], odds: Odds
) -> tuple[Shape, ...]:
    """Return the shapes that a residual speaks for."""
    if len(white) < LEAST_ROWS or not np.all(np.isfinite(white)):
        return ()
    plain, prior = NoiseModel(WhiteNoise((len(white),))), NoisePrior(LEAST_WHITE_SCALE, 1.0)
    log_odds = math.log(odds.noise) - math.log1p(-odds.noise)

    def grows(model: NoiseModel) -> Any:
        return varying(white, model, quantities, prior)

    def has_tails(model: NoiseModel) -> Any:
        return heavy(white, model, prior)

    def likely(suspicion: Any) -> bool:
        return suspicion is not None and suspicion.log_bayes_factor + log_odds > LEAST_SHAPE_ODDS

    worth = [s for s in (grows(plain), has_tails(plain)) if likely(s)]
    if len(worth) == 2:
        # Noise that grows has heavy tails, too: beside the growth tails are those that are left.
        first = max(worth, key=lambda s: s.log_bayes_factor)
        both = (has_tails if first is worth[0] else grows)(first.model)
        worth += [both] if likely(both) else []
    return tuple(_shape(suspicion.model, log_odds) for suspicion in worth)


def _shape(model: NoiseModel, log_odds: float) -> Shape:
    _, sd = correlation_and_sd(model.noise)
    return Shape(" + ".join(model.names), np.asarray(sd), len(model.names) * log_odds + model.constant, model.about)
