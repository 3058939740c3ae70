"""What a user does today: PySINDy's sparse regression of the gap on the same terms."""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.errors import InputError

from .generate import CaseData
from .oracle import candidates, effect_values, inner_nodes, own_terms
from .runs import rms

THRESHOLDS = np.geomspace(0.01, 1.0, 15)
"""Thresholds tried, in units of the gap's RMS; columns have unit RMS."""

BLOCKS = 5
"""Blocks of neighbouring rows that are left out in turn to choose the threshold."""

INNER_GRID = 3
"""Columns of an effect with an inner parameter, over its prior."""

RIDGE = 1e-5
MODELS = 20
"""Ridge penalty of the regressions, and number of bootstrapped models in an ensemble."""


def available() -> bool:
    """Whether PySINDy is installed."""
    try:
        _optimizers()
    except InputError:
        return False
    return True
