"""Posterior draws of coefficients, against their closed form."""

from dataclasses import replace

import numpy as np
import pytest
from hand_made import answer, with_hypotheses
from tiny_equation import CUBE, DEAD_ZONE, SQUARE, tiny_near

from bayes_greybox.discovery.answer.coefficients import answering, draw_coefficients, sensor_errors, without_sensors
from bayes_greybox.discovery.grid.log_evidence import modes

N_DRAW = 4000


def cubic(**changes):
    """Rows with a hidden cube."""
    return tiny_near(**({"effects": [CUBE, SQUARE], "hidden": lambda x: -(x**3), "noise": 0.1} | changes))


def no_corrections(**changes):
    return cubic(simulation=lambda t, x, u: [-x[0]], **changes)


def zone(x):
    return -np.sign(x) * np.maximum(np.abs(x) - 0.3, 0)


def drawn(near, code="named", base=(), n=N_DRAW, seed=0, sensors=()):
    verdict = replace(answer(near, code, base), sensors=sensors)
    h = next(h for h in near.weighed.hypotheses if not set(base) - set(h.members))
    return draw_coefficients(near, replace(verdict, hypothesis=h), n, seed)


def closed_form(near, hypothesis):
    """Mean and covariance at one noise point."""
    found = modes(
        near.weighed.grid,
        near.weighed.precision,
        [hypothesis.members],
        np.array([hypothesis.point]),
        near.weighed.floor,
    )
    return found.mean[0], found.covariance[0]


def test_draws_have_the_mean_and_covariance_of_the_closed_form():
    near = with_hypotheses(no_corrections(dictionary={"x": ["sin(3*x)"]}), {"cube": 1.0})
    cube, _ = near.regressors.of_kind("effect")
    draws = drawn(near, base=(cube,)).draws
    mean, covariance = closed_form(near, near.likeliest)
    sd = np.sqrt(np.diag(covariance))
    # Four standard errors of a mean and, relative, of a standard deviation, twice each: false failure 2.5e-4.
    np.testing.assert_array_less(np.abs(draws.mean(axis=0) - mean), 4 * sd / np.sqrt(N_DRAW))
    np.testing.assert_allclose(draws.std(axis=0), sd, rtol=4 / np.sqrt(2 * N_DRAW))
    # The standard error of a correlation is 1/√n at most.
    correlation = covariance[0, 1] / (sd[0] * sd[1])
    assert np.corrcoef(draws.T)[0, 1] == pytest.approx(correlation, abs=4 / np.sqrt(N_DRAW))


def test_columns_are_free_terms_then_corrections_then_effects():
    near = with_hypotheses(cubic(dictionary={"x": ["sin(3*x)"]}), {"cube": 1.0})
    found = drawn(near, base=near.regressors.of_kind("effect")[:1], n=10)
    assert [near.column(i).kind for i in found.indices] == ["free", "correction", "effect"]
    assert found.draws.shape == (10, 3) and found.inner.shape == (10, 1)


def test_a_correction_is_exactly_zero_where_it_is_out_and_out_as_often_as_it_is_unlikely():
    near = with_hypotheses(cubic(), {"cube": 0.7, "cube + x": 0.3})
    cube, _ = near.regressors.of_kind("effect")
    draws = drawn(near, base=(cube,)).draws
    inside = draws[:, 0] != 0
    # Four standard errors of a frequency.
    assert np.mean(inside) == pytest.approx(0.3, abs=4 * np.sqrt(0.21 / N_DRAW))
    mean, covariance = closed_form(near, near.weighed.hypotheses[1])
    sd = np.sqrt(np.diag(covariance))
    np.testing.assert_array_less(np.abs(draws[inside].mean(axis=0) - mean), 4 * sd / np.sqrt(np.sum(inside)))


@pytest.mark.parametrize(("code", "corrected"), [("no gap", False), ("instrument", False), ("recalibrate", True)])
def test_beside_a_recalibration_a_coefficient_is_off_and_where_nothing_is_missing_none_is(code, corrected):
    near = with_hypotheses(cubic(), {"no gap": 0.5, "recalibrate": 0.4, "cube": 0.1})
    draws = drawn(near, code, n=200).draws
    assert np.all((draws[:, 0] != 0) == corrected)
    # Where something has no name it may be either.
    either = drawn(near, "unknown").draws[:, 0] != 0
    assert np.mean(either) == pytest.approx(4 / 9, abs=4 * 0.5 / np.sqrt(N_DRAW))


def test_values_of_an_inner_parameter_are_drawn_by_their_posterior_with_their_own_coefficient():
    near = no_corrections(effects=[DEAD_ZONE], hidden=zone, n=100)
    zones = near.regressors.of_kind("effect")
    likeliest = next(h for h in near.weighed.hypotheses if set(h.members) & set(zones))
    found = drawn(near, base=[i for i in likeliest.members if i in zones])
    own = {h.members[-1]: h for h in near.weighed.hypotheses if h.members and set(h.members) <= set(zones)}
    weight = {i: h.probability for i, h in own.items()}
    total = sum(weight.values())
    for i in zones:
        p = weight.get(i, 0.0) / total
        # Hypotheses of less than a ten-thousandth of the likeliest are left out.
        assert abs(np.mean(found.inner == i) - p) < 4 * np.sqrt(p * (1 - p) / N_DRAW) + 1e-3
    assert len(np.unique(found.inner)) > 1
    for i in np.unique(found.inner):
        rows = found.inner[:, 0] == i
        if np.sum(rows) > 200:
            # Averaged over noise points, at the likeliest of which it stands.
            assert found.draws[rows, 0].mean() == pytest.approx(own[i].mean[0], abs=0.5 * own[i].sd[0])


def test_the_noise_is_that_of_the_sensor():
    near = no_corrections(n=200)
    found = drawn(near, base=near.regressors.of_kind("effect")[:1])
    # The truth is 0.1, estimated from 200 rows to 5 %; four of them.
    assert found.sigma.mean() * near.regressors.target_scale == pytest.approx(0.1, rel=0.2)
    assert found.sigma.std() / found.sigma.mean() == pytest.approx(1 / np.sqrt(2 * 200), rel=0.5)


def test_sensor_errors_of_the_answer_are_drawn_and_others_are_in_no_draw():
    near = cubic(hidden=lambda x: -(x**3) + 0.05)
    offset = next(c.called for c in near.regressors.columns if c.suspect is not None and c.suspect.kind == "offset")
    near = with_hypotheses(near, {f"cube + {offset}": 0.6, "cube": 0.4})
    cube, _ = near.regressors.of_kind("effect")
    found = drawn(near, base=(cube,), sensors=(offset,))
    assert [near.column(i).called for i in found.suspects] == [offset] and found.suspect_draws.all()
    ((suspect, size),) = sensor_errors(near.regressors, found).items()
    assert suspect.key == offset and size == pytest.approx(0.05, abs=0.06)
    without = drawn(near, base=(cube,))
    assert without.suspects == () and without.suspect_draws.shape == (N_DRAW, 0)


def test_where_no_hypothesis_is_the_answer_the_likeliest_stands_for_it_without_other_errors():
    near = cubic()
    offset = next(c.called for c in near.regressors.columns if c.suspect is not None)
    near = with_hypotheses(near, {f"cube + {offset}": 1.0})
    cube, _ = near.regressors.of_kind("effect")
    verdict = answer(near, "named", (cube,))
    (found,) = answering(near, verdict)
    assert found.members == (cube,) and without_sensors(near, verdict).members == (cube,)
    assert len(found.mean) == len(found.sizes) == 1 and found.covariance.shape == (1, 1)


def test_nothing_is_drawn_where_there_is_no_column():
    near = with_hypotheses(no_corrections(), {"no gap": 1.0})
    found = drawn(near, "no gap", n=10)
    assert found.indices == () and found.draws.shape == (10, 0) and found.inner.shape == (10, 0)


def test_draws_are_those_of_the_seed():
    near = cubic()
    base = near.regressors.of_kind("effect")[:1]
    first, again, other = (drawn(near, base=base, n=20, seed=seed).draws for seed in (0, 0, 1))
    assert np.array_equal(first, again) and not np.array_equal(first, other)
