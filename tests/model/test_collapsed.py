"""The collapsed density against dense linear algebra, its gradients, and its precision on noise-free data."""

import itertools

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import numpyro.distributions as dist
import pytest
from jax.scipy.special import logsumexp

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.algebra.collapsed import constraint_directions, scaled_solve, symmetric_solve
from bayes_greybox.model.algebra.linalg import LEAF, inverse_lower
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.model.gp.kernels import KERNELS, gram, log_spectral_density
from bayes_greybox.model.likelihood import CollapsedNormal
from bayes_greybox.model.priors import Scales
from bayes_greybox.model.program import Program

TERMS = ["y", "v", "y**3"]
HYPER = Hyperparameters(jnp.asarray(0.07), jnp.asarray(0.6), jnp.asarray([0.8, 1.3]))
SD = jnp.asarray([0.5, 1.2, 0.9])
LOG_ODDS = jnp.asarray([-1.0, 0.3, 0.8])


def _scattered(n=60, noise=0.05):
    rng = np.random.default_rng(1)
    y, v = rng.uniform(-1, 1, n), rng.uniform(-2, 3, n)
    a = -(y**3) - 0.2 * v + 0.3 * np.sin(3 * y * v) + noise * rng.standard_normal(n)
    return Trajectories.from_arrays(np.arange(n) * 0.1, states={"y": y, "v": v}, derivatives={"v": a})


def _differentiated(method):
    t = np.arange(128) * (2 * np.pi / 64)
    y = np.cos(t) + 0.3 * np.sin(2 * t) + 1e-3 * np.random.default_rng(2).standard_normal(t.size)
    data = Trajectories.from_arrays(t, states={"y": y})
    settings = {"window": 11, "polyorder": 4} if method == "savgol" else {"band": 0.8}
    return data.differentiate(method=method, rates={"y": "v"}, **settings)


DATA = {
    "independent": _scattered(),
    "banded": _differentiated("savgol"),
    "spectral": _differentiated("spectral"),
}


@jax.jit
def _log_probs(design):
    """Without and with the sum over inclusion patterns."""
    return [CollapsedNormal(design, HYPER, Scales(SD, odds)).log_prob(design.y) for odds in (None, LOG_ODDS)]


def _equation(gp, data, prior_terms=TERMS):
    return Program({"v": prior_terms}, discrepancy=gp).assemble(data)["v"]


def _dense_rows(equation, data):
    """Φ and scaled target on the rows, and the whitening W of their noise, from first principles."""
    V = equation.rows.operate(np.eye(data.n_obs))
    measured = equation.rows.measured
    y = measured / np.sqrt(np.mean(measured**2))
    return V @ _terms(data), y, equation.rows.noise.whiten(np.eye(len(y)))


def _terms(data):
    """Φ at the samples."""
    columns = data.columns
    Phi = np.stack([columns["y"], columns["v"], columns["y"] ** 3], axis=1)
    return Phi / np.sqrt(np.mean(Phi**2, axis=0))


def _dense_kernel(gp, equation, data, hyper):
    """k⊥ at the rows under the empirical measure, by explicit projections of explicit Gram matrices.

    On correlated rows its metric is that of the likelihood, R⁻¹ = Wᵀ W.
    """
    V, Phi = equation.rows.operate(np.eye(data.n_obs)), _terms(data)
    W = equation.rows.whiten(np.eye(len(V)))
    x = np.stack([data.columns["y"], data.columns["v"]], axis=1)
    x = (x - (x.max(0) + x.min(0)) / 2) / ((x.max(0) - x.min(0)) / 2)
    if gp.path == "exact":
        x = jnp.asarray(x)
        K = np.asarray(gram(KERNELS[gp.kernel], x, x, hyper.amplitude, hyper.length_scale))
    else:
        psi = np.asarray(equation.frame.basis(jnp.asarray(x)))
        log_S = log_spectral_density(
            KERNELS[gp.kernel], equation.frame.basis.frequency, hyper.amplitude, hyper.length_scale
        )
        K = (psi * np.exp(np.asarray(log_S))) @ psi.T
    if gp.variant == "projected":
        residual = np.eye(len(x)) - Phi @ np.linalg.pinv(W @ V @ Phi) @ W @ V
        K = residual @ K @ residual.T
    if gp.variant == "conditioned":
        weighted = V.T @ W.T @ W @ V @ Phi
        h = K @ weighted
        K = K - h @ np.linalg.solve(weighted.T @ h, h.T)
    return V @ K @ V.T


def _dense_log_prob(Phi, y, K, W, log_det_R, hyper, sd):
    n_white = len(W)
    covariance = W @ (Phi * np.asarray(sd) ** 2 @ Phi.T + K) @ W.T + float(hyper.sigma) ** 2 * np.eye(n_white)
    normal = dist.MultivariateNormal(jnp.zeros(n_white), covariance)
    return float(normal.log_prob(jnp.asarray(W @ y))) - 0.5 * log_det_R


CASES = [
    (variant, path, noise)
    for variant in ("projected", "conditioned", "none")
    for path in ("hsgp", "exact")
    for noise in DATA
    if noise == "banded" or variant == "projected"
]
"""Correlated rows ask all that independent ones do."""


@pytest.mark.parametrize(("variant", "path", "noise"), CASES)
def test_log_prob_is_the_dense_normal(variant, path, noise):
    data = DATA[noise]
    gp = OrthogonalGP(variant=variant, path=path, features=6)
    equation = _equation(gp, data)
    Phi, y, W = _dense_rows(equation, data)
    log_det_R = equation.rows.noise.log_det
    K = _dense_kernel(gp, equation, data, HYPER)

    got, mixture = _log_probs(equation.design)
    expected = _dense_log_prob(Phi, y, K, W, log_det_R, HYPER, SD)
    assert float(got) == pytest.approx(expected, rel=1e-9, abs=1e-7)

    inclusion = 1 / (1 + np.exp(-np.asarray(LOG_ODDS)))
    parts = []
    for pattern in itertools.product((0.0, 1.0), repeat=3):
        gamma = np.array(pattern)
        prior = np.sum(np.log(np.where(gamma == 1, inclusion, 1 - inclusion)))
        parts.append(prior + _dense_log_prob(Phi, y, K, W, log_det_R, HYPER, gamma * np.asarray(SD)))
    assert float(mixture) == pytest.approx(float(logsumexp(jnp.array(parts))), rel=1e-9, abs=1e-7)


@pytest.mark.parametrize("noise", DATA)
def test_without_discrepancy_it_is_bayesian_linear_regression(noise):
    data = DATA[noise]
    equation = _equation(None, data)
    Phi, y, W = _dense_rows(equation, data)
    log_det_R = equation.rows.noise.log_det
    hyper = Hyperparameters(jnp.asarray(0.3), jnp.ones(()), jnp.ones(0))
    got = CollapsedNormal(equation.design, hyper, Scales(SD)).log_prob(equation.design.y)
    expected = _dense_log_prob(Phi, y, np.zeros((len(y),) * 2), W, log_det_R, hyper, SD)
    assert float(got) == pytest.approx(expected, rel=1e-10)


def test_log_prob_does_not_depend_on_the_units_of_the_states():
    data = DATA["independent"]
    rescaled = Trajectories.from_arrays(
        data.time,
        states={"y": 1e3 * data.columns["y"], "v": 1e-4 * data.columns["v"]},
        derivatives={"v": 50 * data.derivatives["v"]},
    )
    values = [
        float(CollapsedNormal(design, HYPER, Scales(SD)).log_prob(design.y))
        for design in (_equation(OrthogonalGP(), d).design for d in (data, rescaled))
    ]
    assert values[0] == pytest.approx(values[1], rel=1e-9)


def _naive_solve(gram, log_s, right):
    A = jnp.eye(len(log_s)) + jnp.exp(log_s)[:, None] * gram * jnp.exp(log_s)
    return jnp.linalg.slogdet(A)[1], jnp.linalg.solve(A, right)


def _scalar(solve, gram):
    weight = jnp.asarray(np.random.default_rng(4).standard_normal((7, 3)))

    def value(log_s, right):
        log_det, X = solve(gram, log_s, right)[:2]
        return log_det + jnp.sum(weight * X) + jnp.sum(X**2)

    return value


def _solve_problem():
    rng = np.random.default_rng(3)
    rows = rng.standard_normal((9, 7))
    log_s = jnp.asarray(rng.uniform(-3, 2, 7))
    return jnp.asarray(rows.T @ rows), log_s, jnp.asarray(rng.standard_normal((7, 3)))


def test_custom_gradient_of_the_scaled_solve():
    G, log_s, right = _solve_problem()
    fast, naive = _scalar(scaled_solve, G), _scalar(_naive_solve, G)
    assert float(fast(log_s, right)) == pytest.approx(float(naive(log_s, right)), rel=1e-12)
    gradient = jax.jit(jax.grad(fast, argnums=(0, 1)))(log_s, right)
    for got, expected in zip(gradient, jax.jit(jax.grad(naive, argnums=(0, 1)))(log_s, right), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-10)
    # Central differences with step h: error h² f'''/6 ~ 1e-9 here.
    h = 1e-5 * jnp.eye(7)
    at = jax.jit(jax.vmap(naive, (0, None)))
    np.testing.assert_allclose(gradient[0], (at(log_s + h, right) - at(log_s - h, right)) / 2e-5, rtol=1e-6, atol=1e-6)


def test_second_derivatives_pass_through_the_custom_gradient():
    # Laplace evidence needs the Hessian of the log density.
    G, log_s, right = _solve_problem()
    got = jax.jit(jax.hessian(_scalar(scaled_solve, G)))(log_s, right)
    expected = jax.jit(jax.hessian(_scalar(_naive_solve, G)))(log_s, right)
    np.testing.assert_allclose(got, expected, rtol=1e-7, atol=1e-8)


def test_custom_gradient_of_the_symmetric_solve():
    G, _, right = _solve_problem()
    weight = jnp.asarray(np.random.default_rng(4).standard_normal((7, 3)))

    def through(solve):
        def value(root, right):
            log_det, X = solve(jnp.eye(7) + root.T @ G @ root, right)
            return log_det + jnp.sum(weight * X) + jnp.sum(X**2)

        return value

    fast = through(lambda A, right: symmetric_solve(A, right)[:2])
    naive = through(lambda A, right: (jnp.linalg.slogdet(A)[1], jnp.linalg.solve(A, right)))
    root = jnp.asarray(np.random.default_rng(5).standard_normal((7, 7)))
    for derivative in (jax.value_and_grad, jax.hessian):
        got, expected = (jax.jit(derivative(f, argnums=(0, 1)))(root, right) for f in (fast, naive))
        for mine, theirs in zip(jax.tree.leaves(got), jax.tree.leaves(expected), strict=True):
            np.testing.assert_allclose(mine, theirs, rtol=1e-7, atol=1e-9)


def test_gradient_is_finite_where_s_underflows():
    G, log_s, right = _solve_problem()
    log_s = log_s.at[2].set(-2000.0).at[5].set(-800.0)
    gradient = jax.grad(_scalar(scaled_solve, G))(log_s, right)
    assert np.all(np.isfinite(gradient))
    assert gradient[2] == 0 and gradient[5] == 0


EDGES = {
    "no amplitude": {"amplitude": 1e-12},
    "flat": {"length_scale": [100.0, 100.0]},
    "flat in one direction, rough in the other": {"length_scale": [0.02, 100.0]},
    "noise-free": {"sigma": 1e-4, "amplitude": 10.0},
}


@pytest.mark.parametrize("path", ["hsgp", "exact"])
@pytest.mark.parametrize("variant", ["projected", "conditioned", "none"])
def test_gradients_are_finite_at_the_edges_of_the_prior(variant, path):
    design = _equation(OrthogonalGP(variant=variant, path=path), DATA["independent"]).design

    @jax.jit
    def value_and_gradient(hyper):
        def value(hyper, sd, log_odds):
            return CollapsedNormal(design, hyper, Scales(sd, log_odds)).log_prob(design.y)

        return jax.value_and_grad(value, argnums=(0, 1, 2))(hyper, SD, LOG_ODDS)

    for name, extreme in EDGES.items():
        hyper = HYPER._replace(**{key: jnp.asarray(value) for key, value in extreme.items()})
        bad = [leaf for leaf in jax.tree.leaves(value_and_gradient(hyper)) if not np.all(np.isfinite(leaf))]
        assert not bad, name


def test_coefficient_scale_of_zero_has_a_finite_gradient():
    design = _equation(OrthogonalGP(), DATA["independent"]).design
    gradient = jax.jit(jax.grad(lambda sd: CollapsedNormal(design, HYPER, Scales(sd)).log_prob(design.y)))(
        jnp.asarray([0.0, 1.0, 1e-200])
    )
    assert np.all(np.isfinite(gradient))


def test_constraint_directions_are_orthonormal_and_span_the_constraints():
    rng = np.random.default_rng(5)
    root, C = jnp.asarray(np.exp(rng.uniform(-4, 0, 12))), jnp.asarray(rng.standard_normal((3, 12)))
    U = np.asarray(constraint_directions(root, C))
    np.testing.assert_allclose(U.T @ U, np.eye(3), atol=1e-9)
    prior = np.diag(root) @ (np.eye(12) - U @ U.T) @ np.diag(root)
    S = np.diag(np.asarray(root) ** 2)
    expected = S - S @ C.T @ np.linalg.inv(C @ S @ C.T) @ C @ S
    np.testing.assert_allclose(prior, expected, atol=1e-10)


def _high_precision_log_prob(Phi, Psi_root, y, sigma, sd, digits=60):
    """log N(y; 0, Φ D Φᵀ + Ψ S Ψᵀ + σ² I) with `digits` decimal digits."""
    with mpmath.workdps(digits):
        B = mpmath.matrix(np.column_stack([Phi * np.asarray(sd), Psi_root]).tolist())
        covariance = B * B.T
        for i in range(covariance.rows):
            covariance[i, i] += mpmath.mpf(sigma) ** 2
        L = mpmath.cholesky(covariance)
        z = []
        for i in range(L.rows):
            z.append((mpmath.mpf(float(y[i])) - sum(L[i, j] * z[j] for j in range(i))) / L[i, i])
        log_det = 2 * sum(mpmath.log(L[i, i]) for i in range(L.rows))
        squares = sum(value**2 for value in z)
        return float(-(squares + log_det + L.rows * mpmath.log(2 * mpmath.pi)) / 2)


@pytest.mark.parametrize(("sigma", "tolerance"), [(1e-2, 1e-10), (1e-4, 1e-8), (1e-6, 1e-5)])
def test_noise_free_data_keep_their_digits(sigma, tolerance):
    """The squared target is 1e8 times the squared noise at σ = 1e-4: a difference of sums would lose it."""
    rng = np.random.default_rng(6)
    y, v = rng.uniform(-1, 1, 40), rng.uniform(-2, 3, 40)
    data = Trajectories.from_arrays(
        np.arange(40.0), states={"y": y, "v": v}, derivatives={"v": -(y**3) - 0.2 * v + 0.1 * y}
    )
    equation = _equation(OrthogonalGP(features=6), data)
    hyper = HYPER._replace(sigma=jnp.asarray(sigma))
    Phi, Psi = (np.asarray(part) for part in equation.frame.rows(data.columns))
    log_root, _ = equation.design.weight_prior(hyper)
    y = data.derivatives["v"] / equation.frame.target_scale
    expected = _high_precision_log_prob(Phi, Psi * np.exp(np.asarray(log_root)), y, sigma, SD)
    log_prob = jax.jit(lambda design: CollapsedNormal(design, hyper, Scales(SD)).log_prob(design.y))
    got = float(log_prob(equation.design))
    assert abs(got - expected) <= tolerance


@pytest.mark.parametrize("size", [1, LEAF, LEAF + 1, 3 * LEAF + 5])
def test_inverses_by_halves_are_inverses(size):
    rng = np.random.default_rng(size)
    factor = np.linalg.cholesky(np.eye(size) + np.cov(rng.normal(size=(size, 2 * size + 2))).reshape(size, size))
    inverse = np.asarray(inverse_lower(jnp.asarray(factor)))
    assert np.array_equal(np.triu(inverse, 1), np.zeros((size, size)))
    assert np.abs(inverse @ factor - np.eye(size)).max() < 1e-13 * size
