"""Blocks, trajectories and the future from one run, against dense algebra."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fabricated import fabricate

from bayes_greybox.criticism import fold_density
from bayes_greybox.criticism.fold_density import fold_blocks, past_densities
from bayes_greybox.criticism.folds import make_folds
from bayes_greybox.criticism.leave_out import leave_out
from bayes_greybox.criticism.pointwise import pointwise_loo
from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.discrepancy import OrthogonalGP
from bayes_greybox.model.kernels import KERNELS, log_spectral_density
from bayes_greybox.model.likelihood import CollapsedNormal
from bayes_greybox.model.priors import Scales
from bayes_greybox.model.program import Program

TERMS = ["y", "v", "y**3"]
SIMULATION = {"v": "-0.2*v"}


def measured(lengths=(11, 8, 7), seed=0) -> Trajectories:
    """Runs of unequal length on one clock, with the rate of v measured."""
    rng = np.random.default_rng(seed)
    runs = [rng.uniform(-1, 1, (2, n)) for n in lengths]
    rates = [-(y**3) - 0.3 * v + 0.1 * np.sin(3 * y) + 0.05 * rng.standard_normal(len(y)) for y, v in runs]
    return Trajectories.from_arrays(
        [0.1 * np.arange(n) for n in lengths],
        states={"y": [y for y, _ in runs], "v": [v for _, v in runs]},
        derivatives={"v": rates},
    )


def differentiated(method: str) -> Trajectories:
    """Runs of a sampled velocity whose derivative is a linear filter of it: rows with correlated noise."""
    rng = np.random.default_rng(3)
    n = 19 if method == "savgol" else 16
    t = np.arange(n) * (2 * np.pi / n)
    runs = [np.sin(t + phase) + 0.5 * np.cos(2 * t) + 0.01 * rng.standard_normal(n) for phase in (0.0, 1.3)]
    data = Trajectories.from_arrays([t, t], states={"v": runs, "y": [np.cos(3 * t), np.sin(t) ** 2]})
    return data.differentiate(method, **({"window": 7, "polyorder": 3} if method == "savgol" else {}))


def draw(posterior, s):
    draws = posterior.draws("v")
    return jax.tree.map(lambda values: jnp.asarray(values[s]), (draws.hyper, draws.prior_sd))


def dense(posterior, hyper, sd):
    """Covariance of the target and the target itself, scaled units, straight from the definition."""
    frame, design, data = posterior.equations["v"].frame, posterior.equations["v"].design, posterior.data
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
    target = data.derivatives["v"] + 0.2 * data.column("v")
    if noise is not None and not noise.square:
        W = noise.whiten(np.eye(len(C)))
        return W @ C @ W.T, W @ target / frame.target_scale
    return C, target / frame.target_scale


def conditional(C, y, fold, given):
    """Log p(y_fold | y_given) of a Gaussian, by conditioning."""
    gain = np.linalg.solve(C[np.ix_(given, given)], np.column_stack([y[given], C[np.ix_(given, fold)]]))
    mean, covariance = C[np.ix_(fold, given)] @ gain[:, 0], C[np.ix_(fold, fold)] - C[np.ix_(fold, given)] @ gain[:, 1:]
    error = y[fold] - mean
    return -0.5 * (np.linalg.slogdet(2 * np.pi * covariance)[1] + error @ np.linalg.solve(covariance, error))


CASES = {
    "projected": (OrthogonalGP(features=5), "measured"),
    "projected, box": (OrthogonalGP(features=4, measure="box", kernel="matern32"), "measured"),
    "conditioned": (OrthogonalGP(features=5, variant="conditioned", kernel="matern52"), "measured"),
    "none": (OrthogonalGP(features=5, variant="none", variables=("y",)), "measured"),
    "exact": (OrthogonalGP(path="exact"), "measured"),
    "no discrepancy": (None, "measured"),
    "correlated rows": (OrthogonalGP(features=4), "savgol"),
    "correlated rows, conditioned": (OrthogonalGP(features=4, variant="conditioned"), "savgol"),
    "correlated rows, exact": (OrthogonalGP(path="exact", kernel="matern32"), "savgol"),
    "spectral": (OrthogonalGP(features=3), "spectral"),
    "spectral, exact": (OrthogonalGP(path="exact"), "spectral"),
}


@pytest.fixture(scope="module", params=CASES)
def case(request):
    gp, kind = CASES[request.param]
    data = measured() if kind == "measured" else differentiated(kind)
    model = Program(dictionary={"v": TERMS}, discrepancy=gp, simulation=SIMULATION)
    prior_sd = np.exp(0.3 * np.random.default_rng(1).standard_normal((2, 2, 3)))
    prior_sd[0, 1, 1:] = 0.0  # a spike-and-slab pattern with two terms out
    prior_sd[1, 0] = 0.0
    return fabricate(model, data, draws=2, prior_sd=prior_sd)


def singular(posterior):
    noise = posterior.data.noise.get("v")
    return noise is not None and not noise.square


def values_of(posterior, folds):
    parts = list(fold_blocks(posterior, "v", posterior.draws("v"), folds))
    assert np.array_equal(np.concatenate([index for index, _ in parts]), np.arange(len(folds)))
    return np.concatenate([values for _, values in parts], axis=1)


def expected_of(posterior, s, folds, givens):
    C, y = dense(posterior, *draw(posterior, s))
    scale = posterior.equations["v"].frame.target_scale
    return [
        conditional(C, y, fold, given) - len(fold) * np.log(scale) for fold, given in zip(folds, givens, strict=True)
    ]


@pytest.mark.parametrize("route", ["precision", "complement"])
@pytest.mark.parametrize("scheme", ["block", "trajectory"])
def test_left_out_folds_have_the_dense_conditional(case, scheme, route, monkeypatch):
    if scheme == "block" and singular(case):
        with pytest.raises(InputError, match="belong to no time"):
            make_folds(case, scheme, 4)
        return
    folds = make_folds(case, scheme, 4 if scheme == "block" else None).members["v"]
    n = sum(len(fold) for fold in folds)
    assert np.array_equal(np.concatenate(folds), np.arange(n))
    assert scheme == "trajectory" or {len(fold) for fold in folds} <= {3, 4}
    if case.model.discrepancy is None or case.model.discrepancy.path == "hsgp":
        monkeypatch.setattr(fold_density, "_by_precision", lambda *_: route == "precision")
    elif route == "complement":
        return
    monkeypatch.setattr(fold_density, "ROW_BLOCK", 9)
    values = values_of(case, folds)
    for s in range(4):
        expected = expected_of(case, s, folds, [np.setdiff1d(np.arange(n), fold) for fold in folds])
        # Densities far in the tails are thousands of nats, of which twelve digits are as good as the algebra gives.
        np.testing.assert_allclose(values[s], expected, rtol=1e-10, atol=1e-8)


@pytest.mark.parametrize("start", [0.5, 0.05])
def test_steps_into_the_future_have_the_dense_conditional(case, start):
    if singular(case):
        with pytest.raises(InputError, match="belong to no time"):
            make_folds(case, "future", 3)
        return
    chosen = make_folds(case, "future", 3, start)
    folds, past = chosen.members["v"], chosen.past["v"]
    time = case.data.time
    pasts = [np.flatnonzero(time < time[fold].min()) for fold in folds]
    assert np.array_equal(pasts[0], past)
    assert np.array_equal(np.sort(np.concatenate([past, *folds])), np.arange(len(time)))
    assert all(len(np.unique(time[fold])) <= 3 for fold in folds)
    values = np.diff(past_densities(case, "v", case.draws("v"), past, folds), axis=1)
    for s in range(4):
        np.testing.assert_allclose(values[s], expected_of(case, s, folds, pasts), rtol=1e-10, atol=1e-8)


def test_blocks_of_one_row_are_single_rows(case):
    if not singular(case):
        folds = make_folds(case, "block", 1).members["v"]
        np.testing.assert_allclose(values_of(case, folds), pointwise_loo(case, "v"), rtol=1e-10, atol=1e-8)


@jax.jit
def log_density(design, hyper, sd):
    return CollapsedNormal(design, hyper, Scales(sd)).log_prob(design.y)


@pytest.mark.parametrize("scheme", ["trajectory", "future"])
def test_designs_for_refits_have_the_density_of_what_is_left(case, scheme):
    if scheme == "future" and singular(case):
        return
    folds = make_folds(case, scheme, 3 if scheme == "future" else None)
    out = folds.members["v"][0] if scheme == "trajectory" else np.sort(np.concatenate(folds.members["v"]))
    part = leave_out(case, "v", out.tolist()).design
    hyper, sd = draw(case, 0)
    C, y = dense(case, hyper, sd)
    kept = np.setdiff1d(np.arange(len(y)), out)
    C, y = C[np.ix_(kept, kept)], y[kept]
    expected = -0.5 * (np.linalg.slogdet(2 * np.pi * C)[1] + y @ np.linalg.solve(C, y))
    if singular(case):
        expected -= 0.5 * case.data.noise["v"].log_det  # the constant of the coefficients before whitening
    assert float(log_density(part, hyper, sd)) == pytest.approx(expected, abs=1e-7)
    # A prior that asks for the number of rows, as the horseshoe does, must not change when rows are left out.
    assert float(part.n_prior) == float(case.equations["v"].design.n_obs) > float(part.n_obs)
