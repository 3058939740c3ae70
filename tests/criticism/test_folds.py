"""Blocks, trajectories and the future from one run, against dense algebra."""

import itertools
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense import dense
from fabricated import fabricate
from numpyro.handlers import seed, trace
from scipy.special import logsumexp

from bayes_greybox.criticism.cross_validation import fold_densities as fold_density
from bayes_greybox.criticism.cross_validation.cross_validate import cross_validate
from bayes_greybox.criticism.cross_validation.fold_densities import (
    fold_densities,
    fold_parameters,
    past_densities,
    subset_density,
)
from bayes_greybox.criticism.cross_validation.folds import correlation_length, make_folds
from bayes_greybox.criticism.cross_validation.row_densities import pointwise_loo
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.design import FeatureDesign
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.priors import RegularisedHorseshoe
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows
from bayes_greybox.running.errors import InputError

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
    n = 33 if method == "savgol" else 16
    t = np.arange(n) * (2 * np.pi / n)
    runs = [np.sin(t + phase) + 0.5 * np.cos(2 * t) + 0.01 * rng.standard_normal(n) for phase in (0.0, 1.3)]
    data = Trajectories.from_arrays([t, t], states={"v": runs, "y": [np.cos(3 * t), np.sin(t) ** 2]})
    return data.differentiate(method, **({"window": 7, "polyorder": 3} if method == "savgol" else {}))


def draw(posterior, s):
    draws = posterior.draws("v")
    return jax.tree.map(lambda values: jnp.asarray(values[s]), (draws.hyper, draws.prior_sd))


def conditional(C, y, fold, given):
    """Log p(y_fold | y_given) of a Gaussian, by conditioning."""
    gain = np.linalg.solve(C[np.ix_(given, given)], np.column_stack([y[given], C[np.ix_(given, fold)]]))
    mean, covariance = C[np.ix_(fold, given)] @ gain[:, 0], C[np.ix_(fold, fold)] - C[np.ix_(fold, given)] @ gain[:, 1:]
    error = y[fold] - mean
    return -0.5 * (np.linalg.slogdet(2 * np.pi * covariance)[1] + error @ np.linalg.solve(covariance, error))


CASES = {
    "projected": (OrthogonalGP(features=5), "measured"),
    "conditioned": (OrthogonalGP(features=5, variant="conditioned", kernel="matern52"), "measured"),
    "exact": (OrthogonalGP(path="exact"), "measured"),
    "no discrepancy": (None, "measured"),
    "correlated rows": (OrthogonalGP(features=4), "savgol"),
    "correlated rows, exact": (OrthogonalGP(path="exact", kernel="matern32"), "savgol"),
    "spectral, exact": (OrthogonalGP(path="exact"), "spectral"),
}


SUMMED = ("conditioned", "exact", "correlated rows", "spectral, exact")


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
    return np.concatenate(list(fold_densities(posterior, "v", fold_parameters(posterior, "v"), folds)), axis=1)


def expected_of(posterior, s, folds, givens):
    C, y = dense(posterior, *draw(posterior, s))
    scale = posterior.equations["v"].frame.target_scale
    return [
        conditional(C, y, fold, given) - len(fold) * np.log(scale) for fold, given in zip(folds, givens, strict=True)
    ]


def test_left_out_folds_have_the_dense_conditional(case, monkeypatch):
    monkeypatch.setattr(fold_density, "ROW_BLOCK", 9)
    routes = [True] if case.model.discrepancy is not None and case.model.discrepancy.path == "exact" else [True, False]
    for scheme, block in (("block", 4), ("trajectory", None)):
        if scheme == "block" and singular(case):
            with pytest.raises(InputError, match="belong to no time"):
                make_folds(case, scheme, 4)
            continue
        folds = make_folds(case, scheme, block).members["v"]
        n = sum(len(fold) for fold in folds)
        assert np.array_equal(np.concatenate(folds), np.arange(n))
        assert scheme == "trajectory" or {len(fold) for fold in folds} <= {3, 4}
        expected = [expected_of(case, s, folds, [np.setdiff1d(np.arange(n), fold) for fold in folds]) for s in range(4)]
        for by_precision in routes:
            monkeypatch.setattr(FeatureDesign, "removes", lambda *_, route=by_precision: not route)
            # Densities far in the tails are thousands of nats, of which twelve digits are as good as the algebra gives.
            np.testing.assert_allclose(values_of(case, folds), expected, rtol=1e-10, atol=1e-8)


def test_steps_into_the_future_have_the_dense_conditional(case):
    if singular(case):
        with pytest.raises(InputError, match="belong to no time"):
            make_folds(case, "future", 3)
        return
    chosen = make_folds(case, "future", 3, start=0.05)
    folds, past = chosen.members["v"], chosen.past["v"]
    time = case.equations["v"].rows.time
    pasts = [np.flatnonzero(time < time[fold].min()) for fold in folds]
    assert np.array_equal(pasts[0], past)
    assert np.array_equal(np.sort(np.concatenate([past, *folds])), np.arange(len(time)))
    assert all(len(np.unique(time[fold])) <= 3 for fold in folds)
    values = np.diff(past_densities(case, "v", fold_parameters(case, "v"), past, folds), axis=1)
    for s in range(4):
        np.testing.assert_allclose(values[s], expected_of(case, s, folds, pasts), rtol=1e-10, atol=1e-8)


@pytest.mark.parametrize("case", SUMMED, indirect=True)
def test_patterns_that_were_summed_are_summed_with_and_without_the_fold(case, monkeypatch):
    rng = np.random.default_rng(2)
    pi, tau = rng.uniform(0.1, 0.9, (2, 2)), np.exp(0.3 * rng.standard_normal((2, 2)))
    gamma = np.ones((2, 2, len(TERMS)))
    posterior = fabricate(case.model, case.data, draws=2, pi=pi, tau=tau, gamma=gamma)
    hyper = [draw(posterior, s)[0] for s in range(4)]
    unit = np.log(posterior.equations["v"].frame.target_scale)

    @cache
    def whole(s, gamma):
        return dense(posterior, hyper[s], np.array(gamma) * tau.ravel()[s])

    def evidence(s, rows):
        """Log Σ_γ p(γ) p(y_rows | γ, η), by dense algebra."""
        if not len(rows):
            return 0.0
        parts = []
        for gamma in itertools.product((0.0, 1.0), repeat=len(TERMS)):
            C, y = whole(s, gamma)
            C, y = C[np.ix_(rows, rows)], y[rows]
            p = pi.ravel()[s]
            prior = sum(gamma) * np.log(p) + (len(TERMS) - sum(gamma)) * np.log(1 - p)
            parts.append(prior - 0.5 * (np.linalg.slogdet(2 * np.pi * C)[1] + y @ np.linalg.solve(C, y)))
        return logsumexp(parts)

    def conditionals(folds, givens):
        return [
            [
                evidence(s, np.sort(np.concatenate([given, fold]))) - evidence(s, given) - len(fold) * unit
                for fold, given in zip(folds, givens, strict=True)
            ]
            for s in range(4)
        ]

    exact = case.model.discrepancy is not None and case.model.discrepancy.path == "exact"
    folds = make_folds(posterior, "trajectory").members["v"]
    n = sum(len(fold) for fold in folds)
    expected = conditionals(folds, [np.setdiff1d(np.arange(n), fold) for fold in folds])
    for by_precision in [True] if exact else [True, False]:
        monkeypatch.setattr(FeatureDesign, "removes", lambda *_, route=by_precision: not route)
        np.testing.assert_allclose(values_of(posterior, folds), expected, rtol=1e-9, atol=1e-7)
    if singular(case):
        return
    chosen = make_folds(posterior, "future", 3, start=0.05)
    folds, past = chosen.members["v"], chosen.past["v"]
    pasts = [np.sort(np.concatenate([past, *folds[:j]])) for j in range(len(folds))]
    values = np.diff(past_densities(posterior, "v", fold_parameters(posterior, "v"), past, folds), axis=1)
    np.testing.assert_allclose(values, conditionals(folds, pasts), rtol=1e-9, atol=1e-7)


@pytest.mark.parametrize("name", ["conditioned", "correlated rows", "correlated rows, exact"])
def test_blocks_of_one_row_are_single_rows(name):
    gp, kind = CASES[name]
    model = Program(dictionary={"v": TERMS}, discrepancy=gp, simulation=SIMULATION)
    posterior = fabricate(model, measured() if kind == "measured" else differentiated(kind))
    folds = make_folds(posterior, "block", 1).members["v"]
    np.testing.assert_allclose(values_of(posterior, folds), pointwise_loo(posterior, "v"), rtol=1e-10, atol=1e-8)


def test_designs_for_refits_have_the_density_of_what_is_left(case):
    """Also where a few rows only, the start of each run, are left."""
    schemes = ("trajectory",) if singular(case) else ("trajectory", "future")
    for scheme in schemes:
        folds = make_folds(case, scheme, 3 if scheme == "future" else None).members["v"]
        out = folds[0] if scheme == "trajectory" else np.sort(np.concatenate(folds))
        part = case.equations["v"].without(out).design
        C, y = dense(case, *draw(case, 0))
        kept = np.setdiff1d(np.arange(len(y)), out)
        C, y = C[np.ix_(kept, kept)], y[kept]
        expected = -0.5 * (np.linalg.slogdet(2 * np.pi * C)[1] + y @ np.linalg.solve(C, y))
        if singular(case):
            expected -= 0.5 * case.data.noise["v"].log_det  # the constant of the coefficients before whitening
        values = subset_density(part, fold_parameters(case, "v"))
        assert values[0] == pytest.approx(expected, abs=1e-7)
        # A prior that asks for the number of rows, as the horseshoe does, must not change when rows are left out.
        assert float(part.n_prior) == float(case.equations["v"].design.n_obs) > float(part.n_obs)


def test_the_horseshoe_is_told_the_number_of_rows_of_the_whole_data():
    model = Program(dictionary={"v": TERMS}, prior=RegularisedHorseshoe(), discrepancy=None)
    posterior = fabricate(model, measured())
    part = {"v": posterior.equations["v"].without(range(20)).design}
    tau = [
        trace(seed(model.numpyro_model, 0)).get_trace(designs)["v_tau"]["value"]
        for designs in (part, {"v": posterior.equations["v"].design})
    ]
    assert float(tau[0]) == pytest.approx(float(tau[1]), rel=1e-12)


def smoothed(weights, n=2000):
    """One run whose rate is a moving average of white noise, which no term explains."""
    rng = np.random.default_rng(1)
    states = dict(zip("yv", rng.uniform(-1, 1, (2, n)), strict=True))
    rate = np.convolve(rng.standard_normal(n + len(weights) - 1), weights, mode="valid")
    model = Program(dictionary={"v": ["y"]}, discrepancy=None)
    data = Trajectories.from_arrays(np.arange(n) * 0.1, states=states, derivatives={"v": rate})
    return fabricate(model, data, draws=2, theta=np.zeros((2, 2, 1)))


def wave(n=400, period=40, noise=0.0):
    """One run whose rate is a wave along the rows, which no term explains."""
    rng = np.random.default_rng(0)
    rate = np.cos(2 * np.pi * np.arange(n) / period) + noise * rng.standard_normal(n)
    states = dict(zip("yv", rng.uniform(-1, 1, (2, n)), strict=True))
    model = Program(dictionary={"v": ["y"]}, discrepancy=None)
    data = Trajectories.from_arrays(np.arange(n) * 0.1, states=states, derivatives={"v": rate})
    return fabricate(model, data, draws=20, theta=np.zeros((2, 20, 1)))


@pytest.fixture(scope="module")
def two_sensors():
    """Samples of position and speed in three runs, of which the start of each is in the rows of both."""
    rng, times, columns = np.random.default_rng(2), [], {"y": [], "v": []}
    for n, start in ((9, 1.0), (12, -0.6), (7, 0.4)):
        t = 0.4 * np.arange(n)
        angle = np.exp(-0.1 * t) * np.exp(1j * np.sqrt(0.99) * t) * start
        # d²y/dt² = −y − 0.2 dy/dt
        for name, path in (("y", angle), ("v", (-0.1 + 1j * np.sqrt(0.99)) * angle)):
            columns[name].append(path.real + 0.05 * rng.standard_normal(n))
        times.append(t)
    data = Trajectories.from_arrays(times, states=columns)
    model = Program({"v": ["y", "v"]}, simulation={"y": "v"}, rows=TrajectoryRows(), discrepancy=None)
    return fabricate(model, data)


@pytest.mark.parametrize("scheme", ["trajectory", "block"])
def test_what_is_left_out_is_left_out_of_every_sensor(two_sensors, scheme, monkeypatch):
    entry, chosen = two_sensors.equations["v"], make_folds(two_sensors, scheme, 4 if scheme == "block" else None)
    folds, sample = chosen.members["v"], entry.rows.operator.sample
    assert np.array_equal(np.sort(np.concatenate(folds)), np.arange(entry.rows.n_row))
    for fold in folds:
        # Both sensors' rows of the same samples, which no other fold has, and of one run.
        assert np.array_equal(sample[fold[: len(fold) // 2]], sample[fold[len(fold) // 2 :]])
        assert len(set(two_sensors.data.run[sample[fold]])) == 1
    assert len(folds) == (3 if scheme == "trajectory" else 8)
    assert chosen.words == ("3 trajectories" if scheme == "trajectory" else "8 blocks of up to 4 rows of each sensor")
    Phi, _, y = (np.asarray(part) for part in entry.parts())
    draws, expected = two_sensors.draws("v"), []
    for s in range(6):
        C = (Phi * draws.prior_sd[s] ** 2) @ Phi.T + float(draws.hyper.sigma[s]) ** 2 * entry.rows.noise.covariance()
        rest = [np.setdiff1d(np.arange(len(y)), fold) for fold in folds]
        given = [conditional(C, y, fold, kept) for fold, kept in zip(folds, rest, strict=True)]
        # In the unit of the sensor.
        unit = np.log(entry.frame.target_scale * entry.rows.gain)
        expected.append([v - len(f) * unit for v, f in zip(given, folds, strict=True)])
    for by_precision in (True, False):
        monkeypatch.setattr(FeatureDesign, "removes", lambda *_, route=by_precision: not route)
        np.testing.assert_allclose(values_of(two_sensors, folds), expected, rtol=1e-7, atol=1e-7)


def test_blocks_are_as_long_as_the_residuals_are_correlated():
    # The autocorrelation of four neighbours' mean is 1 − k/4 up to lag 4.
    short = smoothed(np.full(4, 0.25))
    assert correlation_length(short, "v") == 4
    folds = make_folds(short, "block")
    assert folds.block == 4 and len(folds.members["v"]) == 500
    assert folds.notes == (
        "Blocks of 4 rows were chosen, because what the dictionary leaves of 'v' is uncorrelated 4 rows apart.",
    )
    # White noise ends at the first lag, in all but one of forty data sets (this seed is none).
    assert correlation_length(wave(noise=1e3), "v") == 1
    slow = make_folds(wave(period=4000), "block")
    assert slow.block == 40 and "a tenth of the rows" in slow.notes[0]
    future = make_folds(wave(), "future")
    assert (future.block, len(future.members["v"])) == (40, 5)
    assert len(future.past["v"]) == 200


def test_a_wave_is_correlated_beyond_its_quarter_period():
    """cos(2π k/40) is zero at lag 10 and −1 at lag 20: the rows half a period away say all about a row."""
    assert correlation_length(wave(), "v") == 40
    assert correlation_length(wave(noise=0.3), "v") == 40
    # A wave that dies out, e^{−k/30} cos(2π k/40), is correlated for some of its decay, not for a quarter period.
    k = np.arange(600)
    dying = smoothed(np.exp(-k / 30) * np.cos(2 * np.pi * k / 40), n=20_000)
    assert 60 <= correlation_length(dying, "v") <= 250


def test_residuals_of_a_long_record_do_not_look_correlated_by_chance():
    """Correlated residuals' autocorrelation scatters more than white noise's, by Bartlett's formula."""
    slow = smoothed(0.9 ** np.arange(300), n=20_000)
    # 0.9^k falls below 1.96/√20000 at lag 41.
    assert 25 <= correlation_length(slow, "v") <= 120


def test_several_runs_advance_together_on_one_clock_and_in_turn_on_several():
    one_clock = make_folds(fabricate(Program(dictionary={"v": ["y"]}, discrepancy=None), measured((4, 4))), "future", 1)
    assert [fold.tolist() for fold in one_clock.members["v"]] == [[2, 6], [3, 7]]
    data = measured((4, 4))
    columns = {name: np.split(values, 2) for name, values in data.columns.items()}
    rate = {"v": np.split(data.derivatives["v"], 2)}
    later = Trajectories.from_arrays([data.time[:4], data.time[:4] + 9], states=columns, derivatives=rate)
    in_turn = make_folds(fabricate(Program(dictionary={"v": ["y"]}, discrepancy=None), later), "future", 2)
    assert [fold.tolist() for fold in in_turn.members["v"]] == [[4, 5], [6, 7]]


def test_the_future_is_predicted_backwards_with_refits_to_the_past():
    model = Program(dictionary={"v": TERMS}, discrepancy=None)
    wild = 0.2 * np.exp(np.random.default_rng(0).standard_normal((2, 100)))
    posterior = fabricate(model, measured((25,)), draws=100, sigma=wild)
    folds = make_folds(posterior, "future", 3)
    members, past = folds.members["v"], folds.past["v"]
    refits = []

    def refit(posterior, equation, rows):
        refits.append((rows, fabricate(model, posterior.data, draws=100, sigma=wild * 1.1, seed=len(refits))))
        return refits[-1][1]

    result = cross_validate(posterior, "future", block=3, refit=refit, max_refits=2)
    assert result.refits == len(refits) == 2 and result.n_bad > 0
    assert "2 of 4 steps had" in result.notes[0] and "after max_refits=2 refits" in result.notes[1]
    steps = np.flatnonzero(result.refitted)[::-1]
    for j, (rows, without) in zip(steps, refits, strict=True):
        assert rows == sorted(np.concatenate(members[j:]).tolist())
        values = np.diff(past_densities(posterior, "v", fold_parameters(without, "v"), past, members), axis=1)[:, j]
        assert result.pointwise[j] == pytest.approx(logsumexp(values) - np.log(200), abs=1e-9)
    without = cross_validate(posterior, "future", block=3, refit=None)
    assert without.refits == 0 and "were not refitted" in without.notes[0]
    last = len(members) - 1
    # Weights p(past)/p(all) of the last step are 1/p(last step | past), as of any fold.
    assert without.khat[last] == result.khat[last]


def test_what_cannot_be_divided_is_refused():
    posterior = wave(30)
    with pytest.raises(InputError, match="the data have one: use scheme='block'"):
        cross_validate(posterior, "trajectory")
    with pytest.raises(InputError, match="block=30 leaves a single fold"):
        cross_validate(posterior, "block", block=30)
    with pytest.raises(InputError, match="does not apply to scheme='loo'"):
        cross_validate(posterior, "loo", block=3)
    with pytest.raises(InputError, match="block=0 must be a positive whole number"):
        cross_validate(posterior, "block", block=0)
    with pytest.raises(InputError, match="'loo', 'block', 'trajectory', 'future'"):
        cross_validate(posterior, "rows")
    with pytest.raises(InputError, match="start=1 must lie between"):
        cross_validate(posterior, "future", start=1.0)


def test_steps_into_the_future_that_the_package_chooses_are_two_at_least():
    # Runs on one clock, each with an offset of its own: residuals stay correlated over the whole of a run.
    rng, n_run, n = np.random.default_rng(0), 20, 30
    y = [rng.uniform(-1, 1, n) for _ in range(n_run)]
    rate = [np.full(n, offset) + 0.01 * rng.standard_normal(n) for offset in rng.standard_normal(n_run)]
    data = Trajectories.from_arrays(
        [0.1 * np.arange(n)] * n_run,
        states={"y": y, "v": [rng.uniform(-1, 1, n) for _ in range(n_run)]},
        derivatives={"v": rate},
    )
    posterior = fabricate(Program(dictionary={"v": ["y"]}, discrepancy=None), data)
    assert correlation_length(posterior, "v") > 15
    folds = make_folds(posterior, "future")
    assert len(folds.members["v"]) >= 2 and "half of what is predicted" in folds.notes[0]
