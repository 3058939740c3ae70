"""Leave-one-out from one run against dense algebra, exact refits and ArviZ."""

import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from dense import dense
from fabricated import fabricate, oscillator
from scipy.special import betaln, logsumexp

from bayes_greybox.criticism.convergence import array_stats, convergence, convergence_table
from bayes_greybox.criticism.cross_validation import row_densities as pointwise
from bayes_greybox.criticism.cross_validation.cross_validate import cross_validate, refit_without
from bayes_greybox.criticism.cross_validation.row_densities import log_likelihood_group, pointwise_loo
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.sampling import sample_posterior
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.kernels import KERNELS, log_spectral_density
from bayes_greybox.model.likelihood import CollapsedNormal
from bayes_greybox.model.priors import Normal, Scales, SpikeAndSlab
from bayes_greybox.model.program import Program
from bayes_greybox.running.errors import InputError

TERMS = ["y", "v", "y**3"]
SIMULATION = {"v": "-0.2*v"}


def differentiated(method: str) -> Trajectories:
    """Two runs of a sampled velocity and its derivative by a linear filter: rows with correlated noise."""
    rng = np.random.default_rng(3)
    n = 48 if method == "savgol" else 32  # the filter takes rows away
    t = np.arange(n) * (2 * np.pi / n)
    runs = [np.sin(t + phase) + 0.5 * np.cos(2 * t) + 0.01 * rng.standard_normal(n) for phase in (0.0, 1.3)]
    data = Trajectories.from_arrays([t, t], states={"v": runs, "y": [np.cos(3 * t), np.sin(t) ** 2]})
    return data.differentiate(method, **({"window": 7, "polyorder": 3} if method == "savgol" else {}))


def draw(posterior, s):
    draws = posterior.draws("v")
    return jax.tree.map(lambda values: jnp.asarray(values[s]), (draws.hyper, draws.prior_sd))


@jax.jit
def log_density(design, hyper, sd):
    return CollapsedNormal(design, hyper, Scales(sd)).log_prob(design.y)


def left_out(C, y, i):
    """Log p(y_i | y₋ᵢ) of a Gaussian, by conditioning."""
    rest = np.delete(np.arange(len(y)), i)
    solved = np.linalg.solve(C[np.ix_(rest, rest)], np.column_stack([y[rest], C[rest, i]]))
    mean, variance = C[i, rest] @ solved[:, 0], C[i, i] - C[i, rest] @ solved[:, 1]
    return -0.5 * (np.log(2 * np.pi * variance) + (y[i] - mean) ** 2 / variance)


CASES = {
    "projected": (OrthogonalGP(features=5), "measured"),
    "conditioned": (OrthogonalGP(features=5, variant="conditioned", kernel="matern52"), "measured"),
    "exact": (OrthogonalGP(path="exact"), "measured"),
    "no discrepancy": (None, "measured"),
    "correlated rows": (OrthogonalGP(features=4), "savgol"),
    "correlated rows, exact": (OrthogonalGP(path="exact", kernel="matern32"), "savgol"),
    "spectral": (OrthogonalGP(features=4), "spectral"),
}


@pytest.fixture(scope="module", params=CASES)
def case(request):
    gp, kind = CASES[request.param]
    data = oscillator(25) if kind == "measured" else differentiated(kind)
    model = Program(dictionary={"v": TERMS}, discrepancy=gp, simulation=SIMULATION)
    prior_sd = np.exp(0.3 * np.random.default_rng(1).standard_normal((2, 2, 3)))
    prior_sd[0, 1, 1:] = 0.0  # a spike-and-slab pattern with two terms out
    prior_sd[1, 0] = 0.0
    return fabricate(model, data, draws=2, prior_sd=prior_sd)


def test_closed_form_is_the_dense_conditional(case):
    values = pointwise_loo(case, "v")
    scale = case.equations["v"].frame.target_scale
    for s in range(4):
        C, y = dense(case, *draw(case, s))
        expected = [left_out(C, y, i) - np.log(scale) for i in range(len(y))]
        # Densities far in the tails are thousands of nats, of which twelve digits are as good as the algebra gives.
        np.testing.assert_allclose(values[s], expected, rtol=1e-9, atol=1e-7)


def test_designs_without_rows_have_the_density_of_the_other_rows(case):
    # log p(y) − log p(y₋ᵢ) = log p(y_i | y₋ᵢ): with and without correlation, on both paths
    values = pointwise_loo(case, "v")
    scale = case.equations["v"].frame.target_scale
    whole = case.equations["v"].design
    for i in (0, 11):
        part = case.equations["v"].without([i])
        assert part.frame is case.equations["v"].frame
        for s in range(4):
            hyper, sd = draw(case, s)
            densities = [float(log_density(design, hyper, sd)) for design in (whole, part.design)]
            assert densities[0] - densities[1] == pytest.approx(values[s, i] + np.log(scale), abs=1e-6)


def test_leaving_out_several_rows(case):
    out = [3, 4, 9]
    part = case.equations["v"].without(out).design
    hyper, sd = draw(case, 0)
    C, y = dense(case, hyper, sd)
    kept = np.delete(np.arange(len(y)), out)
    C, y = C[np.ix_(kept, kept)], y[kept]
    expected = -0.5 * (np.linalg.slogdet(2 * np.pi * C)[1] + y @ np.linalg.solve(C, y))
    noise = case.data.noise.get("v")
    if noise is not None and not noise.square:
        expected -= 0.5 * noise.log_det  # density of the coefficients before whitening, of all of them
    got = float(log_density(part, hyper, sd))
    assert got == pytest.approx(expected, abs=1e-6)


def test_blocks_of_rows_and_thinning(monkeypatch):
    model = Program(dictionary={"v": TERMS}, discrepancy=OrthogonalGP(features=5))
    posterior = fabricate(model, oscillator(25), draws=10)
    whole = pointwise_loo(posterior, "v")
    monkeypatch.setattr(pointwise, "ROW_BLOCK", 7)
    np.testing.assert_allclose(pointwise_loo(posterior, "v"), whole, rtol=1e-12)
    np.testing.assert_allclose(pointwise_loo(posterior, "v", at_most=3), whole[[0, 10, 19]], rtol=1e-12)


def test_noise_free_data_keep_their_precision():
    # σ is 1e-5 of the amplitude, so C has a condition number of 1e12 and a Gram matrix would lose ten digits.
    rng = np.random.default_rng(0)
    y, v = rng.uniform(-1, 1, (2, 40))
    rate = -(y**3) - 0.3 * v + 1e-5 * rng.standard_normal(40)
    data = Trajectories.from_arrays(np.arange(40.0), states={"y": y, "v": v}, derivatives={"v": rate})
    model = Program(dictionary={"v": TERMS}, discrepancy=OrthogonalGP(features=5), noise_floor=1e-6)
    posterior = fabricate(model, data, draws=1, chains=1, sigma=np.full((1, 1), 1e-5))
    hyper, sd = draw(posterior, 0)
    frame = posterior.equations["v"].frame
    log_S = log_spectral_density(
        KERNELS["squared_exponential"], frame.basis.frequency, hyper.amplitude, hyper.length_scale
    )
    Phi, Psi = (np.asarray(part, np.longdouble) for part in frame.rows(data.columns))
    C = (Phi * np.asarray(sd) ** 2) @ Phi.T + (Psi * np.exp(np.asarray(log_S))) @ Psi.T
    inverse = _inverse(C + np.longdouble(hyper.sigma) ** 2 * np.eye(40))
    g = inverse @ (rate / frame.target_scale)
    expected = 0.5 * (np.log(np.diag(inverse)) - np.log(2 * np.pi) - g**2 / np.diag(inverse))
    got = pointwise_loo(posterior, "v")[0] + np.log(frame.target_scale)
    np.testing.assert_allclose(got, expected.astype(float), rtol=0, atol=1e-5)


def _inverse(A):
    """Gauss-Jordan elimination in extended precision, where the machine has one."""
    n = len(A)
    work = np.concatenate([A, np.eye(n, dtype=A.dtype)], axis=1)
    for k in range(n):
        pivot = k + int(np.argmax(np.abs(work[k:, k])))
        work[[k, pivot]] = work[[pivot, k]]
        work[k] /= work[k, k]
        others = np.delete(np.arange(n), k)
        work[others] -= np.outer(work[others, k], work[k])
    return work[:, n:]


def log_evidence(posterior, nodes, kept):
    """Log p(y_kept | η) summed over inclusion patterns, at log hyperparameters [n_node], by dense algebra."""
    frame, gp = posterior.equations["v"].frame, posterior.model.discrepancy
    Phi, Psi = (np.asarray(part)[kept] for part in frame.rows(posterior.data.columns))
    y = posterior.data.derivatives["v"][kept] / frame.target_scale
    noise, amplitude, length_scale, tau = np.exp(nodes).T
    density = lambda a, ell: log_spectral_density(KERNELS[gp.kernel], frame.basis.frequency, a, ell)  # noqa: E731
    S = np.exp(jax.vmap(density)(jnp.asarray(amplitude), jnp.asarray(length_scale)[:, None]))
    floor = float(posterior.equations["v"].design.noise_floor)
    sigma2 = noise**2 + floor**2
    # π ~ Beta(1, 1) integrated out: p(γ) = B(1 + k, 3 − k) for k of two terms
    patterns = [(p, betaln(1 + sum(p), 3 - sum(p))) for p in itertools.product((0, 1), repeat=2)]
    total = []
    for pattern, log_probability in patterns:
        # Of orthogonal rows the algebra is dense in as many as there are columns.
        Q, R = np.linalg.qr(np.hstack([Phi * pattern, Psi]))
        n, z, (R_phi, R_psi) = len(R), Q.T @ y, np.split(R, [2], axis=1)
        C = (R_psi * S[:, None]) @ R_psi.T + sigma2[:, None, None] * np.eye(n)
        C = C + tau[:, None, None] ** 2 * (R_phi @ R_phi.T)
        squares = np.linalg.solve(C, np.broadcast_to(z[:, None], (*C.shape[:2], 1)))[..., 0] @ z
        squares = squares + (y @ y - z @ z) / sigma2
        log_det = np.linalg.slogdet(C)[1] + (len(y) - n) * np.log(sigma2)
        total.append(log_probability - 0.5 * (log_det + squares + len(y) * np.log(2 * np.pi)))
    return logsumexp(total, axis=0)


def log_prior(nodes):
    """Log prior density of the log hyperparameters, up to a constant."""
    half_normal = lambda x: x - 0.5 * np.exp(2 * x)  # noqa: E731
    log_normal = lambda x: -0.5 * (x / 0.5) ** 2  # noqa: E731
    noise, amplitude, length_scale, tau = nodes.T
    return half_normal(noise) + half_normal(amplitude) + log_normal(length_scale) + log_normal(tau)


@pytest.mark.slow
def test_one_run_equals_thirty_exact_refits():
    """Every refit is exact: p(y_i | y₋ᵢ) = p(y)/p(y₋ᵢ), both integrated over η by a trapezoid rule.

    Its steps are one posterior standard deviation along the axes of the posterior, which for a Gaussian
    integrates to 10⁻⁸. What is left is the Monte Carlo error of the one run: of three of its standard errors, some
    0.12 nats, a right program goes beyond less than once in 300 seeds.
    """
    n = 30
    gp = OrthogonalGP(features=8, variables=("y",))
    model = Program(dictionary={"v": ["v", "v**3"]}, prior=SpikeAndSlab(), discrepancy=gp)
    posterior = sample_posterior(model, oscillator(n, seed=1), Sampling(2500, 300, 4, seed=0), progress=False)
    result = cross_validate(posterior, refit=None)

    frame, group = posterior.equations["v"].frame, posterior.idata["posterior"]
    hyper = posterior.draws("v").hyper
    noise = np.sqrt(hyper.sigma**2 - float(posterior.equations["v"].design.noise_floor) ** 2)
    sampled = np.column_stack([noise, hyper.amplitude, hyper.length_scale[:, 0], group["v_tau"].to_numpy().ravel()])
    centre, root = np.log(sampled).mean(axis=0), np.linalg.cholesky(np.cov(np.log(sampled).T))

    def integrals(shift, folds):
        steps = np.array(list(itertools.product(np.arange(-4, 5) + shift, repeat=4)))
        nodes = centre + steps @ root.T
        log_weight = log_prior(nodes) + log_evidence(posterior, nodes, np.arange(n))
        kept = log_weight > log_weight.max() - 14
        nodes, whole = nodes[kept], logsumexp(log_weight)
        prior = log_prior(nodes)
        return np.array(
            [whole - logsumexp(prior + log_evidence(posterior, nodes, np.delete(np.arange(n), i))) for i in folds]
        )

    exact = integrals(0.0, range(n))
    worst = int(np.argmin(exact))
    assert integrals(0.5, [worst])[0] == pytest.approx(exact[worst], abs=5e-3)
    exact -= np.log(frame.target_scale)
    # elpd ≈ −Σ log mean 1/p_i: the influence of a draw on it is −Σ (1/p_i over its mean), and hence its MCSE
    log_p = pointwise_loo(posterior, "v")
    influence = np.exp(-log_p - logsumexp(-log_p, axis=0) + np.log(len(log_p))).sum(axis=1).reshape(4, -1)
    mcse = float(array_stats().mcse(influence, method="mean"))
    assert abs(result.elpd - exact.sum()) < 3 * mcse < 0.15
    assert np.abs(result.pointwise - exact).max() < 0.05
    assert 0.01 < posterior.drawn()["v_gamma"].to_numpy()[..., 1].mean() < 0.99  # averaging over γ is part of it
    # The correction matters: the same densities averaged over p(η | y) would be off by p_eff.
    assert result.p_eff > 0.3


def test_arviz_finds_the_same_from_the_log_likelihood_group():
    import arviz_stats

    model = Program(dictionary={"v": TERMS}, discrepancy=OrthogonalGP(features=5))
    sigma = 0.15 * np.exp(0.05 * np.random.default_rng(0).standard_normal((4, 250)))
    narrow = {
        "sigma": sigma,
        "prior_sd": np.ones((4, 250, 3)),
        "length_scale": np.ones((4, 250, 2)),
        "amplitude": 0.5 * np.ones((4, 250)),
    }
    posterior = fabricate(model, oscillator(40), chains=4, draws=250, **narrow)
    group = log_likelihood_group(posterior)
    assert group is not None
    assert group["v_rate"].shape == (4, 250, 40)
    tree = posterior.idata.copy()
    tree["log_likelihood"] = xr.DataTree(
        xr.Dataset(
            {"v_rate": (("chain", "draw", "obs_id"), group["v_rate"])},
            coords={"chain": np.arange(4), "draw": np.arange(250)},
        )
    )
    result = cross_validate(posterior)
    theirs = arviz_stats.loo(tree, pointwise=True, reff=result.r_eff[0])
    np.testing.assert_allclose(result.pointwise, theirs.elpd_i.to_numpy(), rtol=1e-10)
    np.testing.assert_allclose(result.khat, theirs.pareto_k.to_numpy(), rtol=1e-8)
    # The sample variance, as in R's loo and arviz-stats 1; arviz-stats 0.8 divides by n instead of n - 1.
    np.testing.assert_allclose(result.se, theirs.se, rtol=np.sqrt(40 / 39) - 1 + 1e-8)
    np.testing.assert_allclose(result.p_eff, theirs.p, rtol=1e-6)


def test_large_groups_are_left_out(monkeypatch):
    model = Program(dictionary={"v": ["y"]}, discrepancy=None)
    monkeypatch.setattr(pointwise, "MOST_NUMBERS", 100)
    assert log_likelihood_group(fabricate(model, oscillator(30))) is None


def test_a_refit_of_one_equation_of_two_is_judged_by_itself():
    data = oscillator(20, seed=1)
    data = replace(data, derivatives={"y": 0.9 * data.states["v"] + 0.01 * data.states["y"], **data.derivatives})
    model = Program(dictionary={"y": ["v", "y"], "v": ["y", "v"]}, prior=Normal(), discrepancy=None)
    posterior = replace(fabricate(model, data), sampling=Sampling(30, 30, 2, seed=1))
    refit = refit_without(posterior, "v", [7])
    assert {name.split("_")[0] for name in convergence_table(refit).index} == {"v"}
    assert any("draws in all" in reason for reason in convergence(refit).reasons)


def test_flagged_rows_are_refitted_exactly_or_reported():
    data = oscillator(30, seed=1)
    rate = np.array(data.derivatives["v"])
    # An outlier that no draw of the run foresees: Pareto k is far above the threshold, whatever the seed.
    rate[7] += 4.0
    data = Trajectories.from_arrays(data.time, states=dict(data.states), derivatives={"v": rate})
    model = Program(dictionary={"v": ["y", "v"]}, prior=Normal(), discrepancy=OrthogonalGP(features=3))
    posterior = sample_posterior(model, data, Sampling(100, 300, 2, seed=1), progress=False)
    refits = []

    def refit(posterior, equation, rows):
        refits.append((equation, rows, refit_without(posterior, equation, rows)))
        return refits[-1][2]

    result = cross_validate(posterior, refit=refit)
    ((equation, rows, without),) = refits
    assert (equation, rows) == ("v", [7])
    assert result.refits == 1 and result.refitted[7] and result.khat[7] > result.threshold
    assert result.worst_k < result.threshold and result.n_bad == 0
    assert "1 of 30" in result.notes[0]
    # Without the outlier the noise is smaller, and what is reported is the mean density over that run.
    sigma = "v_sigma"
    assert without.idata["posterior"][sigma].mean() < 0.5 * posterior.idata["posterior"][sigma].mean()
    log_p = np.array([left_out(*dense(posterior, *draw(without, s)), 7) for s in range(200)])
    scale = posterior.equations["v"].frame.target_scale
    # Some -2000 nat under a small noise: a bound in nats would be one on how a kernel rounds (5e-9 under one of them).
    assert result.pointwise[7] == pytest.approx(logsumexp(log_p) - np.log(200 * scale), rel=1e-9)

    def never(*_):
        raise AssertionError("no refit was to be made")

    capped = cross_validate(posterior, refit=never, max_refits=0)
    assert capped.refits == 0 and capped.n_bad == 1 and capped.worst_k > capped.threshold
    assert "not refitted" in capped.notes[0] and "max_refits=0" in capped.notes[0]
    np.testing.assert_array_equal(np.delete(capped.pointwise, 7), np.delete(result.pointwise, 7))

    # Another refit compiles nothing.
    heard = []
    jax.monitoring.register_event_duration_secs_listener(lambda name, seconds, **_: heard.append(name))
    jax.jit(lambda x: x + 1)(0)
    compiled = [event for event in heard if "compile" in event]
    assert compiled
    refit_without(posterior, "v", [8])
    assert [event for event in heard if "compile" in event] == compiled


def test_too_few_draws_are_refused():
    model = Program(dictionary={"v": ["y"]}, discrepancy=None)
    with pytest.raises(InputError, match="at least 25 posterior draws, not 6"):
        cross_validate(fabricate(model, oscillator(30)))
