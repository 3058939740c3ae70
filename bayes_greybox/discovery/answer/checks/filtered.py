"""What rates that a filter computed cannot say of an answer: how an effect looks where it jumps.

A row has a jump's mean over what a sample stands for (`SampleSpread`), but the smoothed state itself is off where the
true one has a kink, and a mass that sticks has a friction that is no function of its velocity. Whether it jumps, bends
or sticks there is beyond such rows: samples, followed along a path, tell.
"""

from collections.abc import Sequence

import numpy as np

from bayes_greybox.discovery.regressors.regressors import Regressors
from bayes_greybox.physics.catalogue.names import within

BENDS = 0.25
"""Second difference of an effect within reach of a sample, over its RMS, from which on its shape there is not seen."""

SEEN = 0.005
"""Share of the samples that may bend so."""

SAMPLES_TELL = "study the samples, without differentiate"
"""How the sentence ends: what it doubts is the shape of what was found, and not that this is all."""


def rounded_off(regressors: Regressors, effects: Sequence[int]) -> list[str]:
    """A sentence where effects of an answer jump within what a filtered sample stands for.

    Args:
        regressors: Of the equation.
        effects: Columns of the answer's effects.
    """
    rows = regressors.rows
    if rows.spread is None:
        return []
    names = []
    for i in effects:
        column = regressors.columns[i]
        if column.effect is None or column.formula.states:
            continue
        values = regressors.evaluate([i], rows.columns)
        bends = rows.spread.bends(lambda at, i=i: regressors.evaluate([i], at), rows.columns)
        if np.mean(bends > BENDS * np.sqrt(np.mean(values**2))) > SEEN:
            names.append(within(column.effect.name))
    if not names:
        return []
    is_where = "is where it jumps or bends" if len(names) == 1 else "are where they jump or bend"
    return [f"rates that a filter computed do not show how {' and '.join(names)} {is_where}: {SAMPLES_TELL}"]
