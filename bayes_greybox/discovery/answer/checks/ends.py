"""Inner parameters at the ends of their ranges, beyond which the catalogue has no values."""

import numpy as np

from bayes_greybox.discovery.answer.coefficients import Coefficients
from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.discovery.regressors.columns import limits
from bayes_greybox.discovery.regressors.regressors import Regressors
from bayes_greybox.physics.catalogue.names import within


def at_ends(regressors: Regressors, coefficients: Coefficients, criteria: Criteria) -> list[str]:
    """What was added with an inner parameter at an end of its range, in words.

    The interval of such a parameter is cut off by the range, and that of the coefficient beside it is too short.

    Args:
        regressors: Of the equation.
        coefficients: Draws of the model after.
        criteria: Numbers that decide.
    """
    said = []
    for drawn in coefficients.inner.T:
        columns = [regressors.columns[i] for i in drawn]
        effect = columns[0].effect
        if effect is None or not columns[0].inner:
            continue
        for each, low, high in zip(
            effect.effect.inner, *limits(effect, regressors.rows.columns, regressors.path), strict=True
        ):
            values = np.array([column.inner[each.name] for column in columns])
            place = np.log(values / low) / np.log(high / low)
            for end, away in (("smallest", place), ("largest", 1 - place)):
                if np.mean(away < criteria.end) > criteria.at_end:
                    said.append(
                        f"{each.meaning} of {within(effect.effect.name)} is at the {end} value that was tried: it may "
                        "lie beyond, and its interval is cut off there"
                    )
    return said
