"""Doubts about an answer from its effects: values at ends of their ranges, and kinks that filtered rates do not show.

A filtered row has a jump's mean over the time that a sample stands for (`SampleSpread`), but the smoothed state itself
is off where the true one has a kink, and a mass that sticks has a friction that is no function of its velocity. Whether
an effect jumps, bends or sticks is beyond such rows: samples, followed along a path, tell.
"""

from collections.abc import Sequence

import numpy as np

from bayes_greybox.discovery.answer.coefficients import Coefficients
from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.discovery.regressors.columns import limits
from bayes_greybox.discovery.regressors.regressors import Regressors
from bayes_greybox.physics.catalogue.names import within

SAMPLES_TELL = "study the samples, without differentiate"
"""End of the sentence on filtered rates: it doubts the shape of an effect, and not that it is the whole answer."""


def at_ends(regressors: Regressors, coefficients: Coefficients, criteria: Criteria) -> list[str]:
    """Return a sentence for each nonlinear parameter of the answer that is at an end of its range.

    The range cuts off the interval of such a parameter, and the interval of its coefficient is too short.
    """
    sentences = []
    for drawn in coefficients.inner.T:
        columns = [regressors.columns[i] for i in drawn]
        effect = columns[0].effect
        if effect is None or not columns[0].inner:
            continue
        ranges = limits(effect, regressors.rows.columns, regressors.path)
        for parameter, low, high in zip(effect.effect.inner, *ranges, strict=True):
            values = np.array([column.inner[parameter.name] for column in columns])
            place = np.log(values / low) / np.log(high / low)
            for end, away in (("smallest", place), ("largest", 1 - place)):
                if np.mean(away < criteria.end) > criteria.at_end:
                    sentences.append(
                        f"{parameter.meaning} of {within(effect.effect.name)} is at the {end} value that was tried: "
                        "it may lie beyond, and its interval is cut off there"
                    )
    return sentences


def rounded_off(regressors: Regressors, effects: Sequence[int], criteria: Criteria) -> list[str]:
    """Return a sentence if effects jump or bend within the time that a filtered sample stands for."""
    rows, spread, names = regressors.rows, regressors.rows.spread, []
    if spread is None:
        return []
    for i in effects:
        column = regressors.columns[i]
        if column.effect is None or column.formula.states:
            continue
        values = regressors.evaluate([i], rows.columns)
        bends = spread.bends(lambda at, i=i: regressors.evaluate([i], at), rows.columns)
        if np.mean(bends > criteria.bend * np.sqrt(np.mean(values**2))) > criteria.bent_rows:
            names.append(within(column.effect.name))
    if not names:
        return []
    is_where = "is where it jumps or bends" if len(names) == 1 else "are where they jump or bend"
    return [f"rates that a filter computed do not show how {' and '.join(names)} {is_where}: {SAMPLES_TELL}"]
