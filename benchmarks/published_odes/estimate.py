"""Parameters of a problem from samples: coefficients of terms first, then what they are made of.

Every parameter enters by coefficients θ = c(p) that are linear in the rates. Where there are more coefficients than
parameters, as for FitzHugh and Nagumo's, p̂ is that of least squares on the whitened rows y = Φ c(p) + ε near the model
with c(p̂), again and again until it stays: the estimate of the whole equations with p alone free. Nothing starts at a
guess of the parameters: the path is a spline through the samples at first, and all coefficients are zero. That both
sensors have the same noise is known, as it is to the published methods; how large it is is not.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows

from .problems import MOST, Problem

TURNS = 20
"""How often rows are taken anew near the parameters, at most."""

STAYS = 1e-4
"""Change of the parameters, over their size, at which they stay."""


def estimate(problem: Problem, data: Trajectories) -> Float[np.ndarray, " n_parameter"]:
    """Parameters between zero and `MOST`.

    Args:
        problem: The problem; of its true parameters and starts nothing is used.
        data: Samples.

    Raises:
        InputError: Coefficients that do not settle.
    """
    model, _ = Program(problem.dictionary, rows=TrajectoryRows(same_noise=True), discrepancy=None).near(data)
    (equation,) = model.assemble(data).values()
    terms = [term for term, _ in equation.ridge()]
    found = _inside(problem.inverse(np.array([value for _, value in equation.ridge()])))
    rows = equation
    for _ in range(TURNS):
        before = found
        Phi, y = np.asarray(rows.design.Phi) / rows.frame.coefficient_scale, np.asarray(rows.design.y)

        def residual(p: np.ndarray, Phi: np.ndarray = Phi, y: np.ndarray = y) -> np.ndarray:
            return Phi @ problem.coefficients(p) - y

        found = least_squares(residual, before, bounds=(0.0, MOST), x_scale=np.maximum(before, 0.1)).x
        if np.linalg.norm(found - before) <= STAYS * np.linalg.norm(before):
            break
        # Where coefficients are free they may be far from any parameters': the next rows are near the latter.
        pairs = list(zip(terms, problem.coefficients(found).tolist(), strict=True))
        near = replace(model, rows=model.rows.around(pairs, equation.frame.dictionary.acts_on))
        (rows,) = near.assemble(data).values()
    return found


def _inside(parameters: np.ndarray) -> np.ndarray:
    """Parameters in the bounds, off their edges."""
    return np.clip(parameters, 1e-3, MOST - 1e-3)
