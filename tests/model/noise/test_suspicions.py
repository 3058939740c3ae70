"""What residuals say of their noise: evidence against dense matrices and quadrature, and the right names."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, t

from bayes_greybox.data.noise.state_space import StateSpaceNoise
from bayes_greybox.data.noise.weighted import WeightedNoise, WhiteNoise
from bayes_greybox.model.gp.hyper import NoisePrior
from bayes_greybox.model.noise.in_time import PROCESS_WHITE_SHARES as SHARES
from bayes_greybox.model.noise.in_time import SHORTEST_TIME, TIME_SPREAD, TIME_STEPS, Stamps, in_time
from bayes_greybox.model.noise.noise_model import CORRELATED, HEAVY, PROCESS, VARYING, NoiseModel
from bayes_greybox.model.noise.suspicions import DEGREES, EXPONENTS, NOISE_LEVELS, heavy, suspicions

PRIOR = NoisePrior(1e-4, 1.0)
STEP = 0.1
LOG_S = np.linspace(np.log(1e-3), np.log(4.0), 801)


def path(n):
    return np.sin(2 * np.pi * np.arange(n) * STEP / 5.3)


def rough(rho, n, rng, size=0.3):
    e = rng.standard_normal(n)
    for i in range(1, n):
        e[i] = rho * e[i - 1] + np.sqrt(1 - rho**2) * e[i]
    return size * e


def weighed(e, time=None, run=None, quantities=None, known=None):
    run = np.zeros(len(e), int) if run is None else run
    time = np.arange(len(e)) * STEP if time is None else time
    known = known or NoiseModel(WhiteNoise(tuple(int(n) for n in np.bincount(run))))
    quantities = {"x": path(len(e))} if quantities is None else quantities
    return {s.name: s for s in suspicions(e, known, time, run, quantities, PRIOR)}


def log_factors(*args, **kwargs):
    return {name: s.log_bayes_factor for name, s in weighed(*args, **kwargs).items()}


def over_sigma(log_density):
    """Log of an integral over log σ by the trapezoidal rule; `log_density` takes σ."""
    values = np.array([log_density(PRIOR.sigma(u)) for u in LOG_S]) + PRIOR.log_density(LOG_S)
    return np.logaddexp.reduce(values) + np.log(LOG_S[1] - LOG_S[0])


def normal(e, R):
    square, log_det = e @ np.linalg.solve(R, e), np.linalg.slogdet(R)[1]
    return over_sigma(lambda s: -0.5 * (square / s**2 + len(e) * np.log(2 * np.pi * s**2) + log_det))


# Evidence


@pytest.mark.parametrize("name", [CORRELATED, PROCESS])
@pytest.mark.parametrize("several", [False, True])
def test_evidence_of_a_process_in_time_is_that_of_its_dense_matrices(name, several):
    rng = np.random.default_rng(0)
    n = 24
    run = np.repeat([0, 1], [14, 10]) if several else np.zeros(n, int)
    time = np.concatenate([np.cumsum(rng.uniform(0.05, 0.15, np.sum(run == r))) for r in np.unique(run)])
    e = rough(0.7, n, rng)
    step = np.median(np.diff(time)[np.diff(run) == 0])
    longest = max(np.log(max(np.bincount(run))), 1.8)
    taus = np.exp(np.arange(np.log(SHORTEST_TIME[name]), longest + 0.3, 0.55))
    weight = np.exp(-0.5 * ((np.log(taus) - np.log(TIME_STEPS)) / TIME_SPREAD) ** 2)
    weight /= weight.sum()
    process = "exponential" if name == CORRELATED else "matern32"
    stretches = tuple(time[run == r] for r in np.unique(run))
    logs = [
        np.log(p / len(SHARES[name])) + normal(e, StateSpaceNoise(stretches, process, tau * step, w).covariance())
        for tau, p in zip(taus, weight, strict=True)
        for w in SHARES[name]
    ]
    expected = np.logaddexp.reduce(logs)
    found = weighed(e, time, run)[name]
    assert found.log_bayes_factor == pytest.approx(expected - normal(e, np.eye(n)), abs=1e-4)
    # Held noise and constant say the same of these residuals.
    assert normal(e, found.model.noise.covariance()) + found.model.constant == pytest.approx(expected, abs=1e-4)
    assert found.model.constant < 0


def test_evidence_of_noise_that_depends_on_the_state():
    n, rng = 30, np.random.default_rng(1)
    x = path(n)
    e = 0.3 * (np.abs(x) + 0.05) * rng.standard_normal(n)
    logs = []
    for level in NOISE_LEVELS:
        z = 0.5 * np.log(level**2 + x**2 / np.mean(x**2))
        logs += [normal(e, np.diag(np.exp(2 * a * (z - z.mean())))) for a in EXPONENTS]
    found = weighed(e)[VARYING]
    expected = np.logaddexp.reduce(logs) - np.log(len(logs))
    assert found.log_bayes_factor == pytest.approx(expected - normal(e, np.eye(n)), abs=1e-4)
    assert found.model.constant + normal(e, found.model.noise.covariance()) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("correlated", [False, True])
def test_evidence_of_heavy_tails(correlated):
    n, rng = 30, np.random.default_rng(2)
    e = 0.1 * rng.standard_t(2, n)
    inner = StateSpaceNoise((np.arange(n) * STEP,), "exponential", 0.2, 0.1) if correlated else WhiteNoise((n,))
    known = NoiseModel(inner)
    white = inner.whiten(e[:, None])[:, 0]
    logs = [over_sigma(lambda s, nu=nu: np.sum(t.logpdf(white / s, nu) - np.log(s))) for nu in DEGREES]
    expected = np.logaddexp.reduce(logs) - np.log(len(DEGREES)) - 0.5 * inner.log_det
    found = heavy(e, known, PRIOR)
    assert found is not None
    # The grid of the scale reaches from 0.4 to 1.8 of its robust estimate.
    assert found.log_bayes_factor == pytest.approx(expected - normal(e, inner.covariance()), abs=0.05)
    assert found.model.constant + normal(e, found.model.noise.covariance()) == pytest.approx(expected, abs=0.05)


def test_a_known_time_scale_is_kept():
    e = rough(0.9, 300, np.random.default_rng(3))
    known, time, run = NoiseModel(WhiteNoise((300,))), np.arange(300) * STEP, np.zeros(300, int)
    found = in_time(e, known, Stamps(time, run), PRIOR, CORRELATED, time_scale=0.5)
    assert found is not None
    assert found.model.about[CORRELATED]["time_scale"] == pytest.approx(0.5)


# Names


@pytest.mark.parametrize("seed", range(6))
def test_white_noise_calls_nothing(seed):
    factors = log_factors(0.3 * np.random.default_rng(seed).standard_normal(500))
    assert set(factors) == {CORRELATED, PROCESS, VARYING, HEAVY}
    assert max(factors.values()) < 0


@pytest.mark.parametrize("rho", [0.5, 0.9, 0.97])
@pytest.mark.parametrize("seed", range(3))
def test_rough_noise_is_correlated_and_no_process(rho, seed):
    found = weighed(rough(rho, 500, np.random.default_rng(seed)))
    factors = {name: s.log_bayes_factor for name, s in found.items()}
    assert max(factors, key=factors.__getitem__) == CORRELATED
    assert factors[CORRELATED] > 10 and factors[CORRELATED] > factors[PROCESS] + 2
    assert found[CORRELATED].model.about[CORRELATED]["correlation"] == pytest.approx(rho, abs=0.12)
    assert PROCESS not in found[CORRELATED].model.about


@pytest.mark.parametrize("seed", range(4))
def test_a_smooth_rest_beside_white_noise_is_a_process(seed):
    n, rng = 400, np.random.default_rng(seed)
    time = np.arange(n) * STEP
    smooth = StateSpaceNoise((time,), "matern32", 1.5, 0.0).correlated(rng.standard_normal((1, n)))[0]
    found = weighed(0.1 * smooth + 0.01 * rng.standard_normal(n))
    assert found[PROCESS].log_bayes_factor > max(100, found[CORRELATED].log_bayes_factor + 2)
    assert found[PROCESS].model.about[PROCESS]["share"] > 0.5


@pytest.mark.parametrize("seed", range(3))
def test_noise_that_grows_and_outliers_are_told_apart(seed):
    n, rng = 400, np.random.default_rng(seed)
    x = path(n)
    grows = weighed(0.3 * (np.abs(x) + 0.02) * rng.standard_normal(n), quantities={"x": x, "u": np.cos(7 * x)})
    factors = {name: s.log_bayes_factor for name, s in grows.items()}
    assert max(factors, key=factors.__getitem__) == VARYING and factors[VARYING] > 50
    about = grows[VARYING].model.about[VARYING]
    assert about["variable"] == "x" and 0.75 <= about["exponent"] <= 1.25
    gross = 0.1 * rng.standard_normal(n)
    gross[rng.choice(n, 8, replace=False)] *= 15
    for e in (0.1 * rng.standard_t(2, n), gross):
        found = weighed(e)
        factors = {name: s.log_bayes_factor for name, s in found.items()}
        assert max(factors, key=factors.__getitem__) == HEAVY and factors[HEAVY] > 30
        assert found[HEAVY].model.about[HEAVY]["degrees"] <= 6
        # Once outliers are weighted, nothing else is left to call.
        again = log_factors(e, known=found[HEAVY].model)
        assert set(again) == {CORRELATED, PROCESS, VARYING} and max(again.values()) < 3


def test_the_whole_of_a_long_record_speaks():
    n, rng = 6000, np.random.default_rng(0)
    e = 0.3 * rng.standard_normal(n)
    assert log_factors(e)[CORRELATED] < 0
    e[4500:] = rough(0.9, 1500, rng)
    assert log_factors(e)[CORRELATED] > 100


def test_runs_are_independent_of_each_other():
    rng = np.random.default_rng(0)
    e = [rough(0.9, n, rng) for n in (200, 150, 3, 1)]
    run = np.repeat([0, 1, 2, 3], [len(part) for part in e])
    time = np.concatenate([np.arange(len(part)) * STEP for part in e])
    found = weighed(np.concatenate(e), time, run)
    assert found[CORRELATED].log_bayes_factor > 50
    assert found[CORRELATED].model.noise.run_lengths == (200, 150, 3, 1)


def test_few_rows_and_rows_that_stand_alone_say_nothing_of_time():
    rng = np.random.default_rng(0)
    assert log_factors(rng.standard_normal(19)) == {}
    n = 40
    alone = log_factors(rng.standard_normal(n), np.zeros(n), np.arange(n))
    assert set(alone) == {VARYING, HEAVY}
    assert set(log_factors(rng.standard_normal(n), quantities={"x": np.zeros(n)})) == {CORRELATED, PROCESS, HEAVY}


def test_suspects_join():
    n, rng = 500, np.random.default_rng(0)
    x = path(n)
    e = (np.abs(x) + 0.05) * rough(0.9, n, rng)
    first = weighed(e)[VARYING].model
    both = weighed(e, known=first)[CORRELATED]
    assert both.log_bayes_factor > 50 and both.model.names == (VARYING, CORRELATED)
    assert isinstance(both.model.noise, WeightedNoise) and isinstance(both.model.noise.inner, StateSpaceNoise)
    three = weighed(e, known=both.model)
    assert set(three) == {HEAVY} and three[HEAVY].log_bayes_factor < 3
    expected = multivariate_normal(cov=0.01 * both.model.noise.covariance()).logpdf(e)  # pyright: ignore[reportArgumentType]
    white = both.model.noise.whiten(e[:, None])[:, 0]
    found = -0.5 * (white @ white / 0.01 + n * np.log(2 * np.pi * 0.01) + both.model.noise.log_det)
    assert found == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("share", [0.01, 0.3])
def test_residuals_below_the_floor_say_nothing_of_their_noise(share):
    assert weighed(share * PRIOR.floor * np.random.default_rng(0).standard_normal(300)) == {}


def test_many_rows_are_weighed_with_a_grid_that_is_fine_enough():
    n, rng = 40_000, np.random.default_rng(0)
    e = 0.1 * rng.standard_t(5, n)
    found = heavy(e, NoiseModel(WhiteNoise((n,))), PRIOR)
    # ∫ p(e | ν, s) p(s) d log s by a fine grid, mean over the degrees.
    # Its standard deviation is some 0.0035.
    log_s = np.log(0.1) + np.linspace(-0.025, 0.025, 51)
    logs = []
    for nu in DEGREES:
        centre = log_s + np.log(t.fit(e, f0=nu, floc=0.0)[2] / 0.1)
        density = [t.logpdf(e, nu, scale=s).sum() for s in np.exp(centre)] + PRIOR.log_density(centre)
        logs.append(np.logaddexp.reduce(density) + np.log(log_s[1] - log_s[0]))
    white = found.log_bayes_factor - np.logaddexp.reduce(logs) + np.log(len(DEGREES))
    sigma = np.std(e) * np.exp(np.linspace(-0.05, 0.05, 401))
    normal = -0.5 * np.sum(e**2) / sigma**2 - n * np.log(sigma * np.sqrt(2 * np.pi)) + PRIOR.log_density(np.log(sigma))
    assert -white == pytest.approx(np.logaddexp.reduce(normal) + np.log(0.1 / 400), abs=0.05)
