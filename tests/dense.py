"""Covariance of the measurements by dense algebra, for tests of what avoids it."""

import numpy as np

from bayes_greybox.model.gp.kernels import KERNELS, log_spectral_density


def dense(posterior, hyper, sd):
    """Covariance of the target and the target itself, scaled units, straight from the definition."""
    frame, design = posterior.equations["v"].frame, posterior.equations["v"].design
    data = posterior.data
    rows = posterior.equations["v"].rows
    V = rows.operate(np.eye(data.n_obs))
    Phi, Psi = (V @ np.asarray(part) for part in frame.rows(data.columns))
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
        C += V @ np.asarray(design.cross_covariance(design.points, hyper)) @ V.T
    noise = rows.noise
    C += float(hyper.sigma) ** 2 * noise.covariance()
    target = rows.measured - (-0.2 * V @ data.column("v") if posterior.model.simulation else 0.0)
    if not noise.square:
        W = noise.whiten(np.eye(len(C)))
        return W @ C @ W.T, W @ target / frame.target_scale
    return C, target / frame.target_scale
