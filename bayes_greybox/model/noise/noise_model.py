"""Noise models of rows, and suspects: noise that is not white, weighed against noise as it is.

A suspect is weighed on residuals e of a hypothesis and held at the mode of its parameters, R = R(mode). The cost and
gain of holding is kept as a constant, so that evidences of hypotheses under different noise can be compared:

    log p(y | hypothesis, suspect) ≈ log N-evidence(y | R) + constant,   constant = log p(e) − log p(e | R).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bayes_greybox.data.noise.protocol import RowNoise

CORRELATED, PROCESS = "correlated noise", "process in time"
"""The suspect, and the discrepancy where the correlation is smooth, which is no suspect."""

VARYING, HEAVY = "state-dependent noise", "heavy tails"


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Noise R of rows, the suspects in it by name and by parameters, and the constant of the module's equation."""

    noise: RowNoise
    names: tuple[str, ...] = ()
    constant: float = 0.0
    about: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Suspicion:
    """One suspect, weighed on residuals: log Bayes factor over noise as it is, and the noise with the suspect in it."""

    name: str
    log_bayes_factor: float
    model: NoiseModel


def weighed_on_grid(
    name: str, logs: np.ndarray, log_prior: np.ndarray, before: float, noise: RowNoise, current: NoiseModel, about: dict
) -> Suspicion:
    """Return a suspect with its parameters summed over a grid of log p of the residuals and log prior.

    `before` is log p under the known noise, and `noise` has the parameters of the best node.
    """
    total = float(np.logaddexp.reduce((logs + log_prior).ravel()))
    constant = current.constant + total - float(np.max(logs))
    model = replace(
        current, noise=noise, names=(*current.names, name), constant=constant, about={**current.about, name: about}
    )
    return Suspicion(name, total - before, model)
