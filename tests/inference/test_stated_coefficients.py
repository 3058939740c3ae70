"""Fits with priors of single coefficients: posteriors against closed forms, and everything that a fit does after."""

from itertools import product

import jax
import numpy as np
import pytest
from fabricated import fabricate
from sampled_oscillator import sampled
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

import bayes_greybox as bg
from bayes_greybox.criticism.cross_validation.fold_densities import fold_densities, fold_parameters
from bayes_greybox.criticism.cross_validation.row_densities import pointwise_loo
from bayes_greybox.model.priors import Coefficient

TERMS = ["y", "ydot", "y**3"]
RUN = {"draws": 300, "tune": 300, "chains": 2, "progress": False}

Z = 4.5
"""Monte Carlo standard errors allowed; a true difference of zero exceeds them once in 150,000 comparisons."""


@pytest.fixture(scope="module")
def data():
    return bg.systems.oscillator().simulate(np.linspace(0, 12, 60), noise=0.2, seed=2)


def model_of(stated, dictionary=TERMS, **parts):
    parts = {"prior": bg.Normal(), "discrepancy": None} | parts
    return bg.GreyBox(dictionary={"ydot": dictionary}, coefficients={"ydot": stated}, **parts)


def theta(fit):
    return fit.idata["posterior"]["ydot_theta"].to_numpy()


def assert_agree(draws, mean):
    """The mean of draws [n_chain, n_draw] is a known one within Z standard errors."""
    from arviz_stats.base.array import array_stats

    ess = float(np.asarray(array_stats.ess(draws, chain_axis=0, draw_axis=1, method="mean")))
    assert abs(draws.mean() - mean) <= Z * draws.std() / np.sqrt(ess)


@pytest.fixture(scope="module")
def informed(data):
    stated = {
        "y": Coefficient(mean=-0.2, sd=0.1),
        "ydot": Coefficient(mean=0.3, sd=0.2),
        "y**3": Coefficient(mean=-1.0, sd=0.5),
    }
    return model_of(stated).fit(data, seed=1, **RUN)


def test_normal_priors_give_the_conjugate_posterior(informed, data):
    """p(θ | y) = ∫ N(θ; conjugate mean and covariance given σ) p(σ | y) dσ, in user's units, on a grid of σ."""
    y, rate = data.columns, data.derivatives["ydot"]
    Phi = np.column_stack([y["y"], y["ydot"], y["y"] ** 3])
    m, D = np.array([-0.2, 0.3, -1.0]), np.diag([0.1, 0.2, 0.5]) ** 2
    scale = np.sqrt(np.mean(rate**2))
    s = np.linspace(0.05, 1.5, 400) * scale
    sigma = np.hypot(1e-4 * scale, s)
    log_p = [
        multivariate_normal(Phi @ m, Phi @ D @ Phi.T + v**2 * np.eye(len(rate))).logpdf(rate) + norm.logpdf(u / scale)
        for u, v in zip(s, sigma, strict=True)
    ]
    weight = np.exp(log_p - logsumexp(log_p))
    V = np.array([np.linalg.inv(Phi.T @ Phi / v**2 + np.linalg.inv(D)) for v in sigma])
    means = np.array([each @ (Phi.T @ rate / v**2 + np.linalg.inv(D) @ m) for each, v in zip(V, sigma, strict=True)])
    mean = weight @ means
    variance = weight @ (np.diagonal(V, axis1=1, axis2=2) + (means - mean) ** 2)
    for j in range(3):
        assert_agree(theta(informed)[..., j], mean[j])
        assert_agree((theta(informed)[..., j] - mean[j]) ** 2, variance[j])


def drawn_by_hand(model, data, **given):
    """A fit of random draws, the same for models with as many terms."""
    made = fabricate(model, data, draws=10, **given)
    return bg.Fit(made.model, made.data, made.sampling, made.idata)


def test_a_fixed_coefficient_is_a_part_of_the_simulation(data):
    parts = {"simulation": {"y": "ydot", "ydot": "-0.1*y"}, "discrepancy": bg.OrthogonalGP(features=5)}
    weight = {"weight": 0.1 * np.random.default_rng(1).standard_normal((2, 10, 25))}
    fixed = drawn_by_hand(model_of({"y**3": Coefficient(fixed=-1.0)}, **parts), data, **weight)
    moved = {"y": "ydot", "ydot": "-0.1*y - 1.0*y**3"}
    known = drawn_by_hand(model_of({}, ["y", "ydot"], **{**parts, "simulation": moved}), data, **weight)
    # All that a sampler sees of a model is its design.
    for one, other in zip(*(jax.tree.leaves(fit.equations["ydot"].design) for fit in (fixed, known)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(theta(fixed), theta(known), rtol=1e-6)
    for each in ("predict", "simulate"):
        one, other = getattr(fixed, each)(data), getattr(known, each)(data)
        if each == "predict":
            np.testing.assert_allclose(one["ydot"].rate.mean, other["ydot"].rate.mean, rtol=1e-6, atol=1e-9)
        else:
            np.testing.assert_allclose(one.nrmse().to_numpy(), other.nrmse().to_numpy(), rtol=1e-4)
    row = fixed.inclusion().loc[("ydot", "y**3")]
    assert (row["mean"], row["sd"], row["lower"], row["upper"]) == (-1.0, 0.0, -1.0, -1.0)
    assert fixed.summary().loc[("ydot", "y**3"), "mean"] == -1.0
    assert np.isnan(fixed.summary().loc[("ydot", "y**3"), "r_hat"])


@pytest.fixture(scope="module")
def signed(data):
    """Signs that the data speak against (y) or leave open (ydot), and a bound that leaves zero out."""
    stated = {"y": Coefficient(sign=1), "ydot": Coefficient(sign=-1)}
    return model_of(stated).fit(data, seed=1, **RUN)


@pytest.mark.slow
def test_signs_restrict_the_posterior(signed, data):
    """With zero as the bound, P(box | τ) is a half whatever τ: the draws without bounds that keep to them."""
    free = model_of({}).fit(data, seed=2, **RUN | {"draws": 2000})
    drawn = theta(free).reshape(-1, 3)
    kept = drawn[(drawn[:, 0] >= 0) & (drawn[:, 1] <= 0)]
    assert len(kept) > 200
    got = theta(signed)
    assert np.all(got[..., 0] >= 0) and np.all(got[..., 1] <= 0)
    from arviz_stats.base.array import array_stats

    for j in range(3):
        ess = float(np.asarray(array_stats.ess(got[..., j], chain_axis=0, draw_axis=1, method="mean")))
        # NUTS without bounds on three parameters: neighbours in the chain are nearly independent, half is cautious.
        error = np.hypot(got[..., j].std() / np.sqrt(ess), kept[:, j].std() / np.sqrt(len(kept) / 2))
        assert abs(got[..., j].mean() - kept[:, j].mean()) <= Z * error
    assert signed.verdict.ok or "effective sample size" in str(signed.verdict)


@pytest.mark.slow
def test_patterns_are_summed_beside_bounds(data):
    """P(γ | y) under a signed slab: weights of the draws without it, times P(sign | y, γ, η)/P(sign)."""
    prior = bg.SpikeAndSlab()
    free = model_of({}, prior=prior).fit(data, seed=2, **RUN | {"draws": 2000})
    drawn, gamma = theta(free).reshape(-1, 3), free.drawn()["ydot_gamma"].to_numpy().reshape(-1, 3)
    # A slab restricted to half of its values is twice as high there.
    weight = np.where(gamma[:, 1] == 1, 2.0 * (drawn[:, 1] <= 0), 1.0)
    expected = np.average(gamma[:, 1], weights=weight)
    fit = model_of({"ydot": Coefficient(sign=-1)}, prior=prior).fit(data, seed=1, **RUN | {"draws": 1000})
    got = fit.inclusion().loc[("ydot", "ydot"), "inclusion"]
    # A quarter of the draws, at least, are as good as independent ones.
    spread = np.sqrt(expected * (1 - expected))
    assert abs(got - expected) <= Z * spread * np.hypot(1 / np.sqrt(500), 1 / np.sqrt(1000))
    assert np.all(theta(fit)[..., 1] <= 0)
    sampled = fit.drawn()["ydot_gamma"].to_numpy()
    assert np.array_equal(sampled == 0, theta(fit) == 0)


def of_every_kind():
    """Under a spike-and-slab prior one coefficient of each kind that can be stated."""
    stated = {
        "y": Coefficient(mean=-0.2, sd=0.1),
        "ydot": Coefficient(sign=-1, lower=-3.0),
        "ydot**3": Coefficient(lower=-0.5, upper=-0.3),
        "y**3": Coefficient(fixed=-1.0),
    }
    return model_of(stated, ["y", "ydot", "ydot**3", "y**3"], prior=bg.SpikeAndSlab())


@pytest.fixture(scope="module")
def every_kind(data):
    return of_every_kind().fit(data, seed=1, **RUN | {"draws": 60, "tune": 100})


@pytest.mark.slow
def test_a_bound_that_leaves_zero_out_keeps_the_term_in(every_kind):
    drawn = theta(every_kind)[..., 2]
    assert np.all((drawn >= -0.5) & (drawn <= -0.3))
    assert every_kind.inclusion().loc[("ydot", "ydot**3"), "inclusion"] == 1.0


@pytest.mark.slow
def test_a_prior_of_its_own_keeps_the_term_in(every_kind):
    assert np.all(every_kind.inclusion().loc[("ydot", "y"), "inclusion"] == 1.0)
    assert np.all(np.isfinite(every_kind.sensitivity()[["prior", "likelihood"]].dropna()))


@pytest.mark.parametrize("which", ["informed", "signed"])
def test_leave_one_out_is_that_of_the_dense_normal(which, request):
    """Given η and the bounded coefficients y is normal: log p(y_i | y₋ᵢ) of its dense covariance."""
    fit = request.getfixturevalue(which)
    entry = fit.equations["ydot"]
    Phi, _, y = entry.parts()
    held = [0, 1] if which == "signed" else []
    draws, log_p = fit.draws("ydot", 7), pointwise_loo(fit, "ydot", 7)
    mean = np.array([-0.2, 0.3, -1.0]) / entry.frame.coefficient_scale if which == "informed" else np.zeros(3)
    for s in range(7):
        sd, centre = draws.prior_sd[s].copy(), mean.copy()
        sd[held], centre[held] = 0.0, draws.theta[s, held]
        C = Phi @ np.diag(sd**2) @ Phi.T + float(draws.hyper.sigma[s]) ** 2 * np.eye(len(y))
        for i in (0, 17, 59):
            rest = np.delete(np.arange(len(y)), i)
            gain = C[i, rest] @ np.linalg.inv(C[np.ix_(rest, rest)])
            e = y - Phi @ centre
            expected = norm.logpdf(e[i], gain @ e[rest], np.sqrt(C[i, i] - gain @ C[rest, i]))
            assert log_p[s, i] + np.log(entry.frame.target_scale) == pytest.approx(expected, abs=1e-7)


def test_patterns_of_the_other_terms_are_summed_in_folds(data):
    """log p(y_F | y₋F, η) under a spike-and-slab prior beside a normal one: every pattern by its dense normal."""
    rng, model = np.random.default_rng(0), model_of({"ydot": Coefficient(mean=-0.2, sd=0.1)}, prior=bg.SpikeAndSlab())
    own = {"pi": rng.uniform(0.1, 0.9, (1, 5)), "tau": np.exp(0.3 * rng.standard_normal((1, 5)))}
    fit = fabricate(model, data, chains=1, draws=5, gamma=np.ones((1, 5, 3)), **own)
    entry, draws, summed = fit.equations["ydot"], fit.draws("ydot", 5), fit.summed("ydot", 5)
    Phi, _, y = entry.parts()
    scale, folds = entry.frame.coefficient_scale, [np.arange(0, 3), np.arange(20, 23)]
    parameters = fold_parameters(fit, "ydot", 5)
    values = np.hstack(list(fold_densities(fit, "ydot", parameters, folds)))
    e, odds = y - Phi[:, 1] * (-0.2 / scale[1]), np.asarray(summed.log_odds)
    for s in range(5):

        def density(rows, s=s):
            terms = []
            for a, b in product([0.0, 1.0], repeat=2):
                sd = np.asarray(summed.sd[s]) * [a, 1.0, b]
                C = (Phi[rows] * sd**2) @ Phi[rows].T + float(draws.hyper.sigma[s]) ** 2 * np.eye(len(rows))
                weight = -sum(np.logaddexp(0.0, -o if g else o) for g, o in zip((a, b), odds[s, [0, 2]], strict=True))
                terms.append(weight + multivariate_normal(cov=C).logpdf(e[rows]))
            return logsumexp(terms)

        for f, fold in enumerate(folds):
            expected = density(np.arange(60)) - density(np.delete(np.arange(60), fold))
            assert values[s, f] == pytest.approx(expected - 3 * np.log(entry.frame.target_scale), abs=1e-7)


def test_all_of_criticism_takes_them(signed, informed):
    table = bg.compare({"signed": signed, "informed": informed}, scheme="loo")
    assert np.all(np.isfinite(table["elpd"]))
    for scheme in ("block", "future"):
        score = bg.compare({"signed": signed, "informed": informed}, scheme=scheme, max_refits=0)
        assert np.all(np.isfinite(score["elpd"]))
    for fit in (signed, informed):
        checked = fit.checks()
        assert len(checked.sensitivity) and np.all(np.isfinite(checked.loo_pit["ydot"].value))
        assert np.isfinite(fit.predict(fit.data).nmse()["ydot"])
        prior = fit.idata["prior"]["ydot_theta"].to_numpy()
        assert prior.shape[-1] == 3
    prior = signed.idata["prior"]["ydot_theta"].to_numpy()
    assert np.all(prior[..., 0] >= 0) and np.all(prior[..., 1] <= 0)


def test_a_file_holds_them(tmp_path, data):
    model, rng = of_every_kind(), np.random.default_rng(0)
    drawn = [rng.normal(-0.2, 0.1, (2, 10)), rng.uniform(-1, 0, (2, 10)), rng.uniform(-0.5, -0.3, (2, 10))]
    scale = model.assemble(data)["ydot"].frame.coefficient_scale
    fit = drawn_by_hand(model, data, theta=np.stack(drawn, axis=-1) / scale, gamma=np.ones((2, 10, 3)))
    fit.save(tmp_path / "fit.nc")
    loaded = bg.load(tmp_path / "fit.nc")
    assert loaded.model.coefficients == fit.model.coefficients
    np.testing.assert_array_equal(theta(loaded), theta(fit))
    np.testing.assert_allclose(loaded.predict(data)["ydot"].rate.mean, fit.predict(data)["ydot"].rate.mean)
    np.testing.assert_allclose(pointwise_loo(loaded, "ydot", 20), pointwise_loo(fit, "ydot", 20))
    assert "y N(-0.2, 0.1²); ydot ≥ -3, ≤ 0; ydot**3 ≥ -0.5, ≤ -0.3; y**3 = -1" in repr(loaded)


@pytest.mark.slow
def test_the_exact_path_takes_them_too():
    """f at all rows integrated out by its dense covariance, given η and the bounded coefficient."""
    stated = {"y": Coefficient(mean=-0.2, sd=0.1), "ydot": Coefficient(upper=0.0)}
    data = bg.systems.oscillator().simulate(np.linspace(0, 8, 20), noise=0.2, seed=2)
    model = model_of(stated, discrepancy=bg.OrthogonalGP(path="exact"))
    fit = model.fit(data, seed=1, draws=10, tune=50, chains=1, progress=False)
    entry, draws = fit.equations["ydot"], fit.draws("ydot", 3)
    Phi, _, y = entry.parts()
    log_p = pointwise_loo(fit, "ydot", 3)
    assert np.all(draws.theta[:, 1] <= 0)
    for s in range(3):
        sd = np.where(np.arange(3) == 1, 0.0, draws.prior_sd[s])
        centre = np.array([-0.2 / entry.frame.coefficient_scale[0], draws.theta[s, 1], 0.0])
        hyper = jax.tree.map(lambda leaf: leaf[s], draws.hyper)  # noqa: B023
        C = Phi @ np.diag(sd**2) @ Phi.T + float(hyper.sigma) ** 2 * np.eye(len(y))
        P = np.linalg.inv(C + np.asarray(entry.design.covariance(hyper)))
        g = P @ (y - Phi @ centre)
        expected = 0.5 * (np.log(np.diag(P)) - np.log(2 * np.pi) - g**2 / np.diag(P)) - np.log(entry.frame.target_scale)
        np.testing.assert_allclose(log_p[s], expected, atol=1e-7)


@pytest.mark.slow
def test_rows_of_samples_take_them():
    """y'' = F − 2y − 0.15y' − 0.8y³: the spring is known and fixed, the damping nearly; the cube's sign is."""
    data = sampled(lambda y, v: -0.8 * y**3, n=80)
    simulation, run = {"y": "v", "v": "F"}, RUN | {"draws": 100, "tune": 150}

    def fit(simulation, terms, coefficients):
        model = bg.GreyBox(
            simulation=simulation,
            dictionary={"v": terms},
            prior=bg.Normal(),
            discrepancy=None,
            rows=bg.TrajectoryRows(),
            coefficients={"v": coefficients},
        )
        return model.fit(data, seed=1, **run)

    nearly, signed = Coefficient(mean=-0.15, sd=0.01), Coefficient(sign=-1)
    fixed = fit(simulation, ["y", "v", "y**3"], {"y": Coefficient(fixed=-2.0), "v": nearly, "y**3": signed})
    known = fit({"y": "v", "v": "F - 2*y"}, ["v", "y**3"], {"v": nearly, "y**3": signed})
    draws = fixed.idata["posterior"]["v_theta"].to_numpy()
    np.testing.assert_allclose(draws, known.idata["posterior"]["v_theta"].to_numpy(), rtol=1e-4)
    assert np.all(draws[..., 1] <= 0)
    for j, true in enumerate((-0.15, -0.8)):
        assert abs(draws[..., j].mean() - true) <= Z * draws[..., j].std()


@pytest.mark.slow
def test_bounded_patterns_are_calibrated(data):
    """Ranks of all that is drawn, and P(γ), over data sets drawn coefficient by coefficient from the prior."""
    stated = {
        "y": Coefficient(sign=-1),
        "ydot": Coefficient(mean=-0.2, sd=0.5, upper=0.1),
        "y**3": Coefficient(lower=-1.5, upper=1.0),
    }
    model = model_of(stated, prior=bg.SpikeAndSlab(), discrepancy=bg.OrthogonalGP(features=3))
    found = bg.calibrate(model, data, replicates=300, draws=150, tune=200, seed=1, progress=False)
    assert found.verdict.ok, str(found)
