"""What the sensors of one experiment are expected to show under each explanation, as bands over time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.columns import derivative_label
from bayes_greybox.physics.units import derivative_unit

from .candidates import Candidate
from .explained import Explained
from .predicted import Predicted
from .question import Question

LEVEL = 0.9
"""Share of the outcomes that a band holds."""


@dataclass(frozen=True)
class Responses:
    """One experiment under each explanation.

    Attributes:
        candidate: The experiment.
        names: Of the explanations, likeliest first.
        probability: Of each, of those with a prediction.
        bands: By channel: lower end, median and upper end of what the sensor would show without noise; NaN where more
            than the rest of an explanation's runs have failed.
        labels: What each channel shows: the state, or its rate.
        units: By channel, and the time's under "t".
    """

    candidate: Candidate
    names: tuple[str, ...]
    probability: Float[np.ndarray, " n_explanation"]
    bands: Mapping[str, Float[np.ndarray, "n_explanation 3 n_row"]]
    labels: Mapping[str, str]
    units: Mapping[str, str]


def responses(asked: Question, found: Predicted, known: Sequence[Explained]) -> Responses:
    """Bands of what is expected of an experiment.

    Args:
        asked: What was asked.
        found: Simulated outcomes of the experiment.
        known: The explanations.
    """
    total = sum(e.probability for e in known)
    return Responses(
        found.candidate,
        tuple(e.name for e in known),
        np.array([e.probability / total for e in known]),
        {name: _bands(found, values, len(known)) for name, values in found.responses.items()},
        {name: derivative_label(name) if asked.rates else name for name in found.responses},
        {"t": asked.data.units.get("t", "")} | {name: _unit(asked, name) for name in found.responses},
    )


def _unit(asked: Question, name: str) -> str:
    return derivative_unit(name, asked.data.units) if asked.rates else asked.data.units.get(name, "")


def _bands(found: Predicted, values: np.ndarray, n: int) -> Any:
    tail = (1 - LEVEL) / 2
    bands = np.full((n, 3, values.shape[1]), np.nan)
    for m in range(n):
        own = values[found.truth == m]
        # A run that failed shows nothing from there on.
        whole = np.mean(np.isfinite(own), axis=0) >= LEVEL
        bands[m][:, whole] = np.nanquantile(own[:, whole], [tail, 0.5, 1 - tail], axis=0)
    return bands
