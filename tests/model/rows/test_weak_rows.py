"""Weak rows: exact integrals, the covariance that the samples' noise gives them, and all that is asked of rows."""

from dataclasses import replace

import numpy as np
import pytest
from fabricated import estimated
from predator_prey import COEFFICIENTS, populations

import bayes_greybox as bg
from bayes_greybox.criticism.cross_validation.row_densities import pointwise_loo
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.estimate import near
from bayes_greybox.model.estimate.likeliest import likeliest
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows import weak_rows
from bayes_greybox.model.rows.kinds import ROW_KINDS
from bayes_greybox.model.rows.weak_path import Reading, weak_path
from bayes_greybox.model.rows.weak_rows import WeakRows
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

BOTH = {"x": ["x", "x*y"], "y": ["x*y", "y"]}
RIGHT = tuple((Term(text), value) for text, value in zip(["x", "x*y", "x*y", "y"], COEFFICIENTS, strict=True))
TO = ("x", "x", "y", "y")


def samples(noise=0.0, seed=0, n=401, end=8.0, runs=1):
    time = np.linspace(0, end, n)
    rng = np.random.default_rng(seed)
    each = [populations(time, starts=np.array([5.0 - k, 3.0 + k])) for k in range(runs)]
    noisy = [z + noise * rng.standard_normal(z.shape) for z in each]
    return Trajectories.from_arrays([time] * runs, states={"x": [z[0] for z in noisy], "y": [z[1] for z in noisy]})


def model_of(dictionary=BOTH, **changes):
    return Program(dictionary, **{"rows": WeakRows(), "discrepancy": None} | changes)


def residual(model, data):
    """Whitened rows less what the true coefficients say of them, over the noise of the samples."""
    (rows,) = [model.equation_rows(data, name) for name in model.blocks]
    (dictionary,) = model.assemble(data).values()
    table = rows.table(lambda at: np.asarray(dictionary.frame.dictionary.evaluate(at)), TO)(np.arange(rows.n_row))
    left = rows.target - table @ COEFFICIENTS
    return rows, left


def test_exact_samples_satisfy_the_rows():
    model = model_of(rows=WeakRows(radius=0.4).around(RIGHT, TO))
    rows, left = residual(model, samples())
    # The rule of a bump of twenty steps, and a cubic's smoothing, to second order in it.
    assert np.max(np.abs(left)) < 1e-6 * np.sqrt(np.mean(rows.measured**2))
    assert rows.n_white == rows.n_row == len(rows.noise.whiten(left[:, None]))


def test_the_covariance_is_that_of_the_residual():
    exact = samples(n=161, end=4.0)
    truth = exact.matrix(("x", "y"))
    sd, radius, n_draw = np.array([0.02, 0.05]), 0.3, 300
    program = model_of()
    simulation = program.simulator(exact)
    whole = simulation.beside({"x": RIGHT[:2], "y": RIGHT[2:]})
    rng, left = np.random.default_rng(1), []
    reading = replace(Reading.of(exact, radius), sd=sd)
    noise = weak_path(reading, ("x", "y"), simulation, whole, 0.0).rows.noise
    for _ in range(n_draw):
        noisy = truth + sd * rng.standard_normal(truth.shape)
        data = replace(exact, states=dict(zip("xy", noisy.T, strict=True)))
        path = weak_path(replace(reading, samples=data), ("x", "y"), simulation, whole, 0.0)
        rate = whole.rates(exact.time, path.states, np.empty((len(truth), 0)))
        said = sum(path.rows.learned[name].operator.table @ rate[:, k] for k, name in enumerate("xy"))
        left.append(path.rows.measured - said)
    left = np.array(left)
    R = noise.scale**2 * noise.covariance()
    S = left.T @ left / n_draw
    error = np.sqrt((np.outer(np.diag(R), np.diag(R)) + R**2) / n_draw)
    z = (S - R) / error
    # Standard errors: an RMS of one, and of some ten thousand entries none beyond five.
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.15)
    assert np.max(np.abs(z)) < 5.0
    # Without the noise of the other state, and of the terms, it is another covariance.
    bare = weak_path(reading, ("x", "y"), simulation, simulation, 0.0).rows.noise
    assert not np.allclose(bare.scale**2 * bare.covariance(), R, rtol=0.1, atol=0.1 * np.max(R))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_whitened_residuals_are_white(seed):
    model = model_of(rows=WeakRows().around(RIGHT, TO))
    rows, left = residual(model, samples(0.1, seed))
    white = rows.noise.whiten(left[:, None])[:, 0] / rows.noise.scale
    n = len(white)
    # The noise of 400 samples is known to 4 %; four standard errors of a mean square and of a correlation.
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.1 + 4 * np.sqrt(2 / n))
    assert abs(np.mean(white[1:] * white[:-1])) < 4 / np.sqrt(n)


def test_the_determinant_counts():
    model = model_of(rows=WeakRows().around(RIGHT, TO))
    (equation,) = model.assemble(samples(0.1)).values()
    R = equation.rows.noise.covariance()
    assert float(equation.design.log_det_R) == pytest.approx(np.linalg.slogdet(R)[1], rel=1e-6)
    assert float(equation.design.n_obs) == np.linalg.matrix_rank(R, tol=1e-12)


def test_all_terms_are_found_near_the_likeliest_model():
    candidates = ["1", "x", "y", "x**2", "x*y", "y**2", "x**3", "x**2*y"]
    model, data = model_of({"x": candidates, "y": candidates}).near(samples(0.1))
    named = {(to, text) for to, (text, _) in zip(model.rows.added_to, model.rows.added, strict=True)}
    assert named == {("x", "x"), ("x", "x*y"), ("y", "x*y"), ("y", "y")}
    (equation,) = model.assemble(data).values()
    found = likeliest(equation)
    # Four standard deviations each.
    truth = dict(zip(zip(TO, ["x", "x*y", "x*y", "y"], strict=True), COEFFICIENTS, strict=True))
    for (term, value), sd, to in zip(found.terms, found.sd, found.acts_on, strict=True):
        assert abs(value - truth[to, term.text]) < 4 * sd
    assert set(data.derivatives) == {"x", "y"} and data.samples is not None


def test_terms_that_come_and_go_are_refused(monkeypatch):
    # Without a white share the first turn, which knows nothing of the terms, finds far too many.
    monkeypatch.setattr(weak_rows, "FIRST_WHITE_SHARES", ())
    monkeypatch.setattr(near, "MOST_SEARCHES", 2)
    candidates = ["1", "x", "y", "x**2", "x*y", "y**2", "x**3", "x**2*y"]
    with pytest.raises(InputError, match="terms of x, y do not settle: after 2 turns .* WeakRows\\(white_share=0.05"):
        model_of({"x": candidates, "y": candidates}).near(samples(0.1))


def test_a_known_equation_has_rows_of_its_own():
    data = samples(0.1)
    alone = model_of({"x": ["x", "x*y"]})
    beside = model_of({"x": ["x", "x*y"]}, simulation={"y": "x*y - 4*y"})
    bare, known = (m.near(data)[0].assemble(data)["x"] for m in (alone, beside))
    assert known.rows.n_row == 2 * bare.rows.n_row
    sd = []
    for equation in (bare, known):
        Phi, frame = np.asarray(equation.design.Phi), equation.frame
        unit = frame.coefficient_scale * equation.rows.noise.scale / frame.target_scale
        sd.append(np.sqrt(np.diag(np.linalg.inv(Phi.T @ Phi))) * unit)
    # What the rows of the known equation tell of the noise makes the others sharper.
    assert np.all(sd[1] < sd[0])


def test_runs_gaps_and_uneven_steps():
    rng = np.random.default_rng(0)
    times = [np.linspace(0, 4, 201), np.sort(rng.uniform(0, 4, 201)), np.linspace(0, 0.2, 5)]
    # A gap in the first.
    times[0] = times[0][(times[0] < 1.5) | (times[0] > 2.2)]
    each = [populations(np.append(0.0, t))[:, 1:] if t[0] > 0 else populations(t) for t in times]
    data = Trajectories.from_arrays(times, states={"x": [z[0] for z in each], "y": [z[1] for z in each]})
    model = model_of(rows=WeakRows(radius=0.3).around(RIGHT, TO))
    rows, left = residual(model, data)
    assert set(rows.run.tolist()) == {0, 1}
    assert rows.noise.run_lengths == tuple(np.bincount(rows.run).tolist())
    assert not np.any((rows.run == 0) & (rows.time > 1.2) & (rows.time < 2.5))
    assert np.max(np.abs(left[rows.run == 0])) < 1e-4 * np.max(np.abs(rows.measured))
    assert np.max(np.abs(left[rows.run == 1])) < 1e-2 * np.max(np.abs(rows.measured))
    (said,) = WeakRows(radius=0.3).left_out(data)
    assert "half width 0.3" in said and "1 of 3 runs are too short" in said


def test_what_cannot_be_is_refused():
    short = samples(0.05, n=15, end=0.3)
    with pytest.raises(InputError, match="No run is as long as a test function.*TrajectoryRows"):
        model_of().near(short)
    lacking = Trajectories.from_arrays(np.linspace(0, 8, 401), states={"x": samples().states["x"]})
    with pytest.raises(InputError, match="need samples of all states, and those of 'y' are missing"):
        model_of({"x": ["x"]}, simulation={"x": "-x*y", "y": "x*y - 4*y"}).near(lacking)
    with pytest.raises(InputError, match="WeakRows\\(radius=-1.0\\) must be positive"):
        WeakRows(radius=-1.0)
    with pytest.raises(InputError, match="WeakRows\\(white_share=1.0\\) must be below 1"):
        WeakRows(white_share=1.0)
    with pytest.raises(InputError, match="follows from that of the samples"):
        model_of(noise=bg.Noise(correlation="fit")).with_noise_found(samples(0.1))
    with pytest.raises(InputError, match="A study does not weigh explanations on WeakRows"):
        bg.find_missing_effects(bg.GreyBox(simulation={"x": "x", "y": "-y"}, rows=WeakRows()), samples(0.1))


def test_it_is_known_by_name():
    assert ROW_KINDS["weak"] is WeakRows and bg.WeakRows is WeakRows


WHOLE = bg.GreyBox({"x": ["x", "x*y", "x**2"], "y": ["x*y", "y"]}, rows=bg.WeakRows(), discrepancy=None)


@pytest.fixture(scope="module")
def fit():
    return estimated(WHOLE, samples(0.1, runs=2))


@pytest.mark.slow
def test_a_fit_holds_the_truth_and_goes_through_a_file(tmp_path):
    fit = WHOLE.fit(samples(0.1, runs=2), draws=100, tune=200, chains=2, progress=False)
    table = fit.summary()
    for (name, text), truth in zip([("x", "x"), ("x", "x*y"), ("y", "x*y"), ("y", "y")], COEFFICIENTS, strict=True):
        assert abs(table.loc[(name, text), "mean"] - truth) < 4 * table.loc[(name, text), "sd"]
    assert "test functions" in repr(fit)
    fit.save(tmp_path / "weak.nc")
    again = bg.load(tmp_path / "weak.nc")
    assert again.model.rows == fit.model.rows
    for one, other in zip(again.equations.values(), fit.equations.values(), strict=True):
        np.testing.assert_array_equal(one.rows.target, other.rows.target)
        np.testing.assert_array_equal(one.rows.noise.covariance(), other.rows.noise.covariance())
    assert np.all(fit.predict(samples(0.1, seed=5)).nmse() < 0.1)
    with pytest.raises(InputError, match="follow no path"):
        fit.refine()


def test_leave_one_out_is_that_of_the_dense_normal(fit):
    (block,) = fit.equations
    equation = fit.equations[block]
    fast = pointwise_loo(fit, block, 3)
    draws = fit.draws(block, 3)
    Phi, _, y = equation.parts()
    R, scale = equation.rows.noise.covariance(), equation.frame.target_scale
    for k in range(3):
        D = np.diag(np.asarray(draws.spread)[k] ** 2)
        C = Phi @ D @ Phi.T + float(np.asarray(draws.hyper.sigma)[k]) ** 2 * R
        P = np.linalg.inv(C)
        g, c = P @ y, np.diag(P)
        slow = 0.5 * np.log(c) - 0.5 * np.log(2 * np.pi) - g**2 / (2 * c) - np.log(scale)
        np.testing.assert_allclose(fast[k], slow, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("scheme", ["loo", "block", "trajectory", "future"])
def test_cross_validation_goes_by_rows_and_runs(fit, scheme):
    found = bg.cross_validate(fit, scheme=scheme, max_refits=0, progress=False)
    assert np.isfinite(found.elpd)
    if scheme == "trajectory":
        assert len(found.pointwise) == 2
