"""Covariance of the measurements by dense algebra, for tests of what avoids it."""

import numpy as np

from bayes_greybox.model.kernels import KERNELS, log_spectral_density


def dense(posterior, hyper, sd):
    """Covariance of the target and the target itself, scaled units, straight from the definition."""
    frame, design = posterior.equations["v"].frame, posterior.equations["v"].design
    data = posterior.data
    Phi, Psi = (np.asarray(part) for part in frame.rows(data.columns))
    C = (Phi * np.asarray(sd) ** 2) @ Phi.T
    gp = posterior.model.discrepancy
    if gp is not None and gp.path == "hsgp":
        log_S = log_spectral_density(KERNELS[gp.kernel], frame.basis.frequency, hyper.amplitude, hyper.length_scale)
        S = np.diag(np.exp(np.asarray(log_S)))
        if gp.variant == "conditioned":
            M = frame.moments
            S = S - S @ M.T @ np.linalg.solve(M @ S @ M.T, M @ S)
        C += Psi @ S @ Psi.T
    elif gp is not None:
        C += np.asarray(design.cross_covariance(design.points, hyper))
    noise = data.noise.get("v")
    C += float(hyper.sigma) ** 2 * (np.eye(len(C)) if noise is None else noise.covariance())
    target = data.derivatives["v"] - (-0.2 * data.column("v") if posterior.model.simulation else 0.0)
    if noise is not None and not noise.square:
        W = noise.whiten(np.eye(len(C)))
        return W @ C @ W.T, W @ target / frame.target_scale
    return C, target / frame.target_scale
