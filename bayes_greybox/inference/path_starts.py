"""States at the start of each path segment, given the coefficients learned along the path."""

import numpy as np
from jaxtyping import Array, Float

from bayes_greybox.model.equation import Equation
from bayes_greybox.model.rows.path.reference_path import ReferencePath

from .posterior import Posterior


def path_of(posterior: Posterior) -> ReferencePath:
    """Return the path along which the rows of a fit to samples are linearised; raise InputError for rows of rates."""
    model, data = posterior.model, posterior.data
    return model.rows.path(data, model.equations, model.simulator(data))


def start_draws(
    equation: Equation, path: ReferencePath, theta: Float[Array | np.ndarray, "n_draw n_term"],
    weight: Float[Array | np.ndarray, "n_draw n_basis"], sigma: Float[Array | np.ndarray, " n_draw"], seed: int,
) -> Float[np.ndarray, "n_draw n_segment n_state"]:  # fmt: skip
    """Draw the states at the start of each segment given each draw of the coefficients; user's units.

        x₀ = x̄₀ + s b,  b | θ, w, σ, y ~ N(b̂, σ² C), see `RowNoise.starts_given`

    with x̄₀ the start of the reference path and s the prior standard deviations of the starts. No unknown force moves
    the path; θ, w and σ are in scaled units.
    """
    rows, scale = equation.rows, equation.frame.target_scale
    Phi, Psi, y = equation.parts()
    residual = (y[:, None] - Phi @ theta.T - Psi @ weight.T) / sigma
    white = np.random.default_rng(seed).standard_normal((rows.noise.n_start, len(theta)))
    typical = np.sqrt(np.mean(path.sensor_sd**2))
    unit = (rows.noise.starts_given(residual, white)[0] * (sigma * scale) * rows.gain / typical).T
    n_state = len(path.start_sd)
    return path.segments.points[:, 0, 1 : 1 + n_state] + unit.reshape(len(theta), -1, n_state) * path.start_sd
