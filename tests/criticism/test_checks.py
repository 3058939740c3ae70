"""Checks of the noise model and of the prior: alarms ring, and stay quiet at their stated level."""

import jax
import numpy as np
import pytest
import xarray as xr
from fabricated import fabricate, oscillator
from scipy.stats import binom, kstest, norm

from bayes_greybox.criticism.checks.loo_pit import (
    TEST_LEVEL,
    _inverse,
    anderson_darling,
    combined_p,
    loo_pit,
)
from bayes_greybox.criticism.checks.sensitivity import CONFLICT, DOMINANT, NOT_SENSITIVE, sensitivity
from bayes_greybox.criticism.checks.whiteness import _autocorrelation, whiteness
from bayes_greybox.criticism.cross_validation.row_densities import parameters_of, pointwise_loo
from bayes_greybox.criticism.inclusion import inclusion
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.noise.asked import Noise
from bayes_greybox.model.priors import CustomPrior, Normal, SpikeAndSlab
from bayes_greybox.model.program import Program

MODEL = Program(dictionary={"v": ["y", "v", "y**3"]}, prior=Normal(), discrepancy=OrthogonalGP(features=4))
CHAINS, DRAWS = 2, 200


def data_of(n, noise, seed=0):
    """Rows of a spring and damper with the given noise, in scaled-up time order."""
    rng = np.random.default_rng(seed)
    y, v = rng.uniform(-1, 1, n), rng.uniform(-0.8, 0.8, n)
    return Trajectories.from_arrays(
        np.arange(n) * 0.1, states={"y": y, "v": v}, derivatives={"v": -(y**3) - 0.3 * v + noise}
    )


def posterior_of(data, sigma, model=MODEL, sd=1.0, pi=None):
    """Exact draws of θ, and of γ where π is given, with σ known (in the data's unit) and f all but absent."""
    shape = (CHAINS, DRAWS)
    frame = model.assemble(data)["v"].frame
    Phi = np.asarray(frame.dictionary_rows(data.columns))
    y, sigma = data.derivatives["v"] / frame.target_scale, sigma / frame.target_scale
    rng, bits = np.random.default_rng(0), np.ones((1, 3))
    if pi is not None:
        bits = np.array([[i >> k & 1 for k in range(3)] for i in range(8)], float)
    log_weight = []
    for gamma in bits:
        C = (Phi * gamma * sd**2) @ Phi.T + sigma**2 * np.eye(len(y))
        odds = 0.0 if pi is None else np.sum(gamma * np.log(pi) + (1 - gamma) * np.log(1 - pi))
        log_weight.append(odds - 0.5 * (np.linalg.slogdet(C)[1] + y @ np.linalg.solve(C, y)))
    weight = np.exp(np.array(log_weight) - max(log_weight))
    gamma = bits[rng.choice(len(bits), size=shape, p=weight / weight.sum())]
    theta = np.zeros((*shape, 3))
    for i in np.ndindex(shape):
        B = Phi * gamma[i] * sd / sigma
        L = np.linalg.cholesky(np.eye(3) + B.T @ B)
        u = np.linalg.solve(L @ L.T, B.T @ y / sigma) + np.linalg.solve(L.T, rng.standard_normal(3))
        theta[i] = gamma[i] * sd * u
    given = {"sigma": np.full(shape, sigma), "amplitude": np.full(shape, 1e-3), "length_scale": np.ones((*shape, 2))}
    size = 0 if frame.basis is None else frame.basis.size
    given |= {"theta": theta, "prior_sd": sd * gamma, "weight": np.zeros((*shape, size))}
    density = {"v_theta": np.sum(gamma * norm.logpdf(theta, 0, sd), axis=-1), "v_noise": np.zeros(shape)}
    if pi is not None:
        given |= {"gamma": gamma, "pi": np.full(shape, pi), "tau": np.full(shape, sd)}
    posterior = fabricate(model, data, chains=CHAINS, draws=DRAWS, **given)
    posterior.idata["log_prior"] = xr.DataTree(
        xr.Dataset({name: (("chain", "draw"), value) for name, value in density.items()})
    )
    return posterior


def test_twice_the_median_keeps_the_level_whatever_the_dependence():
    assert combined_p(np.full(5, 0.004)) == 0.008
    assert combined_p(np.full(5, 0.7)) == 1.0
    rng = np.random.default_rng(0)
    for share in (0.0, 0.5, 0.95):
        shared, own = rng.standard_normal((4_000, 1)), rng.standard_normal((4_000, 11))
        p = norm.sf(np.sqrt(share) * shared + np.sqrt(1 - share) * own)
        found = np.mean([combined_p(row) <= 0.1 for row in p])
        # one in 10⁴ such tests fails by chance if the level is 0.1
        assert found <= binom.isf(1e-4, 4_000, 0.1) / 4_000


def test_anderson_darling_has_its_known_distribution():
    statistic = anderson_darling(np.random.default_rng(0).standard_normal((20_000, 50)))
    # Stephens 1974: P(A² > 2.492) = 0.05, P(A² > 3.857) = 0.01 for known parameters
    assert abs(np.mean(statistic > 2.492) - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 20_000)
    assert abs(np.mean(statistic > 3.857) - 0.01) < 4 * np.sqrt(0.01 * 0.99 / 20_000)


def test_loo_pit_is_that_of_dense_algebra():
    data = oscillator(40)
    posterior = fabricate(MODEL, data, draws=30, sigma=np.full((2, 30), 0.1))
    pit = loo_pit(posterior, "v")
    draws = posterior.draws("v")
    frame = posterior.equations["v"].frame
    Phi, Psi = (np.asarray(part) for part in frame.rows(data.columns))
    y = data.derivatives["v"] / frame.target_scale
    design = posterior.equations["v"].design
    z = []
    for s in range(60):
        hyper = jax.tree.map(lambda leaf: leaf[s], draws.hyper)  # noqa: B023
        root = np.exp(np.asarray(design.weight_prior(hyper)[0]))
        C = (Phi * draws.prior_sd[s] ** 2) @ Phi.T + (Psi * root**2) @ Psi.T + float(hyper.sigma) ** 2 * np.eye(40)
        inverse = np.linalg.inv(C)
        z.append(inverse @ y / np.sqrt(np.diag(inverse)))
        if s == 0:
            rows = posterior.equations["v"].weighted()(np.arange(40))
            first, sd, mean = jax.tree.map(lambda leaf: leaf[0], parameters_of(draws))
            g, found = _inverse(design, rows, np.eye(40), first, sd, mean)
            np.testing.assert_allclose(found, inverse, rtol=1e-6, atol=1e-8 * np.abs(inverse).max())
            np.testing.assert_allclose(g, inverse @ y, rtol=1e-6, atol=1e-8)
    # Unsmoothed weights are close where all draws have the same σ.
    ratio = -pointwise_loo(posterior, "v").T
    weight = np.exp(ratio - ratio.max(axis=1, keepdims=True))
    plain = np.sum(weight / weight.sum(axis=1, keepdims=True) * norm.cdf(np.array(z).T), axis=1)
    np.testing.assert_allclose(np.median(np.abs(pit.value - plain)), 0.0, atol=0.02)


@pytest.mark.slow
def test_both_tests_keep_their_level_on_data_of_the_model():
    rejected, p = 0, []
    for seed in range(12):
        posterior = posterior_of(data_of(60, 0.1 * np.random.default_rng(100 + seed).standard_normal(60), seed), 0.1)
        found = loo_pit(posterior, "v").p, whiteness(posterior, "v").p
        p.append(found)
        rejected += int(min(found) <= TEST_LEVEL)
    # Level at most 2 % for the two together: more than two of twelve have probability 1.5e-3.
    assert rejected <= 2
    assert np.mean(np.array(p) > 0.1) > 0.5


@pytest.mark.parametrize(("factor", "words"), [(0.5, "too narrow"), (2.0, "too wide")])
def test_wrong_noise_rings_the_loo_pit_alarm(factor, words):
    noise = 0.1 * np.random.default_rng(1).standard_normal(120)
    pit = loo_pit(posterior_of(data_of(120, noise), 0.1 * factor), "v")
    assert pit.p <= TEST_LEVEL and pit.wrong == words


def test_correlated_residuals_ring_and_name_their_lags():
    rng = np.random.default_rng(2)
    white = rng.standard_normal(202)
    noise = 0.1 / np.sqrt(1.64) * (white[2:] + 0.8 * white[:-2])
    found = whiteness(posterior_of(data_of(200, noise), 0.1), "v")
    # a moving average over rows two apart: r_2 = 0.8/1.64, all others zero
    assert found.p <= TEST_LEVEL and found.standing_out == (2,)
    assert abs(found.autocorrelation[1] - 0.8 / 1.64) < 4 / np.sqrt(200)


def test_runs_do_not_correlate_across_their_border():
    e = np.random.default_rng(0).standard_normal((4000, 60))
    z, _, _ = _autocorrelation(e, [25, 35], np.arange(1, 6))
    # z has mean zero and unit variance exactly, whatever the lengths: 4 standard errors
    assert np.all(np.abs(z.mean(axis=0)) < 4 / np.sqrt(4000))
    assert np.all(np.abs(z.var(axis=0) - 1) < 4 * np.sqrt(2.5 / 4000))
    changed = e.copy()
    changed[:, 25:] *= -1
    np.testing.assert_allclose(_autocorrelation(changed, [25, 35], np.arange(1, 6))[0], z)
    assert kstest(z[:, 0], "norm").pvalue > 1e-4


def test_a_prior_against_the_data_rings_and_a_wide_one_stays_quiet():
    data = data_of(40, 0.1 * np.random.default_rng(3).standard_normal(40))

    def fixed(data, sigma, sd):
        prior = CustomPrior(lambda n_term: np.full(n_term, sd))
        model = Program(dictionary=MODEL.dictionary, prior=prior, discrepancy=MODEL.discrepancy)
        return sensitivity(posterior_of(data, sigma, model, sd))

    assert (fixed(data, 0.1, 10.0)["diagnosis"] == NOT_SENSITIVE).all()
    # The data put θ more than ten prior standard deviations from zero.
    assert fixed(data, 0.1, 0.05).loc[("v", "y**3"), "diagnosis"] == CONFLICT
    # Data that say next to nothing leave it to the prior.
    blunt = data_of(40, 30.0 * np.random.default_rng(4).standard_normal(40))
    assert (fixed(blunt, 30.0, 0.02)["diagnosis"] == DOMINANT).all()


def test_inclusion_is_recomputed_exactly_under_a_scaled_prior():
    """Known η: dP/dα by the module's weights equals that of all eight patterns by dense algebra."""
    data = data_of(30, 0.5 * np.random.default_rng(5).standard_normal(30), seed=5)
    model = Program(dictionary=MODEL.dictionary, prior=SpikeAndSlab(), discrepancy=MODEL.discrepancy)
    posterior = posterior_of(data, 0.5, model, pi=0.4)
    table = sensitivity(posterior)
    frame, design = posterior.equations["v"].frame, posterior.equations["v"].design
    Phi, Psi = (np.asarray(part) for part in frame.rows(data.columns))
    y = data.derivatives["v"] / frame.target_scale
    hyper = jax.tree.map(lambda leaf: leaf[0], posterior.draws("v").hyper)
    root = np.exp(np.asarray(design.weight_prior(hyper)[0]))
    base = (Psi * root**2) @ Psi.T + float(hyper.sigma) ** 2 * np.eye(30)
    bits = np.array([[i >> k & 1 for k in range(3)] for i in range(8)], float)

    def probability(alpha):
        logs = []
        for gamma in bits:
            C = base + (Phi * gamma / alpha) @ Phi.T
            evidence = -0.5 * (np.linalg.slogdet(C)[1] + y @ np.linalg.solve(C, y))
            logs.append(evidence + alpha * np.sum(gamma * np.log(0.4) + (1 - gamma) * np.log(0.6)))
        weight = np.exp(np.array(logs) - max(logs))
        return weight @ bits / weight.sum()

    expected = np.abs(probability(1.01) - probability(0.99)) / np.log2(1.01 / 0.99)
    assert expected.max() > 1e-3
    found = [table.loc[("v", f"P({term})"), "prior"] for term in frame.dictionary.names]
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-6)


def test_shrinkage_is_by_what_the_rows_say_of_a_term_under_their_noise():
    """Of rows that hang together a constant is known by few, and what changes from row to row by all of them."""
    data = data_of(200, 0.1 * np.random.default_rng(6).standard_normal(200))
    model = Program(dictionary={"v": ["1", "y", "v"]}, prior=Normal(), discrepancy=None, noise=Noise(correlation=2.0))
    model, data = model.with_noise_found(data)
    sd, sigma = np.full((1, 5, 3), 0.5), np.full((1, 5), 0.3)
    posterior = fabricate(model, data, chains=1, draws=5, prior_sd=sd, sigma=sigma)
    rows, frame = posterior.equations["v"].rows, posterior.equations["v"].frame
    Phi = np.asarray(frame.dictionary_rows(data.columns))
    R = rows.noise.correlated(np.eye(200)).T
    known = np.sum(np.linalg.solve(R, Phi) ** 2, axis=0)
    np.testing.assert_allclose(inclusion(posterior)["shrinkage"], 1 / (1 + known * 0.5**2 / 0.3**2), rtol=1e-6)
    assert known[0] < 0.3 * known[1]
