"""Checks of the noise model and of the prior: alarms ring, and stay quiet at their stated level."""

import jax
import numpy as np
import pytest
import xarray as xr
from fabricated import fabricate, oscillator
from scipy.stats import binom, kstest, norm

from bayes_greybox.criticism.combined import LEVEL, combined_p
from bayes_greybox.criticism.pit import _inverse, _parameters, anderson_darling, loo_pit
from bayes_greybox.criticism.pointwise import pointwise_loo, weighted_rows
from bayes_greybox.criticism.sensitivity import CONFLICT, DOMINANT, FINE, sensitivity
from bayes_greybox.criticism.whiteness import _autocorrelation, whiteness
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.draws import conditional_draws
from bayes_greybox.inference.prior import log_prior_densities
from bayes_greybox.model.discrepancy import OrthogonalGP
from bayes_greybox.model.priors import CustomPrior, Normal, SpikeAndSlab
from bayes_greybox.model.program import Program

MODEL = Program(dictionary={"v": ["y", "v", "y**3"]}, prior=Normal(), discrepancy=OrthogonalGP(features=4))
CHAINS, DRAWS = 2, 50


def data_of(n, noise, seed=0):
    """Rows of a spring and damper with the given noise, in scaled-up time order."""
    rng = np.random.default_rng(seed)
    y, v = rng.uniform(-1, 1, n), rng.uniform(-0.8, 0.8, n)
    return Trajectories.from_arrays(
        np.arange(n) * 0.1, states={"y": y, "v": v}, derivatives={"v": -(y**3) - 0.3 * v + noise}
    )


def posterior_of(data, sigma, model=MODEL, **given):
    """Exact draws of θ and f given known hyperparameters: σ in the data's unit, f all but absent, ℓ = 1."""
    shape = (CHAINS, DRAWS)
    scale = model.assemble(data)["v"].frame.target_scale
    hyper = {
        "sigma": np.full(shape, sigma / scale),
        "amplitude": np.full(shape, 1e-3),
        "length_scale": np.ones((*shape, 2)),
    }
    posterior = fabricate(model, data, chains=CHAINS, draws=DRAWS, **hyper, prior_sd=np.ones((*shape, 3)))
    designs = {name: entry.design for name, entry in posterior.equations.items()}
    noise = np.sqrt(hyper["sigma"] ** 2 - float(designs["v"].noise_floor) ** 2)
    samples = {
        "v_noise": noise,
        "v_amplitude": hyper["amplitude"],
        "v_length_scale": hyper["length_scale"],
        "v_tau": np.ones(shape),
        **given,
    }
    drawn = conditional_draws(model.numpyro_model, designs, samples, jax.random.PRNGKey(0))
    keys = {"theta": drawn["v_theta"], "weight": drawn["v_weight"], "prior_sd": drawn["v_theta_sd"]}
    posterior = fabricate(model, data, chains=CHAINS, draws=DRAWS, **{**hyper, **keys})
    # `fabricate` leaves weights in scaled units
    group = posterior.idata["posterior"].dataset
    extra = {name: (("chain", "draw"), value) for name, value in samples.items() if value.ndim == 2}
    extra["v_weight"] = (group["v_weight"].dims, group["v_weight"].to_numpy() * scale)
    for name in ("v_gamma", "v_inclusion"):
        if name in drawn:
            extra[name] = (("chain", "draw", "v_term"), drawn[name])
    posterior.idata["posterior"] = xr.DataTree(group.assign(extra))
    densities = log_prior_densities(model.numpyro_model, designs, {**samples, **drawn})
    posterior.idata["log_prior"] = xr.DataTree(
        xr.Dataset({name: (("chain", "draw"), value) for name, value in densities.items()})
    )
    return posterior


def test_twice_the_median_keeps_the_level_whatever_the_dependence():
    assert combined_p(np.full(5, 0.004)) == 0.008
    assert combined_p(np.full(5, 0.7)) == 1.0
    rng = np.random.default_rng(0)
    for share in (0.0, 0.5, 0.95):
        shared, own = rng.standard_normal((20_000, 1)), rng.standard_normal((20_000, 11))
        p = norm.sf(np.sqrt(share) * shared + np.sqrt(1 - share) * own)
        found = np.mean([combined_p(row) <= 0.1 for row in p])
        # one in 10⁴ such tests fails by chance if the level is 0.1
        assert found <= binom.isf(1e-4, 20_000, 0.1) / 20_000


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
            rows = weighted_rows(posterior, "v", np.arange(40))
            first, sd = jax.tree.map(lambda leaf: leaf[0], _parameters(draws))
            g, found = _inverse(design, rows, np.eye(40), first, sd)
            np.testing.assert_allclose(found, inverse, rtol=1e-6, atol=1e-8 * np.abs(inverse).max())
            np.testing.assert_allclose(g, inverse @ y, rtol=1e-6, atol=1e-8)
    # Unsmoothed weights are close where all draws have the same σ.
    ratio = -pointwise_loo(posterior, "v").T
    weight = np.exp(ratio - ratio.max(axis=1, keepdims=True))
    plain = np.sum(weight / weight.sum(axis=1, keepdims=True) * norm.cdf(np.array(z).T), axis=1)
    np.testing.assert_allclose(np.median(np.abs(pit.value - plain)), 0.0, atol=0.02)


def test_both_tests_keep_their_level_on_data_of_the_model():
    rejected, p = 0, []
    for seed in range(12):
        posterior = posterior_of(data_of(60, 0.1 * np.random.default_rng(100 + seed).standard_normal(60), seed), 0.1)
        found = loo_pit(posterior, "v").p, whiteness(posterior, "v").p
        p.append(found)
        rejected += int(min(found) <= LEVEL)
    # Level at most 2 % for the two together: more than two of twelve have probability 1.5e-3.
    assert rejected <= 2
    assert np.mean(np.array(p) > 0.1) > 0.5


@pytest.mark.parametrize(("factor", "words"), [(0.5, "too narrow"), (2.0, "too wide")])
def test_wrong_noise_rings_the_loo_pit_alarm(factor, words):
    noise = 0.1 * np.random.default_rng(1).standard_normal(120)
    pit = loo_pit(posterior_of(data_of(120, noise), 0.1 * factor), "v")
    assert pit.p <= LEVEL and pit.wrong == words


def test_correlated_residuals_ring_and_name_their_lags():
    rng = np.random.default_rng(2)
    white = rng.standard_normal(202)
    noise = 0.1 / np.sqrt(1.64) * (white[2:] + 0.8 * white[:-2])
    found = whiteness(posterior_of(data_of(200, noise), 0.1), "v")
    # a moving average over rows two apart: r_2 = 0.8/1.64, all others zero
    assert found.p <= LEVEL and found.standing_out == (2,)
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

    def fixed(sd):
        return Program(
            dictionary=MODEL.dictionary,
            prior=CustomPrior(lambda n_term: np.full(n_term, sd)),
            discrepancy=MODEL.discrepancy,
        )

    quiet = sensitivity(posterior_of(data, 0.1, fixed(10.0)))
    assert (quiet["diagnosis"] == FINE).all()
    # The data put θ thirty prior standard deviations from zero.
    against = sensitivity(posterior_of(data, 0.1, fixed(0.03)))
    assert against.loc[("v", "y**3"), "diagnosis"] == CONFLICT
    # A prior sharper than the data, and in accord with them, decides.
    blunt = data_of(40, 3.0 * np.random.default_rng(4).standard_normal(40))
    decided = sensitivity(posterior_of(blunt, 3.0, fixed(0.02)))
    assert (decided["diagnosis"] != FINE).any() and decided["likelihood"].min() < 0.05
    assert DOMINANT in set(decided["diagnosis"])


def test_inclusion_is_recomputed_exactly_under_a_scaled_prior():
    """Known η: dP/dα by the module's weights equals that of all eight patterns by dense algebra."""
    data = data_of(30, 0.5 * np.random.default_rng(5).standard_normal(30), seed=5)
    model = Program(dictionary=MODEL.dictionary, prior=SpikeAndSlab(), discrepancy=MODEL.discrepancy)
    shape = (CHAINS, DRAWS)
    posterior = posterior_of(data, 0.5, model, v_pi=np.full(shape, 0.4))
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
    assert expected.max() > 0.01
    found = [table.loc[("v", f"P({term})"), "prior"] for term in frame.dictionary.names]
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-6)
