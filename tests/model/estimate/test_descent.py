"""Descents near where the number of segments changes, and estimates on either side of it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.estimate.descent import SETTLED_WITHIN, STAYING_WITHIN, Standing, descended, likeliest_of
from bayes_greybox.model.estimate.near import near_estimate
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.path.path_segments import MOST_GROWTH
from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

MODEL = Program(
    {"x": ["x"], "y": ["x"]}, simulation={"x": "u", "y": "-y"}, rows=TrajectoryRows(interpolation="cubic"),
    discrepancy=None,
)  # fmt: skip
"""x' = a x + u, y' = b x - y: a change of the start of x grows by exp(a T)."""


def sampled(one_segment, n=150, noise=0.01):
    """Samples for a = 1 and b = 1/2 that last as long as one segment does at a given a; SciPy."""
    end, rng = math.log(MOST_GROWTH) / one_segment, np.random.default_rng(0)
    t = np.linspace(0, end, n)
    x, u = np.sin(1.3 * t), 1.3 * np.cos(1.3 * t) - np.sin(1.3 * t)
    y = solve_ivp(
        lambda t, y: [0.5 * np.sin(1.3 * t) - y[0]], (0, end), [0.0], t_eval=t, rtol=1e-10, atol=1e-12
    ).y[0]  # fmt: skip
    states = {"x": x + noise * rng.standard_normal(n), "y": y + 0.3 * noise * rng.standard_normal(n)}
    return Trajectories.from_arrays(t, states=states, inputs={"u": u})


def near(data, a, b=0.5, segments=1):
    at = [(Term("x"), a), (Term("x"), b)]
    return replace(MODEL, rows=MODEL.rows.unforced().in_segments(segments, data).around(at, ("x", "y")))


def standing(data, a, segments):
    model = near(data, a, segments=segments)
    (equation,) = model.assemble(data).values()
    at = [(Term("x"), a), (Term("x"), 0.5)]
    return Standing(model, equation, at, equation.log_density(at), equation.moved(at))


@pytest.fixture(scope="module")
def at_the_edge():
    # The estimate is 1.0017 give or take 0.0018 in one segment, and 1.0011 give or take 0.0019 in two.
    return sampled(one_segment=1.0014)


def test_an_estimate_where_the_number_of_segments_changes_is_settled_upon(at_the_edge):
    found = descended(near(at_the_edge, 0.9), at_the_edge, most=15)
    assert found is not None and found.moved < SETTLED_WITHIN and found.segments == 2
    # The whole way from the model alone comes to it as well, and needs no force.
    rows = near_estimate(MODEL, at_the_edge).rows
    assert not rows.process_noise and rows.added[0][1] == pytest.approx(1.0011, abs=2e-4)
    (equation,) = replace(MODEL, rows=rows).assemble(at_the_edge).values()
    assert equation.moved([(Term("x"), value) for _, value in rows.added]) < STAYING_WITHIN


def test_paths_are_compared_with_as_many_segments(at_the_edge):
    one, two = standing(at_the_edge, 0.999, 1), standing(at_the_edge, 1.0011, 2)
    # It is the density of fewer starts, and not of what the samples say.
    assert one.segments == 1 and one.density > two.density + 10
    assert likeliest_of([one, two], at_the_edge) is two and likeliest_of([two, one], at_the_edge) is two
    assert likeliest_of([one], at_the_edge) is one


def test_where_one_segment_does_there_is_one():
    data = sampled(one_segment=1.2)
    found = descended(near(data, 0.9), data, most=15)
    assert found is not None and found.segments == 1
    # Of a descent that begins where more are needed, too.
    again = descended(near(data, 1.3), data, most=15)
    assert standing(data, 1.3, 1).segments == 2
    assert again is not None and again.segments == 1
    assert again.at[0][1] == pytest.approx(found.at[0][1], abs=1e-4)
    # As many as are asked for stay.
    more = descended(near(data, 0.9, segments=3), data, most=15)
    assert more is not None and more.segments == 3


def test_segments_of_a_shorter_record_are_as_long(at_the_edge):
    rows = near(at_the_edge, 1.0, segments=3).rows
    part = at_the_edge.keep(slice(0, 40))
    assert (rows.segments(at_the_edge), rows.segments(part)) == (3, 1)
    # Half as many samples of one run and all of another: the longer run says how many.
    assert TrajectoryRows(segment=2.5).segments(at_the_edge) == math.ceil(np.ptp(at_the_edge.time) / 2.5)
    with pytest.raises(InputError, match="longer, or leave it out"):
        replace(MODEL, rows=TrajectoryRows(segment=0.01, added=(("x", 1.0),), added_to=("x",))).assemble(at_the_edge)
    with pytest.raises(InputError, match="segment=0"):
        TrajectoryRows(segment=0.0)
