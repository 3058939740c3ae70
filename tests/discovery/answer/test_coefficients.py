"""Posterior draws of coefficients, against their closed form."""

from dataclasses import replace

import numpy as np
import pytest
from tiny_equation import CUBE, DEAD_ZONE, SQUARE, integrated, tiny_evaluations

from bayes_greybox.discovery.answer.coefficients import alone, draw_coefficients, plain
from bayes_greybox.discovery.evidence.evaluations import one_pattern
from bayes_greybox.model.estimate.evidence import coefficients

N_DRAW = 4000


def cubic(sigma=1.0, **changes):
    """Evaluations of rows with a hidden cube; beside f the noise is `sigma`, by hand."""
    given = {"effects": [CUBE, SQUARE], "hidden": lambda x: -(x**3), "noise": 0.1}
    known = tiny_evaluations(**(given | changes))
    known.integrated = lambda effects: integrated(sigma=sigma)
    return known


def no_corrections(**changes):
    return cubic(simulation=lambda t, x, u: [-x[0]], **changes)


def closed_form(known, effects, pattern=0):
    return coefficients(*one_pattern(known.parametric([effects])[0], pattern))


def test_draws_have_the_mean_and_covariance_of_the_closed_form():
    known = no_corrections(dictionary={"x": ["sin(3*x)"]})
    cube = known.statistics.of_kind("effect")[0]
    draws = draw_coefficients(known, (cube,), N_DRAW, seed=0).draws
    mean, covariance = closed_form(known, (cube,))
    sd = np.sqrt(np.diag(covariance))
    # Four standard errors of a mean and, relative, of a standard deviation, twice each: false failure 2.5e-4.
    np.testing.assert_array_less(np.abs(draws.mean(axis=0) - mean), 4 * sd / np.sqrt(N_DRAW))
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=4 / np.sqrt(2 * N_DRAW))
    # The standard error of a correlation is 1/√n at most.
    correlation = covariance[0, 1] / (sd[0] * sd[1])
    assert np.corrcoef(draws.T)[0, 1] == pytest.approx(correlation, abs=4 / np.sqrt(N_DRAW))


def test_columns_are_free_terms_then_corrections_then_effects():
    known = cubic(dictionary={"x": ["sin(3*x)"]})
    found = draw_coefficients(known, (known.statistics.of_kind("effect")[0],), 10, seed=0)
    assert [known.statistics.columns[i].kind for i in found.indices] == ["free", "correction", "effect"]
    assert found.draws.shape == (10, 3) and found.inner.shape == (10, 1)


def test_a_correction_is_exactly_zero_where_it_is_out_and_out_as_often_as_it_is_unlikely():
    known = cubic()
    cube = known.statistics.of_kind("effect")[0]
    draws = draw_coefficients(known, (cube,), N_DRAW, seed=0).draws[:, 0]
    logs = known.parametric([(cube,)])[0].by_pattern
    p_in = np.exp(logs[1] - np.logaddexp.reduce(logs))
    assert 0.02 < p_in < 0.98
    # Four standard errors of a frequency.
    assert np.mean(draws != 0) == pytest.approx(p_in, abs=4 * np.sqrt(p_in * (1 - p_in) / N_DRAW))


def test_given_that_a_correction_is_in_draws_are_those_of_that_pattern():
    known = cubic()
    cube = known.statistics.of_kind("effect")[0]
    draws = draw_coefficients(known, (cube,), N_DRAW, seed=0).draws
    inside = draws[draws[:, 0] != 0]
    mean, covariance = closed_form(known, (cube,), pattern=1)
    sd = np.sqrt(np.diag(covariance))
    np.testing.assert_array_less(np.abs(inside.mean(axis=0) - mean), 4 * sd / np.sqrt(len(inside)))


def test_draws_given_that_a_correction_is_in_or_that_none_is_are_of_no_other_pattern():
    known = tiny_evaluations(hidden=lambda x: -0.04 * x)
    assert 0 < np.mean(draw_coefficients(known, (), N_DRAW, seed=0).draws[:, 0] != 0) < 1
    assert not draw_coefficients(known, (), N_DRAW, seed=0, none=True).draws.any()
    draws = draw_coefficients(known, (), N_DRAW, seed=0, some=True).draws[:, 0]
    (mean,), ((variance,),) = closed_form(known, (), pattern=1)
    assert (draws != 0).all() and abs(draws.mean() - mean) < 4 * np.sqrt(variance / N_DRAW)


def test_values_of_an_inner_parameter_are_drawn_by_their_posterior():
    known = no_corrections(effects=[DEAD_ZONE], hidden=lambda x: -np.sign(x) * np.maximum(np.abs(x) - 0.3, 0))
    zones = known.statistics.of_kind("effect")
    log_z = np.array([v.all for v in known.parametric([(i,) for i in zones])])
    weight = np.exp(log_z - np.logaddexp.reduce(log_z))
    found = draw_coefficients(known, (zones[0],), N_DRAW, seed=0)
    shares = np.array([np.mean(found.inner == i) for i in zones])
    # Values of a weight below a thousandth are left out, eight of them at most.
    np.testing.assert_array_less(np.abs(shares - weight), 4 * np.sqrt(weight * (1 - weight) / N_DRAW) + 0.008)
    assert np.sum(shares > 0) > 1


def test_the_coefficient_of_a_draw_goes_with_its_own_inner_parameter():
    known = no_corrections(effects=[DEAD_ZONE], hidden=lambda x: -np.sign(x) * np.maximum(np.abs(x) - 0.3, 0))
    found = draw_coefficients(known, (known.statistics.of_kind("effect")[0],), N_DRAW, seed=0)
    for index in np.unique(found.inner):
        rows = found.inner[:, 0] == index
        if np.sum(rows) > 50:
            mean, covariance = closed_form(known, (int(index),))
            error = np.sqrt(covariance[0, 0] / np.sum(rows))
            assert found.draws[rows, 0].mean() == pytest.approx(mean[0], abs=4 * error)


def test_where_f_remains_noise_and_scatter_are_those_beside_f():
    known = no_corrections(sigma=0.01)
    cube = known.statistics.of_kind("effect")[0]
    found = draw_coefficients(known, (cube,), N_DRAW, seed=0, remainder=1.0)
    s_f = np.hypot(0.01, known.statistics.noise.floor)
    np.testing.assert_allclose(found.sigma, s_f)
    fitted = known.parametric([(cube,)])[0].marginal
    sigma = float(fitted.weight[0] @ fitted.sigma[0])
    expected = np.sqrt(closed_form(known, (cube,))[1][0, 0]) * s_f / sigma
    # Four standard errors, and that σ is not known exactly: a tenth over 60 rows, of which the square remains.
    assert found.draws[:, 0].std() == pytest.approx(expected, rel=4 / np.sqrt(2 * N_DRAW) + 0.03)


def test_where_f_does_not_remain_the_noise_is_that_of_the_parametric_model():
    known = no_corrections()
    found = draw_coefficients(known, (known.statistics.of_kind("effect")[0],), N_DRAW, seed=0)
    # The truth is 0.1, estimated from 60 rows to 9 %; four of them.
    assert found.sigma.mean() * known.statistics.target_scale == pytest.approx(0.1, rel=0.37)


def test_nothing_is_drawn_where_there_is_no_column():
    found = draw_coefficients(no_corrections(), (), 10, seed=0)
    assert found.indices == () and found.draws.shape == (10, 0) and found.inner.shape == (10, 0)


def test_draws_are_those_of_the_seed():
    known = cubic()
    base = (known.statistics.of_kind("effect")[0],)
    first, again, other = (draw_coefficients(known, base, 20, seed).draws for seed in (0, 0, 1))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_plain_coefficients_are_those_of_the_free_terms_with_nothing_corrected():
    known = cubic(dictionary={"x": ["sin(3*x)", "cos(x)"]})
    free = known.statistics.of_kind("free")
    G, g = known.statistics.products[np.ix_(free, free)], known.statistics.with_target[free]
    # The prior of free terms is so wide that they come out as by least squares.
    np.testing.assert_allclose(plain(known), np.linalg.solve(G, g), rtol=2e-3)


def test_without_free_terms_there_are_no_plain_coefficients():
    assert plain(cubic()).shape == (0,)


def test_an_effect_alone_has_the_coefficient_of_the_likeliest_pattern():
    known = cubic()
    cube = known.statistics.of_kind("effect")[0]
    pattern = int(np.argmax(known.parametric([(cube,)])[0].by_pattern))
    mean, covariance = closed_form(known, (cube,), pattern)
    assert alone(known, cube) == pytest.approx((mean[-1], np.sqrt(covariance[-1, -1])))


def test_an_effect_alone_has_the_coefficient_in_the_data():
    known = no_corrections()
    cube = known.statistics.of_kind("effect")[0]
    mean, sd = alone(known, cube)
    in_units = known.statistics.target_scale / known.statistics.columns[cube].scale
    assert abs(in_units * mean + 1) < 4 * in_units * sd


def test_intervals_of_two_inner_parameters_are_not_cut_to_their_middle(monkeypatch):
    """Where combinations are too many they are drawn, and not the heaviest taken."""
    wide = DEAD_ZONE.bind({"r": "x"})
    other = replace(DEAD_ZONE, slug="other", expression="max(r - gap, 0)").bind({"r": "x"})
    known = no_corrections(
        effects=[wide, other], noise=0.3, n=200, hidden=lambda x: -np.sign(x) * np.maximum(np.abs(x) - 0.3, 0)
    )
    columns = known.statistics.columns
    base = tuple(
        next(i for i in known.statistics.of_kind("effect") if columns[i].effect == each) for each in (wide, other)
    )

    def spread(most):
        monkeypatch.setattr("bayes_greybox.discovery.answer.coefficients.MOST_CHOICES", most)
        found = draw_coefficients(known, base, N_DRAW, seed=0)
        return np.log([[columns[i].inner["gap"] for i in row] for row in found.inner]).std(axis=0)

    # Drawn combinations are fewer than the draws: of 60 a standard deviation is known to some 10 %.
    np.testing.assert_allclose(spread(60), spread(10_000), rtol=0.35)
