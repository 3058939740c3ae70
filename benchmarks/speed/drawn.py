"""Settings that every contender is given, and the draws that it returns."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .problems import Data

LEAST_NOISE = 1e-4
"""Least noise, over the RMS of the rate, of every contender."""

BOUNDARY = 2.0
"""Half-width of the features' domain over that of the data, of every contender that has features."""

FEATURES = {1: 20, 2: 10, 3: 8, 4: 6}
"""Features along each variable, by their number, of this package. Its defaults, named so that no fit is repeated."""

CAP = 600.0
"""Seconds of a contender on a problem, by default."""


@dataclass(frozen=True)
class Settings:
    """Settings of a run.

    Attributes:
        draws: Draws kept of each chain.
        tune: Iterations of warm-up.
        chains: Number of chains.
        seed: Seed of the sampler.
        target_accept: Target acceptance probability of NUTS.
        cap: Seconds from the start of the process after which no more is drawn.
    """

    draws: int = 1000
    tune: int = 1000
    chains: int = 2
    seed: int = 0
    target_accept: float = 0.9
    cap: float = CAP


@dataclass(frozen=True, eq=False)
class Drawn:
    """Draws, and their costs.

    Attributes:
        theta: Coefficients, scaled units.
        eta: Hyperparameters.
        looks: Seconds since the process started at which so many draws of each chain were there, in their order.
        gradients: Gradients evaluated for the draws, warm-up left out; NaN where that is not known.
        divergences: Divergences among the draws.
        compiling: Seconds of compilers other than JAX's.
    """

    theta: Float[np.ndarray, "n_chain n_draw n_term"]
    eta: Float[np.ndarray, "n_chain n_draw n_eta"]
    looks: tuple[tuple[float, int], ...]
    gradients: float
    divergences: int
    compiling: float = 0.0


Clock = Callable[[], float]
"""Seconds since the process started."""

Draw = Callable[[Data, Settings, Clock], Drawn]
"""A contender at work."""


def tensor_features(n_var: int) -> int:
    """Return features along each variable for whole products: the least that are no fewer in all than here."""
    m = FEATURES[n_var]
    # Here products end at total order m from three variables on: Σ_d j_d < m.
    return m if n_var < 3 else math.ceil(math.comb(m - 1 + n_var, n_var) ** (1 / n_var) - 1e-9)
