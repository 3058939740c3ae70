"""Errors that states and their rates tell by themselves: put right once, and not weighed again."""

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.discovery.linearise.near import Point
from bayes_greybox.discovery.linearise.rates import RateRows
from bayes_greybox.physics.terms import Term

STEP, N = 0.05, 600


def motion(t):
    return np.sin(t) + 0.4 * np.sin(2.3 * t + 1), np.cos(t) + 0.92 * np.cos(2.3 * t + 1)


def rows(late=0.0, bend=0.0, play=0.0, gain=1.0, simulation=None):
    rng, t = np.random.default_rng(3), STEP * np.arange(N)
    (x, v), shown = motion(t), motion(t - late * STEP)[0]
    for k in range(1, N) if play else ():
        shown[k] = np.clip(shown[k - 1], x[k] - play, x[k] + play)
    force = np.sin(3 * t)
    data = bg.Trajectories.from_arrays(
        t,
        states={"x": shown + bend * shown**3 + 0.002 * rng.standard_normal(N), "v": gain * v},
        inputs={"F": force},
        derivatives={"v": force - 2 * x - 0.3 * v + 0.01 * rng.standard_normal(N)},
    )
    model = bg.GreyBox(simulation=simulation or {"x": "v", "v": "F - 2*x - 0.3*v"})
    return RateRows(model, data, "v", [])


@pytest.mark.parametrize(("about", "key"), [({"late": 1.0}, "delay of x"), ({"bend": 0.03}, "cubic error of x")])
def test_a_known_error_is_no_suspect_of_the_rows(about, key):
    source = rows(**about)
    assert [error.key for error in source.known] == [key]
    assert key not in [column.called for column in source.near(Point()).regressors.columns]
    right = source.put_right(source.train, Point(), {}, source.train)
    off = right.states["x"] - motion(right.time)[0]
    assert np.std(off[20:-20]) < 0.005


def test_a_departure_is_weighed_with_a_drift_of_its_state():
    source = rows(play=0.1)
    called = [column.called for column in source.near(Point()).regressors.columns]
    assert not source.known and {"departure of x", "departure of v", "drift of x"} <= set(called)
    # It has the same column, and comes first.
    assert "drift of d(v)/dt" not in called


@pytest.mark.parametrize("gain", [1.05, 3.6, 1 / 3.6, -1.0])
def test_a_speed_in_other_units_is_weighed_with_its_exact_column(gain):
    # The damping may as well be wrong: 0.3 of the speed, and 0.3 times the gain of what its sensor shows.
    source = rows(gain=gain)
    near = source.near(Point()).regressors
    (column,) = [c for c in near.columns if c.called == "gain of v"]
    assert column.suspect.expected == pytest.approx(gain - 1, rel=0.01)
    v = motion(source.train.time)[1]
    exact = -0.3 * v - -0.3 * gain * v
    values = near.values[:, near.columns.index(column)]
    np.testing.assert_allclose(values * column.scale * (gain - 1), exact, atol=0.01 * np.max(np.abs(exact)))


@pytest.mark.parametrize("gain", [1.05, 3.6, -1.0])
def test_beside_a_gain_columns_are_those_of_what_is_right(gain):
    source = rows(gain=gain)
    suspect = next(c.suspect for c in source.near(Point()).regressors.columns if c.called == "gain of v")
    point = Point(added=((Term("v**3"), 0.0),), sensors={suspect: 0.9 * (gain - 1)})
    rows_near, v = source.near(point), motion(source.train.time)[1]
    # Its size is that of the samples, whatever the rates say of it.
    np.testing.assert_allclose(rows_near.data.states["v"], v, rtol=1e-3)
    near = rows_near.regressors
    at = {column.called: near.values[:, k] * column.scale for k, column in enumerate(near.columns)}
    # x = (shown − o)/(1 + κ), at the right speed.
    np.testing.assert_allclose(at["gain of v"], 0.3 * v / gain, rtol=2e-3)
    # The target has the whole error again.
    shown = np.asarray(near.shown) * near.target_scale
    np.testing.assert_allclose(shown, 0.3 * v / gain * (gain - 1), rtol=5e-3)


def test_one_of_two_errors_is_asked_for_only_where_both_have_a_column():
    # x acts on nothing, so that its gain has no column: the speed's is not sure then.
    source = rows(gain=1.05, simulation={"x": "v", "v": "F - 0.3*v"})
    suspects = {c.called: c.suspect for c in source.near(Point()).regressors.columns if c.suspect}
    assert "gain of x" not in suspects and not suspects["gain of v"].sure
    both = {c.called: c.suspect for c in rows(gain=1.05).near(Point()).regressors.columns if c.suspect}
    assert both["gain of x"].sure == both["gain of v"].sure == "gain of x and v"
