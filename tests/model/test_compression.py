"""The triangular factor carries all that the rows say, at the precision of a QR factorisation."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model import assemble as assemble_module
from bayes_greybox.model.algebra.collapsed import remove_features, ridge
from bayes_greybox.model.algebra.compression import triangular_factor
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.model.likelihood import CollapsedNormal
from bayes_greybox.model.priors import Scales
from bayes_greybox.model.program import Program

N, P, FACTOR_CHUNK = 2503, 7, 300  # N is not a multiple of FACTOR_CHUNK


def _upright(R):
    return R * np.where(np.diag(R) < 0, -1.0, 1.0)[:, None]


def _both(F, chunk=FACTOR_CHUNK):
    """The factor by chunks, and by one QR, with positive diagonals."""
    return _upright(triangular_factor(lambda index: F[index], len(F), chunk)), _upright(np.linalg.qr(F, mode="r"))


def _with_condition(condition, seed=0):
    rng = np.random.default_rng(seed)
    left, _ = np.linalg.qr(rng.standard_normal((N, P)))
    right, _ = np.linalg.qr(rng.standard_normal((P, P)))
    return left * np.geomspace(1, 1 / condition, P) @ right


@pytest.mark.parametrize("condition", [1.0, 1e4, 1e8])
def test_factor_is_that_of_a_qr(condition):
    got, expected = _both(_with_condition(condition))
    # The small diagonal entries carry the residuals: they must be right relative to themselves. QR itself
    # knows them to ε · condition.
    np.testing.assert_allclose(np.diag(got), np.diag(expected), rtol=max(1e-10, 1e-15 * condition))
    np.testing.assert_allclose(got, expected, atol=1e-10 * np.linalg.norm(expected))


def test_gram_matrix_alone_would_not_do():
    # The reason for the preconditioner: these two matrices have one Gram matrix, even if it is rounded only once, and
    # triangular factors that differ by a factor of two. The columns are one in half of the rows; the others belong to
    # one column each. So FᵀF is n_one + δ² n / 4 on its diagonal, where the second part is below half of the last digit
    # of 1, and thus lost from every partial sum with a one in it, in any order. The least singular value is δ √(n / 4).
    grams = []
    for delta in (2.0**-32, 2.0**-33):
        F = np.ones((N, 2))
        F[2::4] = (delta, 0.0)
        F[3::4] = (0.0, delta)
        n_own = len(F[2::4]) + len(F[3::4])
        grams.append([[math.fsum(a * b) for a in F.T] for b in F.T])
        got = triangular_factor(lambda index, F=F: F[index], N, FACTOR_CHUNK)
        # R₂₂² = (a b - n_one²) / a with a, b the squared norms: δ² n_own up to δ². Rounding changes it by at most
        # n_row · n_column · ε · condition of itself in Householder's QR, and the condition is 2 / δ.
        assert abs(got[1, 1]) == pytest.approx(delta * math.sqrt(n_own), rel=2 * N * np.finfo(float).eps * 2 / delta)
    assert grams[0] == grams[1] == [[N - n_own] * 2] * 2


@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_collinear_and_zero_columns(scale):
    F = _with_condition(10.0)
    F[:, 4] = scale * (F[:, 1] - 2 * F[:, 2])
    F[:, 6] = 0.0
    got, _ = _both(F)
    norms = np.where(np.linalg.norm(F, axis=0) > 0, np.linalg.norm(F, axis=0), 1.0)
    np.testing.assert_allclose((got.T @ got) / np.outer(norms, norms), F.T @ F / np.outer(norms, norms), atol=1e-10)
    assert abs(got[4, 4]) < 1e-10 * norms[4]


@pytest.mark.parametrize("burst", ["column", "difference"])
def test_a_burst_that_the_sample_misses(burst):
    """An input switched on for six rows, or two terms that differ there only: R₀ knows nothing of it."""
    rng = np.random.default_rng(1)
    F = rng.standard_normal((N, P))
    sampled = np.unique(np.linspace(0, N - 1, FACTOR_CHUNK).astype(int))
    hidden = np.setdiff1d(np.arange(N), sampled)[40:46]
    F[:, 2] = 0.0 if burst == "column" else F[:, 1]
    F[hidden, 2] += 1.0
    got, expected = _both(F)
    np.testing.assert_allclose(np.diag(got), np.diag(expected), rtol=1e-9)
    np.testing.assert_allclose(got, expected, atol=1e-9 * np.linalg.norm(expected))


def test_factors_of_parts_combine_by_stacking():
    F = _with_condition(1e3)
    parts = [
        triangular_factor(lambda index, part=part: part[index], len(part), FACTOR_CHUNK) for part in (F[:900], F[900:])
    ]
    stacked = np.vstack(parts)
    combined = _upright(triangular_factor(lambda index: stacked[index], len(stacked), FACTOR_CHUNK))
    np.testing.assert_allclose(combined, _both(F)[1], atol=1e-12)


def test_few_rows_are_kept_as_they_are_many():
    F = np.random.default_rng(2).standard_normal((4, 9))
    R = triangular_factor(lambda index: F[index], 4)
    assert R.shape == (4, 9)
    np.testing.assert_allclose(R.T @ R, F.T @ F, atol=1e-13)


@pytest.mark.parametrize("chunk", [10_000, 64])
def test_likelihood_is_that_of_the_uncompressed_rows(chunk, monkeypatch):
    rng = np.random.default_rng(3)
    y, v = rng.uniform(-1, 1, (2, 300))
    rate = -(y**3) - 0.2 * v + 0.2 * np.sin(4 * y * v) + 0.01 * rng.standard_normal(300)
    data = Trajectories.from_arrays(np.arange(300.0), states={"y": y, "v": v}, derivatives={"v": rate})
    monkeypatch.setattr(assemble_module, "FACTOR_CHUNK", chunk)
    monkeypatch.setattr(assemble_module, "triangular_factor", lambda rows, n_row: triangular_factor(rows, n_row, chunk))
    equation = Program({"v": ["y", "v", "y**3"]}, discrepancy=OrthogonalGP(features=5)).assemble(data)["v"]
    design = equation.design
    assert len(design.y) == 3 + 25 + 1 and float(design.n_obs) == 300
    hyper = Hyperparameters(jnp.asarray(0.02), jnp.asarray(0.4), jnp.asarray([0.8, 0.9]))
    sd = jnp.asarray([0.5, 1.0, 1.5])
    compressed = CollapsedNormal(design, hyper, Scales(sd)).log_prob(design.y)

    Phi, Psi = (jnp.asarray(part) for part in equation.frame.rows(data.columns))
    target = jnp.asarray(rate / equation.frame.target_scale)
    log_root, _ = design.weight_prior(hyper)
    regression, _ = remove_features(Phi, Psi, Psi.T @ Psi, target, log_root, hyper.sigma)
    regression = regression._replace(log_det=regression.log_det + 600 * jnp.log(hyper.sigma))
    assert float(compressed) == pytest.approx(float(ridge(regression, sd, 300.0).log_evidence), rel=1e-10)


def test_correlated_rows_of_several_chunks_have_the_design_of_one(monkeypatch):
    t = np.arange(200) * 0.05
    y = np.cos(t) + 1e-3 * np.random.default_rng(4).standard_normal(200)
    data = Trajectories.from_arrays(t, states={"y": y}).differentiate("savgol", rates={"y": "v"}, window=9, polyorder=3)
    program = Program({"v": ["y", "v"]}, discrepancy=OrthogonalGP(features=4))
    once = program.designs(data)["v"]
    monkeypatch.setattr(assemble_module, "FACTOR_CHUNK", 64)
    chunked = program.designs(data)["v"]
    for name in ("gram", "Phi", "y"):
        whole, parts = (np.asarray(getattr(design, name)) for design in (once, chunked))
        np.testing.assert_allclose(np.abs(parts), np.abs(whole), rtol=1e-8, atol=1e-10)
