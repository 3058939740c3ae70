"""Coefficients of the simulation that would have to be of another size: units that were mixed up."""

import numpy as np

from bayes_greybox.discovery.regressors.regressors import Regressors

FACTOR = 10.0
"""Times as large, or as small, that a coefficient has to be before it is spoken of; a wrong sign is of another size."""

MOST = 0.9
"""Share of the gap's square that coefficients alone close before it is."""

EACH = 10
"""Rows for each coefficient that it takes: a few rows are followed by any coefficients."""


def other_sizes(regressors: Regressors) -> list[str]:
    """What the simulation's coefficients would have to be for it to be right alone, where that is another size.

    Least squares of all of them: their prior believes the simulation, and a table in mm beside equations in m is then
    explained by whatever effects look like it.

    Args:
        regressors: Of the equation.
    """
    free, corrections = regressors.of_kind("free"), regressors.of_kind("correction")
    if not corrections or regressors.rows.n_white < EACH * len([*free, *corrections]):
        return []
    theta, left = _least_squares(regressors, [*free, *corrections])
    _, gap = _least_squares(regressors, free)
    share = 1 - left / gap if gap > 0 else 0.0
    if share < MOST:
        return []
    said = []
    for value, i in zip(theta[len(free) :], corrections, strict=True):
        column = regressors.columns[i]
        ratio = 1 + float(value) * regressors.target_scale / (column.scale * column.nominal)
        if not 1 / FACTOR < ratio < FACTOR:
            said.append(f"{column.formula.text} {ratio:.4g} times")
    if not said:
        return []
    return [
        f"The simulation alone would close {share:.1%} of the gap of {regressors.equation} with other coefficients, of "
        f"{' and '.join(said)} what is given: are its units those of the data?"
    ]


def _least_squares(regressors: Regressors, indices: list[int]) -> tuple[np.ndarray, float]:
    """Return coefficients of columns, and what they leave of the target's square."""
    white = regressors.rows.whiten(np.column_stack([regressors.target, regressors.at_rows(indices)]))
    theta = np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=1e-12)[0]
    return theta, float(np.sum((white[:, 0] - white[:, 1:] @ theta) ** 2))
