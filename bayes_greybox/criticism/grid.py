"""The posterior of the discrepancy on a grid over one or two variables, ready to draw."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True)
class DiscrepancyGrid:
    """Posterior of the discrepancy f(x) of one equation on a grid over one or two variables.

    The shape `*grid` is `n_0` for one variable and `n_0 n_1` for two, where `n_i = len(axes[i])`:
    `mean[i, j]` belongs to `axes[0][i]`, `axes[1][j]`.

    Attributes:
        equation: name of the state whose derivative the equation gives.
        variables: names of the one or two variables that span the grid.
        axes: grid positions of each variable, increasing, in the units of `units`.
        mean: posterior mean of f, in `unit`.
        sd: posterior standard deviation of f, in `unit`.
        lower: lower end of the pointwise credible interval, in `unit`.
        upper: upper end of the pointwise credible interval, in `unit`.
        inside: True where the grid point lies inside the support of the data.
        points: positions of the data rows, one column a variable.
        units: unit of each variable; an empty string where none was given.
        unit: unit of f; an empty string where none was given.
        fixed: the other variables of the equation and the values they are held at.
        level: probability that the credible interval holds.
    """

    equation: str
    variables: tuple[str, ...]
    axes: tuple[Float[np.ndarray, " _"], ...]
    mean: Float[np.ndarray, "*grid"]
    sd: Float[np.ndarray, "*grid"]
    lower: Float[np.ndarray, "*grid"]
    upper: Float[np.ndarray, "*grid"]
    inside: Bool[np.ndarray, "*grid"]
    points: Float[np.ndarray, "n_obs n_var"]
    units: tuple[str, ...]
    unit: str
    fixed: Mapping[str, float | np.floating]
    level: float | np.floating = 0.9
