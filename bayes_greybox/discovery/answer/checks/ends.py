"""Inner parameters at the ends of their ranges, beyond which the catalogue has no values."""

import numpy as np

from bayes_greybox.discovery.answer.coefficients import Coefficients
from bayes_greybox.discovery.evidence.columns import limits
from bayes_greybox.discovery.evidence.sufficient_statistics import SufficientStatistics
from bayes_greybox.physics.catalogue.names import within

END = 0.05
"""Share of the logarithm of a range that is its end; a posterior that knows nothing has as much there."""

MOST = 0.5
"""Share of the draws at one end above which the value may lie beyond."""


def at_ends(statistics: SufficientStatistics, coefficients: Coefficients) -> list[str]:
    """What was added with an inner parameter at an end of its range, in words.

    The interval of such a parameter is cut off by the range, and that of the coefficient beside it is too short.

    Args:
        statistics: Of the equation.
        coefficients: Draws of the model after.
    """
    said = []
    for drawn in coefficients.inner.T:
        columns = [statistics.columns[i] for i in drawn]
        effect = columns[0].effect
        if effect is None or not columns[0].inner:
            continue
        for each, low, high in zip(
            effect.effect.inner, *limits(effect, statistics.rows.columns, statistics.path), strict=True
        ):
            values = np.array([column.inner[each.name] for column in columns])
            place = np.log(values / low) / np.log(high / low)
            for end, away in (("smallest", place), ("largest", 1 - place)):
                if np.mean(away < END) > MOST:
                    said.append(
                        f"{each.meaning} of {within(effect.effect.name)} is at the {end} value that was tried: it may "
                        "lie beyond, and its interval is cut off there"
                    )
    return said
