"""Noise models weighed against each other: totals against dense covariances, and what noise is found."""

import math

import numpy as np
import pytest
from tiny_equation import CUBE, SQUARE, on, tiny_model

from bayes_greybox.data.noise.protocol import RowNoise
from bayes_greybox.data.noise.state_space import StateSpaceNoise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.finding import decide
from bayes_greybox.discovery.evidence.evaluations import Evaluations
from bayes_greybox.discovery.evidence.odds import Odds
from bayes_greybox.discovery.evidence.of_equation import sufficient_statistics
from bayes_greybox.discovery.evidence.with_discrepancy import Evaluator
from bayes_greybox.discovery.weighing.sets import LAWFUL, OTHER_LAWS, PLAIN, RECALIBRATED, REST, Sets
from bayes_greybox.discovery.weighing.worlds import World, _world, weights, worlds
from bayes_greybox.model.noise.noise_model import CORRELATED, HEAVY, PROCESS, VARYING, NoiseModel

ODDS = Odds()


def along(noise, hidden=np.zeros_like, n=160, effects=(CUBE, SQUARE), n_run=1, **model):
    """ẋ = −x + hidden(x) + noise along a path that wanders over [−1, 1]."""
    t = 0.1 * np.arange(n)
    x = 0.6 * np.sin(0.9 * t) + 0.4 * np.sin(2.7 * t + 1)
    rate = -x + hidden(x) + noise(np.random.default_rng(2), x)
    parts = np.array_split(np.arange(n), n_run)
    data = Trajectories.from_arrays(
        [t[p] for p in parts], states={"x": [x[p] for p in parts]}, derivatives={"x": [rate[p] for p in parts]}
    )
    bound = [on(effect) for effect in effects]
    statistics = sufficient_statistics(tiny_model(**model), data, "x", bound)
    return Evaluations(
        statistics, ODDS, Evaluator(statistics.prior, statistics.kernel, np.asarray(statistics.basis.frequency))
    )


def white(rng, x):
    return 0.05 * rng.standard_normal(len(x))


def sluggish(rng, x):
    """AR(1) with ρ = 0.9."""
    e = rng.standard_normal(len(x))
    for i in range(1, len(e)):
        e[i] = 0.9 * e[i - 1] + math.sqrt(1 - 0.81) * e[i]
    return 0.05 * e


def growing(rng, x):
    return 0.15 * np.abs(x) * rng.standard_normal(len(x))


def heavy(rng, x):
    return 0.03 * rng.standard_t(2, len(x))


def cubic(x):
    return -(x**3)


def weighed(known, most=2, **quantities):
    x = known.statistics.rows.columns["x"]
    return worlds(Sets(known, most), {"x": x} | quantities)


def dense(known, columns, R):
    """Log evidence under the covariance σ²R, summed over a grid of σ."""
    statistics = known.statistics
    X = statistics.at_rows(list(columns))
    y = statistics.rows.target / statistics.target_scale
    sd = np.array([statistics.columns[i].sd for i in columns])
    t = np.linspace(-6, 2, 401)
    logs = []
    for log_s in t:
        C = X * sd**2 @ X.T + statistics.noise.sigma(log_s) ** 2 * R
        L = np.linalg.cholesky(C)
        z = np.linalg.solve(L, y)
        logs.append(-0.5 * z @ z - np.sum(np.log(np.diag(L))) - 0.5 * len(y) * np.log(2 * np.pi))
    return float(np.logaddexp.reduce(np.array(logs) + statistics.noise.log_density(t)) + np.log(t[1] - t[0]))


# Comparable


@pytest.mark.parametrize("names", [(), (CORRELATED,), (PROCESS,)])
def test_a_worlds_total_is_its_evidence_under_a_dense_covariance(names):
    known = along(sluggish, n=60, effects=(CUBE,))
    time = known.statistics.rows.time
    noise = known.statistics.rows.noise
    if names:
        noise = StateSpaceNoise((time,), "exponential" if names == (CORRELATED,) else "matern32", 0.5, 0.2)
    under = Evaluations(known.statistics.with_noise(noise), ODDS, known.evaluator)
    world = _world(Sets(under, 1, PROCESS in names), NoiseModel(noise, names, 0.7, {}))
    R = noise.covariance()
    (cube,), (correction,) = known.statistics.of_kind("effect"), known.statistics.of_kind("correction")
    bare, changed = dense(known, (), R), dense(known, (correction,), R)
    with_cube, both = dense(known, (cube,), R), dense(known, (correction, cube), R)
    p = ODDS.correction
    # Both patterns of the correction, beside an effect or a rest
    beside = [np.logaddexp(np.log(1 - p) + a, np.log(p) + b) for a, b in ((bare, changed), (with_cube, both))]
    laws = [e.memory[0] for e in world.explanations if e.kind == LAWFUL]
    beside_laws = [
        np.logaddexp(np.log(1 - p) + dense(under, (law,), R), np.log(p) + dense(under, (correction, law), R))
        for law in laws
    ]
    in_noise = len([n for n in names if n != PROCESS])
    prior = in_noise * np.log(ODDS.noise) + (3 - in_noise) * np.log1p(-ODDS.noise)
    if names == (PROCESS,):
        parts = [np.log(ODDS.unknown / 2) + beside[0], np.log(ODDS.effects * ODDS.remainder / 2) + beside[1]]
        rest = ODDS.remainder / 2
        assert all(e.kind in (PLAIN, LAWFUL) for e in world.explanations)
    else:
        rest = 1 - ODDS.remainder
        parts = [
            np.log(ODDS.no_gap) + bare,
            np.log(ODDS.recalibrate) + changed,
            np.log(ODDS.effects * (1 - ODDS.remainder)) + beside[1],
            *(e.log_weight + world.offset - prior - 0.7 for e in world.explanations if e.kind == REST),
        ]
    assert len(laws) == 4
    parts += [np.log(ODDS.effects * rest * OTHER_LAWS / 4) + each for each in beside_laws]
    assert world.total == pytest.approx(np.logaddexp.reduce(parts) + prior + 0.7, abs=2e-3)


def test_probabilities_of_worlds_add_up_to_one_and_go_with_their_totals():
    found = weighed(along(sluggish, cubic))
    p = weights(found)
    assert p.sum() == pytest.approx(1.0) and (np.diff(p) <= 0).all()
    assert np.log(p[0] / p[1]) == pytest.approx(found[0].total - found[1].total)
    assert [w.total for w in found] == sorted((w.total for w in found), reverse=True)


# What noise is found


def test_white_noise_stays_white():
    found = weighed(along(white, cubic))
    assert found[0].model.names == () and weights(found)[0] > 0.5
    finding = decide(found)
    assert (finding.verdict, [p.slug for p in finding.places]) == ("named", ["cube"])


@pytest.mark.parametrize(("noise", "name"), [(sluggish, CORRELATED), (growing, VARYING), (heavy, HEAVY)])
@pytest.mark.parametrize("hidden", [np.zeros_like, cubic])
def test_noise_that_is_not_white_is_found_with_and_without_a_gap(noise, name, hidden):
    found = weighed(along(noise, hidden, n=300))
    finding = decide(found)
    assert finding.weighed.by_noise[name] > 0.5 and name in found[0].model.names
    assert finding.verdict == ("named" if hidden is cubic else "no gap")
    assert [p.slug for p in finding.places] == (["cube"] if hidden is cubic else [])


def test_nothing_missing_under_correlated_noise_would_be_a_gap_if_it_were_white():
    known = along(sluggish, n=300)
    (first, *_) = weighed(known)
    alone = _world(Sets(known, 2), NoiseModel(known.statistics.rows.noise))
    assert first.total > alone.total + 20
    assert decide([first]).verdict == "no gap"


def test_a_smooth_process_is_something_that_is_missing():
    def swinging(rng, x):
        t = 0.1 * np.arange(len(x))
        return 0.3 * np.sin(0.77 * t**1.1 + 1) + 0.02 * rng.standard_normal(len(x))

    found = weighed(along(swinging, n=200))
    assert PROCESS in found[0].model.names and decide(found).verdict == "unknown"


def test_several_runs_have_noise_of_their_own():
    found = weighed(along(sluggish, n=300, n_run=3))
    (world,) = [w for w in found if w.model.names == (CORRELATED,)]
    assert world.model.noise.run_lengths == (100, 100, 100)
    assert decide(found).verdict == "no gap"


def test_few_rows_say_nothing_about_their_noise():
    found = weighed(along(sluggish, n=19))
    assert len(found) == 1 and found[0].model.names == ()


def test_what_noise_may_grow_with_is_what_is_given():
    known = along(growing, n=300)
    other = np.random.default_rng(0).uniform(0, 1, 300)
    found = weighed(known, other=other)
    about = next(w.model.about[VARYING] for w in found if VARYING in w.model.names)
    assert about["variable"] == "x" and about["exponent"] > 0
    assert not any(VARYING in w.model.names for w in worlds(Sets(known, 1), {}))


def test_it_tells_what_it_weighs_again():
    known, told = along(sluggish), []
    worlds(Sets(known, 1), {}, report=told.append)
    assert f"weighing again with {CORRELATED}" in told


# One explanation in a world


def a_world(known, names=(), noise=None, share=0.0):
    noise = noise or known.statistics.rows.noise
    about = {PROCESS: {"share": share}} if PROCESS in names else {}
    return _world(Sets(known, 1, PROCESS in names), NoiseModel(noise, names, 0.0, about))


def test_the_residual_of_the_right_explanation_is_the_noise():
    known = along(white, cubic)
    world = a_world(known)
    scale = known.statistics.target_scale
    # 0.05 over 160 rows is known to 5.6 %; four of them.
    assert np.std(world.residual(world.best)) * scale == pytest.approx(0.05, rel=0.23)
    assert world.best.effects and not world.bare.effects


def test_a_rest_is_taken_off_the_residual_too():
    known = along(lambda rng, x: 0.02 * rng.standard_normal(len(x)), lambda x: x * np.cos(2.5 * x), effects=())
    world = a_world(known)
    assert world.best.kind == REST
    assert np.std(world.residual(world.best)) < 0.5 * np.std(world.residual(world.bare))
    assert world.share_left(world.best) == world.best.share_left > 0.5


def test_a_recalibration_has_a_coefficient_that_changed_and_no_gap_has_none():
    known = along(white, lambda x: 0.02 * x, effects=())
    world = a_world(known)
    by_kind = {e.kind: world.coefficients(e)[0] for e in world.explanations if e.kind != REST}
    assert by_kind[PLAIN] == pytest.approx([0.0]) and by_kind[RECALIBRATED] != pytest.approx([0.0])


def test_a_world_without_a_process_leaves_nothing_beside_columns():
    world = a_world(along(white, cubic))
    assert world.share_left(world.best) == 0.0


def test_a_process_in_time_has_its_share_of_what_columns_leave():
    known = along(sluggish, cubic)
    world = a_world(known, (PROCESS,), share=0.5)
    e = world.best
    spread = np.mean(world.residual(e) ** 2)
    assert world.share_left(e) == pytest.approx(0.5 * spread / (1 - 0.5 * spread))
    assert world.share_left(e) < 0.1 < world.share_left(world.bare)


def test_rows_of_a_known_correlation_are_not_suspected():
    known = along(sluggish, n=100)
    noise: RowNoise = StateSpaceNoise((known.statistics.rows.time,), "exponential", 0.9, 0.0)
    under = Evaluations(known.statistics.with_noise(noise), ODDS, known.evaluator)
    (only,) = weighed(under)
    assert isinstance(only, World) and only.model.names == ()
