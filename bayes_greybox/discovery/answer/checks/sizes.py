"""Coefficients of the simulation that would have to be of another size: units that were mixed up."""

import numpy as np

from bayes_greybox.discovery.evidence.sufficient_statistics import SufficientStatistics

FACTOR = 10.0
"""Times as large, or as small, that a coefficient has to be before it is spoken of; a wrong sign is of another size."""

MOST = 0.9
"""Share of the gap's square that coefficients alone close before it is."""

EACH = 10
"""Rows for each coefficient that it takes: a few rows are followed by any coefficients."""


def other_sizes(statistics: SufficientStatistics) -> list[str]:
    """What the simulation's coefficients would have to be for it to be right alone, where that is another size.

    Least squares of all of them: their prior believes the simulation, and a table in mm beside equations in m is then
    explained by whatever effects look like it.

    Args:
        statistics: Of the equation.
    """
    free, corrections = statistics.of_kind("free"), statistics.of_kind("correction")
    if not corrections or statistics.n_obs < EACH * len([*free, *corrections]):
        return []
    theta, left = _least_squares(statistics, [*free, *corrections])
    _, gap = _least_squares(statistics, free)
    share = 1 - left / gap if gap > 0 else 0.0
    if share < MOST:
        return []
    said = []
    for value, i in zip(theta[len(free) :], corrections, strict=True):
        column = statistics.columns[i]
        ratio = 1 + float(value) * statistics.target_scale / (column.scale * column.nominal)
        if not 1 / FACTOR < ratio < FACTOR:
            said.append(f"{column.formula.text} {ratio:.4g} times")
    if not said:
        return []
    return [
        f"The simulation alone would close {share:.1%} of the gap of {statistics.equation} with other coefficients, of "
        f"{' and '.join(said)} what is given: are its units those of the data?"
    ]


def _least_squares(statistics: SufficientStatistics, indices: list[int]) -> tuple[np.ndarray, float]:
    """Coefficients of columns, and what they leave of the target's square."""
    G, g = statistics.products[np.ix_(indices, indices)], statistics.with_target[indices]
    theta = np.linalg.lstsq(G, g, rcond=1e-12)[0]
    return theta, statistics.square - float(theta @ g)
