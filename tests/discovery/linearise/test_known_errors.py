"""Errors that states and their rates tell by themselves: put right once, and not weighed again."""

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.discovery.linearise.near import Point
from bayes_greybox.discovery.linearise.rates import RateRows

STEP, N = 0.05, 600


def motion(t):
    return np.sin(t) + 0.4 * np.sin(2.3 * t + 1), np.cos(t) + 0.92 * np.cos(2.3 * t + 1)


def rows(late=0.0, bend=0.0, play=0.0, gain=1.0):
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
    model = bg.GreyBox(simulation={"x": "v", "v": "F - 2*x - 0.3*v"})
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


@pytest.mark.parametrize("gain", [1.05, 3.6])
def test_a_speed_in_other_units_is_weighed_with_its_exact_column(gain):
    # 0.3 v too much at 1.05 is a damping of 0.3/1.05, and at 3.6 one of 0.3/3.6, which the simulation may have as well.
    source = rows(gain=gain)
    near = source.near(Point()).regressors
    (column,) = [c for c in near.columns if c.called == "gain of v"]
    assert column.suspect.expected == pytest.approx(gain - 1, rel=0.01)
    v = motion(source.train.time)[1]
    exact = -0.3 * v - -0.3 * gain * v
    np.testing.assert_allclose(column.values, exact / np.sqrt(np.mean(exact**2)), atol=0.01)
    # Times the size it is the whole error.
    assert column.scale * (gain - 1) == pytest.approx(np.sqrt(np.mean(exact**2)), rel=0.01)
