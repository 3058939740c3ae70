"""Exact refits without some observations, everything that the data fixed before sampling held as it was."""

import math
from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from bayes_greybox.data.row_noise import RowNoise
from bayes_greybox.inference.posterior import Posterior, sample_posterior
from bayes_greybox.model.assemble import Equation
from bayes_greybox.model.compression import triangular_factor
from bayes_greybox.model.likelihood import DenseDesign

from .pointwise import count_observations, scaled_rows


def refit_without(posterior: Posterior, equation: str, rows: Sequence[int], progress: bool = False) -> Posterior:
    """Run NUTS again without some observations of one equation, with the settings of the first run.

    Returns:
        A posterior with this equation only.
    """
    left = {equation: leave_out(posterior, equation, rows)}
    return sample_posterior(
        posterior.model,
        posterior.data,
        posterior.sampling,
        progress=progress,
        equations=left,
        programs=posterior.programs,
    )


def leave_out(posterior: Posterior, equation: str, rows: Sequence[int]) -> Equation:
    """The design without the targets of some observations; the frame (scaling, measure, features) stays.

    Where the noise is correlated, y₋ᵢ has noise covariance σ² R₋ᵢ₋ᵢ. Its whitening is that of all rows
    followed by the removal of the directions a = W eᵢ, with log|R₋ᵢ₋ᵢ| = log|R| + log aᵀa, so R₋ᵢ₋ᵢ is never
    formed. Where the start of each run stays (whole runs, or the past), W is triangular, so it is enough to
    leave rows of W out.

    Args:
        posterior: Fitted model.
        equation: Learned state.
        rows: Observations to leave out: rows of the data, or whitened coefficients where the noise is
            singular.

    Returns:
        The equation with the unchanged frame and the reduced design.
    """
    whole = posterior.equations[equation]
    frame, design = whole.frame, whole.design
    noise = posterior.data.noise.get(equation)
    n_observation = count_observations(posterior, equation)
    out = np.unique(np.asarray(rows, int))
    kept = np.delete(np.arange(n_observation), out)
    directions, log_det = None, 0.0
    if noise is not None and noise.square:
        starts = kept_starts(noise, kept)
        if starts is None:
            directions, log_det = _directions(noise, n_observation, out)
        else:
            log_det = log_det_of_starts(noise, starts) - noise.log_det
    common = {
        "n_obs": design.n_obs - len(out),
        "log_det_R": design.log_det_R + log_det,
    }
    if isinstance(design, DenseDesign):
        # Rows of an orthonormal basis of what is left; without correlation these are unit vectors.
        remain = np.eye(n_observation)[kept]
        if directions is not None:
            remain = np.linalg.qr(directions, mode="complete")[0][:, len(out) :].T
        W = remain if design.whitening is None else remain @ np.asarray(design.whitening)
        Phi, y = remain @ np.asarray(design.Phi), remain @ np.asarray(design.y)
        reduced = replace(design, Phi=jnp.asarray(Phi), y=jnp.asarray(y), whitening=jnp.asarray(W), **common)
        return Equation(frame, reduced)

    if noise is None:
        factor = triangular_factor(lambda index: scaled_rows(posterior, equation, kept[index]), len(kept))
    else:
        table = noise.whiten(scaled_rows(posterior, equation))
        table = table[kept] if directions is None else table - directions @ (directions.T @ table)
        factor = triangular_factor(lambda index: table[index], len(table))
    n_term = len(frame.dictionary)
    Psi = factor[:, n_term:-1]
    reduced = replace(
        design,
        Phi=jnp.asarray(factor[:, :n_term]),
        Psi=jnp.asarray(Psi),
        gram=jnp.asarray(Psi.T @ Psi),
        y=jnp.asarray(factor[:, -1]),
        **common,
    )
    return Equation(frame, reduced)


def kept_starts(noise: RowNoise, kept: Int[np.ndarray, " n_kept"]) -> list[int] | None:
    """How many rows of each run these are, if they are the first ones of each run; else None."""
    counts, start = [], 0
    for n in noise.run_lengths:
        own = kept[(kept >= start) & (kept < start + n)]
        if not np.array_equal(own, start + np.arange(len(own))):
            return None
        counts.append(len(own))
        start += n
    return counts


def log_det_of_starts(noise: RowNoise, counts: Sequence[int]) -> float:
    """log|R_AA| of the first rows of each run."""
    if not sum(counts):
        return 0.0
    part = noise.restrict([(0, count) for count in counts])
    # Its R is rescaled to a mean diagonal of one.
    return part.log_det + 2 * sum(counts) * math.log(part.scale / noise.scale)


def _directions(noise: RowNoise, n_obs: int, out: np.ndarray) -> tuple[np.ndarray, float]:
    """Orthonormal basis of W E, E the unit vectors of the rows left out, and log|(R⁻¹)_out,out|."""
    unit = np.zeros((n_obs, len(out)))
    unit[out, np.arange(len(out))] = 1.0
    Q, triangle = np.linalg.qr(noise.whiten(unit))
    return Q, 2 * float(np.sum(np.log(np.abs(np.diag(triangle)))))
