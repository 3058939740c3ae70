"""Rows of rates whose simulation is the user's own terms alone, with coefficients that are learned."""

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.discovery.linearise.near import Point
from bayes_greybox.discovery.linearise.rates import RateRows


@pytest.fixture(scope="module")
def rows():
    data = bg.systems.duffing(k3=8.0).simulate(t=np.linspace(0, 20, 401), noise=0.01, seed=3)
    model = bg.GreyBox(simulation={"y": "ydot"}, dictionary={"ydot": ["y", "ydot", "F", "1"]})
    return RateRows(model, data, "ydot", []).near(Point())


def test_the_gap_is_what_the_own_terms_leave(rows):
    regressors = rows.regressors
    own = regressors.at_rows(regressors.of_kind("free"))
    left = regressors.target - own @ np.linalg.lstsq(own, regressors.target, rcond=None)[0]
    share = np.sqrt(np.mean(left**2) / np.mean(regressors.target**2))
    assert rows.force.gap == pytest.approx(share, rel=0.01) and share < 0.3


def test_errors_of_sensors_act_through_the_own_terms_from_the_first(rows):
    columns = rows.regressors.columns
    place = next(k for k, column in enumerate(columns) if column.called == "delay of F")
    slope = np.gradient(rows.data.inputs["F"], rows.data.time)
    # Their coefficients are those of least squares: a force of 1/m.
    found = rows.regressors.values[:, place] * columns[place].scale
    assert np.corrcoef(found, slope)[0, 1] > 0.99
    assert np.dot(found, slope) / np.dot(slope, slope) == pytest.approx(1.0, rel=0.1)
