"""Coefficients of the simulation that would have to be of another size, as with units that were mixed up."""

import numpy as np

from bayes_greybox.discovery.regressors.regressors import Regressors

OTHER_SIZE = 10.0
"""Factor from which on a coefficient is of another size; so is one of the other sign."""

CLOSED_SHARE = 0.9
"""Share of the gap's square that coefficients alone have to close."""

ROWS_EACH = 10
"""Least rows for each coefficient: any coefficients follow a few rows."""


def other_sizes(regressors: Regressors) -> list[str]:
    """Return a sentence if the simulation alone would be right with coefficients of another size.

    It is found by least squares of all of them. Their prior believes the simulation, so that a table in mm beside
    equations in m would be explained by whatever effects look like it.
    """
    free, corrections = regressors.of_kind("free"), regressors.of_kind("correction")
    if not corrections or regressors.rows.n_white < ROWS_EACH * len([*free, *corrections]):
        return []
    theta, left = least_squares(regressors, [*free, *corrections])
    _, gap = least_squares(regressors, free)
    share = 1 - left / gap if gap > 0 else 0.0
    if share < CLOSED_SHARE:
        return []
    sizes = []
    for value, i in zip(theta[len(free) :], corrections, strict=True):
        column = regressors.columns[i]
        ratio = 1 + float(value) * regressors.target_scale / (column.scale * column.nominal)
        if not 1 / OTHER_SIZE < ratio < OTHER_SIZE:
            sizes.append(f"{column.formula.text} {ratio:.4g} times")
    if not sizes:
        return []
    return [
        f"The simulation alone would close {share:.1%} of the gap of {regressors.equation} with other coefficients, of "
        f"{' and '.join(sizes)} what is given: are its units those of the data?"
    ]


def least_squares(regressors: Regressors, indices: list[int]) -> tuple[np.ndarray, float]:
    """Return coefficients of columns, and the sum of their squared residuals."""
    white = regressors.rows.whiten(np.column_stack([regressors.target, regressors.at_rows(indices)]))
    theta = np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=1e-12)[0]
    return theta, float(np.sum((white[:, 0] - white[:, 1:] @ theta) ** 2))
