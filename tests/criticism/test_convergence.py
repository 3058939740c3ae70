"""The verdict: each alarm rings, and all stay quiet on good draws."""

import numpy as np
import pytest
from fabricated import fabricate, oscillator

from bayes_greybox import greybox
from bayes_greybox.criticism.convergence import (
    _beyond,
    boundary_needed,
    convergence,
    convergence_table,
    features_needed,
)
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.program import Program

CHAINS, DRAWS = 4, 1000


@pytest.fixture(scope="module")
def model():
    return Program(dictionary={"v": ["y", "v", "y**3"]}, discrepancy=OrthogonalGP(features=8))


@pytest.fixture(scope="module")
def data():
    return oscillator(40)


def verdict_of(model, data, *, chains=CHAINS, draws=DRAWS, **given):
    return convergence(fabricate(model, data, chains=chains, draws=draws, **given))


def scalar(seed=1):
    return 0.1 * np.exp(0.2 * np.random.default_rng(seed).standard_normal((CHAINS, DRAWS)))


def test_independent_draws_pass(model, data):
    verdict = verdict_of(model, data)
    assert verdict.ok
    assert verdict.reasons == ()
    assert "Converged" in str(verdict)


def test_a_chain_elsewhere_is_named(model, data):
    sigma = scalar()
    sigma[2] *= 1.5
    verdict = verdict_of(model, data, sigma=sigma)
    assert not verdict.ok
    assert "the noise's standard deviation" in verdict.reasons[0]
    assert "R̂" in verdict.reasons[0] and "tune" in verdict.reasons[0]
    assert str(verdict).startswith("Not converged")


def test_slow_mixing_asks_for_more_draws(model, data):
    rng = np.random.default_rng(5)
    x = np.zeros((CHAINS, DRAWS))
    # AR(1) with φ = 0.95 has ESS = S (1 − φ)/(1 + φ) = 103 of 4000
    for i in range(1, DRAWS):
        x[:, i] = 0.95 * x[:, i - 1] + rng.standard_normal(CHAINS)
    verdict = verdict_of(model, data, sigma=0.1 * np.exp(0.02 * x))
    (reason,) = [r for r in verdict.reasons if "bulk" in r]
    assert "the noise's standard deviation" in reason
    needed = int(reason.split("about ")[1].rstrip("."))
    assert 2500 < needed < 10_000


def autoregressive(phi, seed):
    """Chains of a variance of one, whose effective draws are a share (1 − φ)/(1 + φ) of all."""
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((CHAINS, DRAWS))
    for i in range(1, DRAWS):
        x[:, i] = phi * x[:, i - 1] + np.sqrt(1 - phi**2) * x[:, i]
    return x


@pytest.mark.parametrize(("phi", "seed", "short"), [(0.83, 5, True), (0.92, 3, False)])
def test_chains_that_agree_and_are_a_little_short_are_not_called_useless(model, data, phi, seed, short):
    """Bulk effective sample sizes of 330 and 195, whose R̂ both pass."""
    sigma = 0.1 * np.exp(0.02 * autoregressive(phi, seed))
    posterior = fabricate(model, data, chains=CHAINS, draws=DRAWS, sigma=sigma)
    verdict = convergence(posterior)
    assert not verdict.ok and verdict.short == short == verdict.mixed
    assert ("do not rely" in str(verdict)) != short and "raise draws to about" in str(verdict)
    # Divergences and chains that disagree are never forgiven.
    diverging = np.zeros((CHAINS, DRAWS), bool)
    diverging[0, 3] = True
    assert not verdict_of(model, data, sigma=sigma, stats={"diverging": diverging}).mixed
    sigma[2] *= 1.1
    assert not verdict_of(model, data, sigma=sigma).mixed


def test_divergences_energy_and_tree_depth(model, data):
    diverging = np.zeros((CHAINS, DRAWS), bool)
    diverging[0, 3] = True
    (reason,) = verdict_of(model, data, stats={"diverging": diverging}).reasons
    assert "1 divergence" in reason and "target_accept" in reason

    rng = np.random.default_rng(0)
    energy = rng.standard_normal((CHAINS, DRAWS))
    energy[1] = np.cumsum(rng.standard_normal(DRAWS))
    (reason,) = verdict_of(model, data, stats={"energy": energy}).reasons
    assert "E-BFMI" in reason

    n_steps = np.full((CHAINS, DRAWS), 1000)  # depth 10, but a turn ended the last doubling
    assert verdict_of(model, data, stats={"n_steps": n_steps}).ok
    n_steps[0, :100] = 1023
    (reason,) = verdict_of(model, data, stats={"n_steps": n_steps}).reasons
    assert "tree depth" in reason


def test_too_few_draws_is_said_in_words(model, data):
    reasons = verdict_of(model, data, draws=50).reasons
    assert any("200 draws in all, too few" in reason for reason in reasons)
    assert not any("is below" in reason or "sample size is" in reason for reason in reasons)
    assert any("chains=4" in reason for reason in verdict_of(model, data, chains=1).reasons)


def test_constants_have_no_r_hat_and_do_not_fail(model, data):
    rng = np.random.default_rng(2)
    theta = rng.standard_normal((CHAINS, DRAWS, 3))
    gamma = np.ones((CHAINS, DRAWS, 3), int)
    theta[..., 0], gamma[..., 0] = 0.0, 0
    posterior = fabricate(model, data, chains=CHAINS, draws=DRAWS, theta=theta, gamma=gamma)
    assert convergence(posterior).ok
    table = convergence_table(posterior)
    assert np.isnan(table.loc["v_theta[y]", "r_hat"])
    assert np.isnan(table.loc["v_gamma[v]", "ess_bulk"])
    assert table.loc["v_theta[v]", "ess_bulk"] > 3000
    sd = posterior.idata["posterior"]["v_theta"].to_numpy()[..., 1].std()
    np.testing.assert_allclose(table.loc["v_theta[v]", "mcse"], sd / np.sqrt(4000), rtol=0.15)


def test_chains_stuck_at_different_values_fail(model, data):
    gamma = np.ones((CHAINS, DRAWS, 3), int)
    gamma[0, :, 1] = 0
    verdict = verdict_of(model, data, gamma=gamma)
    assert any("whether v is in the model" in reason and "inf" in reason for reason in verdict.reasons)


def weights(model, data, size, seed=6):
    """Independent weights of f [n_chain, n_draw, n_basis] with RMS of f at the data in units of the target's scale."""
    equation = model.assemble(data)["v"]
    Psi = equation.parts()[1]
    draws = np.random.default_rng(seed).standard_normal((CHAINS, DRAWS, Psi.shape[1]))
    return draws * np.broadcast_to(size, (CHAINS, DRAWS))[..., None] / np.sqrt(np.mean(np.sum(Psi**2, axis=1)))


def wandering(seed=5, spread=0.5):
    """Chains that mix slowly, as AR(1) with φ = 0.9: ESS 210 of 4000."""
    rng, x = np.random.default_rng(seed), np.zeros((CHAINS, DRAWS))
    for i in range(1, DRAWS):
        x[:, i] = 0.9 * x[:, i - 1] + np.sqrt(1 - 0.9**2) * rng.standard_normal(CHAINS)
    return np.exp(spread * x)


def test_weights_are_not_judged(model, data):
    # Chains that differ, each around a value of its own; f is told from zero.
    each = weights(model, data, 0.0) + np.arange(1.0, CHAINS + 1)[:, None, None]
    assert verdict_of(model, data, weight=each).ok


def test_hyperparameters_of_a_discrepancy_that_the_noise_hides_do_not_ring(model, data):
    """They wander over their prior; f itself, the coefficients and the noise are as sure as can be."""
    size = 0.01 * wandering()
    lengths = np.stack([wandering(7), wandering(8)], axis=-1)
    nil = {"amplitude": size, "length_scale": 4.0 + lengths, "weight": weights(model, data, size)}
    posterior = fabricate(model, data, chains=CHAINS, draws=DRAWS, **nil)
    table = convergence_table(posterior)
    assert convergence(posterior).ok
    assert not {"v_amplitude", "v_length_scale[y]"} & set(table.index)
    assert {"v_discrepancy[where it is largest]", "v_discrepancy[where it is least certain]"} < set(table.index)
    # The same hyperparameters ring where f is not hidden: as large as five times the noise, and told from zero.
    large = weights(model, data, 0.05) + 1.0
    seen = fabricate(model, data, chains=CHAINS, draws=DRAWS, **{**nil, "weight": large})
    assert {"v_amplitude", "v_length_scale[y]"} < set(convergence_table(seen).index)
    assert any("along" in reason or "amplitude of f" in reason for reason in convergence(seen).reasons)


@pytest.mark.parametrize("quantity", ["sigma", "theta"])
def test_a_hidden_discrepancy_hides_no_other_quantity(model, data, quantity):
    nil = {"amplitude": 0.01 * wandering(), "weight": weights(model, data, 0.01)}
    bad = scalar() if quantity == "sigma" else np.random.default_rng(1).standard_normal((CHAINS, DRAWS, 3))
    bad[2] = 1.5 * bad[2] if quantity == "sigma" else bad[2] + 1.0
    assert not verdict_of(model, data, **nil, **{quantity: bad}).ok


def test_one_chain_that_found_a_discrepancy_rings(model, data):
    """Three chains have none and one has one: on the mean of all it is smaller than its spread."""
    size = np.full((CHAINS, DRAWS), 0.01) * np.exp(0.1 * np.random.default_rng(4).standard_normal((CHAINS, DRAWS)))
    size[3] *= 30
    weight = weights(model, data, 0.01)
    weight[3] += 1.0
    reasons = verdict_of(model, data, amplitude=size, weight=weight).reasons
    assert any("the amplitude of f" in reason and "R̂" in reason for reason in reasons)


def test_chains_that_hold_different_hidden_discrepancies_ring(model, data):
    """Each too small to be told from zero, but chains that mix have the same."""
    weight = weights(model, data, 0.04)
    sign = np.array([1.0, 1.0, -1.0, -1.0])[:, None, None]
    weight = weight + sign * weights(model, data, 0.04).std()
    reasons = verdict_of(model, data, amplitude=scalar(3), weight=weight).reasons
    assert any("f where it is" in reason for reason in reasons)


def test_length_scales_too_short_for_the_basis_ask_for_features(model, data):
    # 1.75 · 2/8 = 0.44 half-widths is the shortest that 8 features resolve with boundary factor 2
    short = np.exp(0.05 * np.random.default_rng(3).standard_normal((CHAINS, DRAWS, 2))) * [0.25, 1.0]
    (reason,) = verdict_of(model, data, length_scale=short).reasons
    assert "'y'" in reason and "'v'" not in reason.split("wants")[1]
    needed = int(reason.split("at least (")[1].split(",")[0])
    assert 14 <= needed <= 17
    negligible = np.full((CHAINS, DRAWS), 1e-3) * np.exp(
        0.1 * np.random.default_rng(4).standard_normal((CHAINS, DRAWS))
    )
    assert verdict_of(model, data, length_scale=short, amplitude=negligible).ok


def test_features_that_no_row_would_show_are_not_asked_for(model, data):
    """Finer ones add a tenth to the variance of an f with ℓ = (0.25, 1): 40 rows show it of σ, and not of σ/7."""
    sigma = scalar()
    for n, size, needed in ((40, 1.0, True), (40, 0.15, False), (2000, 0.15, True), (2000, 0.03, False)):
        posterior = fabricate(model, oscillator(n), **scattered([0.25, 1.0], sigma=sigma, amplitude=size * sigma))
        assert bool(features_needed(posterior)) is needed


def scattered(centres, seed=3, **more):
    values = np.exp(0.05 * np.random.default_rng(seed).standard_normal((CHAINS, DRAWS, len(centres)))) * centres
    return {"chains": CHAINS, "draws": DRAWS, "length_scale": values, **more}


def test_length_scales_too_long_for_the_domain_ask_for_a_wider_one(model, data):
    # 2/3.2 = 0.62 half-widths is the longest that a squared exponential may have with boundary factor 2.
    posterior = fabricate(model, data, **scattered([1.0, 0.5]))
    assert boundary_needed(posterior) == {"v": (pytest.approx(3.2, rel=0.02), 2.0)}
    # What hardly varies over the box needs no more than this, however long its length scale.
    assert boundary_needed(fabricate(model, data, **scattered([1.5, 9.0]))) == {"v": (4.0, 4.0)}
    assert boundary_needed(fabricate(model, data, **scattered([0.55, 0.5]))) == {}
    # Where it is not sure of it, or f is nothing, the domain stays.
    vague = np.exp(np.random.default_rng(3).standard_normal((CHAINS, DRAWS, 2)))
    assert boundary_needed(fabricate(model, data, chains=CHAINS, draws=DRAWS, length_scale=vague)) == {}
    negligible = np.full((CHAINS, DRAWS), 1e-3)
    assert boundary_needed(fabricate(model, data, **scattered([1.0, 0.5], amplitude=negligible))) == {}
    # The number of features goes with the width of the domain: 1.75 · 4/0.46.
    assert features_needed(posterior, (4.0, 4.0))["v"] == (8, 16)
    assert not features_needed(posterior) and not features_needed(posterior, (4.0, 2.0))


def test_a_long_length_scale_does_not_fail_the_verdict(model, data):
    """Of a variable that f does not depend on it is as long as can be, and the constant is among the features."""
    assert verdict_of(model, data, **scattered([1.0, 8.0])).ok


def test_a_refit_gets_the_wider_domain_with_the_features_it_needs_as_far_as_they_are_affordable(data):
    def refined(centres, **given):
        gp = OrthogonalGP(variables=("y", "v"), **given)
        model = Program({"v": ["y", "v", "y**3"]}, discrepancy=gp)
        found = greybox._refined(model, gp, fabricate(model, data, **scattered(centres)))
        return None if found is None else found.discrepancy

    wide = refined([1.0, 0.5])
    assert wide.boundary == (pytest.approx(3.2, rel=0.02), 2.0)
    # 1.75 · 3.2/0.92 are fewer than there are.
    assert wide.features is None
    assert refined([0.5, 0.5]) is None
    # The other direction is refined at the width that it has: 1.75 · 2/0.276, and 15 % more.
    both = refined([4.0, 0.3])
    assert both.boundary == (4.0, 2.0) and both.features == (12, pytest.approx(15, abs=1))
    # What users say stays.
    assert refined([1.5, 0.5], features=10) is None
    assert refined([1.5, 1.5], boundary=6.0) is None


def test_features_that_a_wider_domain_needs_may_be_too_many(data, monkeypatch):
    gp = OrthogonalGP(variables=("y", "v"))
    model = Program({"v": ["y", "v", "y**3"]}, discrepancy=gp)
    posterior = fabricate(model, data, **scattered([4.0, 0.3]))
    assert greybox._refined(model, gp, posterior).discrepancy.boundary != 2.0
    # Nothing but what is asked for on the wider domain, (12, 15), is beyond this.
    monkeypatch.setattr(greybox, "LARGEST_BASIS", 150)
    assert greybox._refined(model, gp, posterior) is None


def test_a_number_is_seen_beyond_its_limit():
    assert _beyond(1.0103, 1.01) == "1.0103" and _beyond(1.224, 1.01) == "1.22"
