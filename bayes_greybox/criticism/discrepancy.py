"""The discrepancy f: its share of the variance, and its shape on a grid."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.physics.units import target_unit
from bayes_greybox.running.errors import InputError

from .bands import Band
from .prediction import PREDICTION_DRAWS
from .trade_off import known_equation, plain_trade_offs, trade_offs

SHARE_ROWS, SUPPORT = 5000, 0.2
"""Rows, evenly spaced, that variance shares are computed on; distance to a measured row, in half-widths of the box, up
to which a grid point lies inside the data."""


@dataclass(frozen=True)
class DiscrepancyGrid:
    """Posterior of the discrepancy f(x) of one equation on a grid over one or two variables.

    The shape `*grid` is `n_0` for one variable and `n_0 n_1` for two, where `n_i = len(axes[i])`:
    `mean[i, j]` belongs to `axes[0][i]`, `axes[1][j]`.

    Attributes:
        equation: Name of the state whose derivative the equation gives.
        variables: Names of the one or two variables that span the grid.
        axes: Grid positions of each variable, increasing, in `units`.
        mean: Posterior mean of f, in `unit`.
        sd: Posterior standard deviation of f, in `unit`.
        lower: Lower end of the pointwise credible interval, in `unit`.
        upper: Upper end of the pointwise credible interval, in `unit`.
        inside: True where the grid point lies inside the support of the data.
        points: Positions of the data rows, one column a variable.
        units: Unit of each variable; empty if none was given.
        unit: Unit of f; empty if none was given.
        fixed: The other variables of the equation and the values they are held at.
        level: Probability of the interval.
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


def discrepancy_table(posterior: Posterior, level: float = 0.9) -> pd.DataFrame:
    """Return the variance shares, and the overlap of f with the dictionary.

    With y = g + Φθ + f + ε the share of a part c is cov(c, y)/var(y), so the four shares add up to one whatever the
    correlations between the parts. `overlap` is the largest |⟨φ_j, f⟩|/(‖φ_j‖ ‖f‖) over the terms on the data, and
    `correlation` the largest posterior |corr(θ_j, j-th coefficient of f projected on Φ)|; `..._none` are the same for
    the plain kernel at the same hyperparameters.

    Returns:
        Table indexed by equation: simulation, dictionary, discrepancy, noise (shares), discrepancy_lower,
        discrepancy_upper (at the level), rms (of f, user's units), sigma (noise, user's units), overlap, correlation,
        term (the one with this correlation), overlap_none, correlation_none.
    """
    posterior.require_rows("Shares of the variance are found")
    rows, plain = {}, plain_trade_offs(posterior).to_dict("index")
    for name, equation in posterior.equations.items():
        frame, n_row = equation.frame, equation.rows.n_row
        index = np.unique(np.linspace(0, n_row - 1, min(n_row, SHARE_ROWS)).astype(int))
        draws = posterior.draws(name, equation.design.worthwhile(PREDICTION_DRAWS))
        y, theta = equation.rows.measured[index], np.asarray(draws.theta)
        Phi = equation.parts(index)[0] * frame.target_scale
        # Parameters are the simulation's: it has them at their means.
        named = [bool(term.parameter) for term in frame.dictionary.terms]
        mean = np.where(named, theta.mean(axis=0), 0.0)
        g = equation.rows.simulated[index] + Phi @ mean
        f = frame.target_scale * equation.discrepancy(draws, index)
        centred = y - y.mean()
        pieces = (g, (theta - mean) @ Phi.T, f)
        of_g, of_terms, of_f = (np.asarray(part @ centred / (centred @ centred)) for part in pieces)
        parts = {"simulation": float(of_g), "dictionary": float(of_terms.mean()), "discrepancy": float(of_f.mean())}
        tail, trade = (1 - level) / 2, trade_offs(equation, draws)
        rows[name] = {
            **parts,
            "noise": 1.0 - sum(parts.values()),
            "discrepancy_lower": float(np.quantile(of_f, tail)),
            "discrepancy_upper": float(np.quantile(of_f, 1 - tail)),
            "rms": float(np.sqrt(np.mean(f**2))),
            "sigma": float(np.mean(np.asarray(draws.hyper.sigma)) * frame.target_scale),
            "overlap": float(trade.overlap.max()),
            "correlation": float(np.abs(trade.correlation).max()),
            "term": frame.dictionary.names[int(np.argmax(np.abs(trade.correlation)))],
            **{f"{key}_none": value for key, value in plain[name].items()},
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("equation")


def discrepancy_grid(
    posterior: Posterior, equation: str, variables: tuple[str, ...] | None = None, size: int = 41, level: float = 0.9
) -> DiscrepancyGrid:
    """Return the posterior of f over one or two of its variables, the first two by default, with the others at medians.

    There are `size` grid points in each direction, five times as many for one variable. InputError is raised for an
    unknown equation or variable, and for a model without discrepancy.
    """
    entry = known_equation(posterior, equation)
    frame, data = entry.frame, posterior.data
    if not frame.variables:
        raise InputError("The model has no discrepancy to show: fit with bg.OrthogonalGP().")
    variables = tuple(variables or frame.variables[:2])
    unknown = [name for name in variables if name not in frame.variables]
    if unknown or not 1 <= len(variables) <= 2:
        raise InputError(f"variables={variables!r} must be one or two of {', '.join(frame.variables)}.")
    count = size if len(variables) == 2 else 5 * size
    axes = tuple(np.linspace(data.column(n).min(), data.column(n).max(), count) for n in variables)
    mesh = np.meshgrid(*axes, indexing="ij")
    others = {name: float(np.median(column)) for name, column in data.columns.items() if name not in variables}
    columns = {name: np.full(mesh[0].size, value) for name, value in others.items()}
    columns |= {name: values.ravel() for name, values in zip(variables, mesh, strict=True)}
    draws = posterior.draws(equation, entry.design.worthwhile(PREDICTION_DRAWS))
    band = Band.of(frame.target_scale * entry.design.at(frame, columns, draws), level)
    points = data.matrix(variables)
    return DiscrepancyGrid(
        equation=equation,
        variables=variables,
        axes=axes,
        **{name: values.reshape(mesh[0].shape) for name, values in vars(band).items()},
        inside=support(points, axes),
        points=points,
        units=tuple(data.units.get(name, "") for name in variables),
        unit=target_unit(equation, data),
        fixed={name: value for name, value in others.items() if name in frame.variables},
        level=level,
    )


def support(
    points: Float[np.ndarray, "n_obs n_var"], axes: tuple[Float[np.ndarray, " _"], ...]
) -> Bool[np.ndarray, "*grid"]:
    """Return True at grid points that are at most SUPPORT half-widths of the grid away from a row."""
    half = np.array([np.ptp(axis) / 2 for axis in axes])
    mesh = np.meshgrid(*axes, indexing="ij")
    nodes = np.stack([values.ravel() for values in mesh], axis=1)
    return (KDTree(points / half).query(nodes / half)[0] <= SUPPORT).reshape(mesh[0].shape)
