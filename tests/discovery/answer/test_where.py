"""Where the gap is: probabilities, regions and windows on gaps that are written down by hand."""

import numpy as np
import pytest
from scipy.stats import norm
from tiny_equation import CUBE, tiny_data, tiny_near, tiny_study_of

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.where import (
    LEAST_WINDOW,
    MAP_POINTS,
    MOST_REGIONS,
    MOST_SEARCHED,
    MOST_WINDOWS,
    Along,
    Gap,
    GapTrace,
    _rules,
    exceedance,
    gap_map,
    gap_trace,
    where_table,
)

N = 2000


def square(n=N, seed=0, **units):
    """Rows spread evenly over a square of y and v, in one run."""
    rng = np.random.default_rng(seed)
    y, v = rng.uniform(-1, 1, n), rng.uniform(-1, 1, n)
    return Trajectories.from_arrays(0.5 * np.arange(n), states={"y": y, "v": v}, units=units)


def positive():
    """Rows spread evenly over 0 < y < 1."""
    y = np.random.default_rng(0).uniform(0, 1, N)
    return Trajectories.from_arrays(0.5 * np.arange(N), states={"y": y})


def table(data, inside, gap=None, variables=("y", "v")):
    """Regions and windows where the probability is 0.98 inside and 0.02 elsewhere."""
    p = np.where(inside, 0.98, 0.02)
    gap = np.where(inside, 1.0, 0.0) if gap is None else gap
    sd = np.full(len(p), 0.01)
    trace = GapTrace("v", data.time, data.run, gap, sd, 0 * gap, sd, p, 0.1, "")
    return where_table(data, along(data), variables, trace)


def along(data):
    """All rows of data."""
    return Along("v", data.time, data.run, data.columns)


def regions(data, inside, **given):
    return table(data, inside, **given).query("kind == 'region'").reset_index(drop=True)


def cut(text):
    """The number in a rule such as |y| > 0.6 m."""
    return float(text.split()[2])


# Probability


def test_the_probability_is_that_of_the_likelier_tail_of_the_normal():
    mean, sd = np.array([0.0, 0.5, -2.0, 1.0]), np.array([1.0, 0.2, 0.7, 3.0])
    expected = np.maximum(norm.sf(1.0, mean, sd), norm.cdf(-1.0, mean, sd))
    np.testing.assert_allclose(exceedance(mean, sd, 1.0), expected, rtol=1e-12)


def test_a_gap_of_which_nothing_is_known_is_nowhere():
    assert exceedance(np.zeros(1), np.full(1, 50.0), 1.0) < 0.5


def test_a_gap_that_is_known_exactly_exceeds_the_threshold_or_not():
    np.testing.assert_array_equal(exceedance(np.array([0.9, 1.1, -1.1]), np.zeros(3), 1.0), [0.0, 1.0, 1.0])


# Regions


@pytest.mark.parametrize(
    ("rule", "start"),
    [
        (lambda y, v: np.abs(y) > 0.6, "|y| >"),
        (lambda y, v: np.abs(y) < 0.6, "|y| <"),
        (lambda y, v: v > 0.6, "v >"),
        (lambda y, v: v < 0.6, "v <"),
    ],
)
def test_a_region_has_the_rule_that_bounds_the_gap(rule, start):
    data = square()
    found = regions(data, rule(*data.states.values()))
    assert len(found) == 1 and found["description"][0].startswith(start)
    # Cuts are 5 % of the rows apart: 0.05 of |y|, 0.1 of v; the gap may end half-way between two.
    assert cut(found["description"][0]) == pytest.approx(0.6, abs=0.06)


def test_a_region_may_be_a_band():
    data = square()
    found = regions(data, (data.states["v"] > 0.2) & (data.states["v"] < 0.6))["description"]
    low, _, name, _, high = found[0].split()
    assert name == "v" and float(low) == pytest.approx(0.2, abs=0.11) and float(high) == pytest.approx(0.6, abs=0.11)


def test_a_region_may_be_a_corner_of_two_variables():
    data = square()
    (text,) = regions(data, (data.states["y"] > -0.4) & (data.states["v"] < 0.2))["description"]
    assert sorted(part.split()[:2] for part in text.split(" and ")) == [["v", "<"], ["y", ">"]]


def test_a_corner_that_neither_variable_alone_gains_from_is_not_found():
    data = square()
    assert regions(data, (data.states["y"] > 0.2) & (data.states["v"] < -0.2)).empty


def test_a_second_variable_is_named_only_where_it_gains_something():
    data = square()
    (text,) = regions(data, np.abs(data.states["y"]) > 0.6)["description"]
    assert " and " not in text


def test_two_separate_regions_are_both_found_and_share_no_row():
    data = positive()
    y = data.states["y"]
    found = regions(data, (y < 0.25) | ((y > 0.45) & (y < 0.65)), variables=("y",))
    assert len(found) == 2
    assert found["gap_share"].sum() == pytest.approx(1.0, abs=0.06)
    assert found["sample_share"].sum() == pytest.approx(0.45, abs=0.06)


def test_rows_of_a_region_are_not_counted_again_in_one_that_crosses_it():
    data = square()
    y, v = data.states.values()
    # Of v > 0.6, a fifth of the rows, two in five are in the first region already.
    found = regions(data, (np.abs(y) > 0.6) | (v > 0.6))
    assert [text[:3] for text in found["description"]] == ["|y|", "v >"]
    assert found["sample_share"].to_list() == pytest.approx([0.4, 0.12], abs=0.05)


def test_a_gap_in_most_places_is_everywhere():
    data = square()
    found = regions(data, np.ones(N, bool))
    assert found["description"].tolist() == ["everywhere"]
    assert found["gap_share"][0] == pytest.approx(1.0) and found["sample_share"][0] == pytest.approx(1.0)


def test_a_gap_in_most_places_is_not_everywhere_where_a_rule_tells_it_better():
    data = square()
    (text,) = regions(data, data.states["y"] > -0.8)["description"]
    assert text.startswith("y >")


def test_without_a_gap_there_is_no_region_and_no_window():
    data = square()
    assert table(data, np.zeros(N, bool), gap=np.full(N, 1e-3)).empty


def test_a_gap_on_a_few_rows_is_no_region():
    data = square()
    # A rule must gain two rows in a hundred; these are one.
    assert regions(data, data.states["y"] > 0.98).empty


def test_there_are_never_more_regions_than_a_reader_wants():
    data = positive()
    # Five bands, as wide as the coarsest cuts are apart.
    found = regions(data, np.floor(10 * data.states["y"] - 0.5) % 2 == 0, variables=("y",))
    assert len(found) == MOST_REGIONS


def test_variables_that_never_change_sign_have_no_rule_on_their_size():
    y = np.linspace(-1, 1, 99)
    assert any(text.startswith("|y|") for text, _ in _rules("y", y, ""))
    assert not any(text.startswith("|y|") for text, _ in _rules("y", y + 1, ""))


def test_rules_have_the_unit_of_their_variable_but_for_plain_numbers():
    metres, plain = square(y="m"), square(y="1")
    inside = np.abs(metres.states["y"]) > 0.6
    assert regions(metres, inside)["description"][0].endswith(" m")
    assert len(regions(plain, inside)["description"][0].split()) == 3


def test_shares_are_of_the_gaps_square_and_of_the_rows():
    data = square()
    inside = np.abs(data.states["y"]) > 0.6
    found = regions(data, inside, gap=np.where(inside, 2.0, 1.0))
    within = np.abs(data.states["y"]) > cut(found["description"][0])
    gap = np.where(inside, 4.0, 1.0)
    # The cut is told with three digits, so a row or two may fall on either side.
    assert found["gap_share"][0] == pytest.approx(gap[within].sum() / gap.sum(), abs=0.005)
    assert found["sample_share"][0] == pytest.approx(within.mean(), abs=0.002)
    assert found["probability"][0] == pytest.approx(np.where(inside, 0.98, 0.02)[within].mean(), abs=0.005)


def test_the_region_with_the_largest_share_of_the_gap_comes_first():
    data = positive()
    y = data.states["y"]
    wide, strong = y < 0.3, y > 0.8
    found = regions(data, wide | strong, gap=np.where(strong, 5.0, np.where(wide, 1.0, 0.0)), variables=("y",))
    # The region of more rows is found first, and that of more of the gap is told first.
    assert [text[:3] for text in found["description"]] == ["y >", "y <"]
    assert found["sample_share"][0] < found["sample_share"][1]


# Windows

ROWS = 400
WIDTH = ROWS // LEAST_WINDOW
"""Shortest window, in rows."""


def windows(*spans, runs=1, names=None):
    """Windows where the gap is in these rows of each run of 400."""
    rng = np.random.default_rng(0)
    t, y = [0.5 * np.arange(ROWS)] * runs, [rng.uniform(-1, 1, ROWS) for _ in range(runs)]
    data = Trajectories.from_arrays(t, states={"y": y, "v": y}, units={"t": "s"}, run_names=names)
    inside = np.zeros(runs * ROWS, bool)
    for start, stop in spans:
        inside[start:stop] = True
    found = table(data, inside, variables=("y",))
    return found.query("kind == 'window'").reset_index(drop=True)


def ends(text):
    words = text.replace(",", "").split()
    return float(words[2]), float(words[4])


def test_a_window_is_where_the_gap_is():
    (text,) = windows((100, 200))["description"]
    # Smoothing may move its ends by a row.
    assert ends(text) == pytest.approx((50.0, 99.5), abs=0.6) and text.endswith(" s")


@pytest.mark.parametrize(("rows", "count"), [(WIDTH // 3, 0), (WIDTH - 2, 0), (WIDTH + 3, 1)])
def test_a_burst_shorter_than_the_shortest_window_is_none(rows, count):
    assert len(windows((100, 100 + rows))) == count


@pytest.mark.parametrize(("apart", "count"), [(WIDTH - 3, 1), (WIDTH + 3, 2)])
def test_windows_are_merged_across_a_short_pause(apart, count):
    assert len(windows((100, 150), (150 + apart, 200 + apart))) == count


def test_a_window_ends_with_its_run():
    found = windows((ROWS - 100, ROWS + 100), runs=2)
    assert sorted(ends(text) for text in found["description"]) == [
        pytest.approx((0.0, 49.5), abs=1.6),
        pytest.approx((150.0, 199.5), abs=2.6),
    ]


def test_a_window_names_its_run_where_there_are_several():
    found = windows((ROWS + 100, ROWS + 200), runs=2, names=["slow", "fast"])
    assert found["description"][0].endswith(", run fast")
    assert "run" not in windows((100, 200))["description"][0]


def test_shares_of_a_window_are_of_all_runs():
    found = windows((ROWS + 100, ROWS + 200), runs=2)
    assert found["sample_share"][0] == pytest.approx(1 / 8, abs=0.003) and found["gap_share"][0] > 0.97


def test_there_are_never_more_windows_than_a_reader_wants():
    starts = range(0, ROWS, 5 * WIDTH)
    assert len(starts) > MOST_WINDOWS
    assert len(windows(*((a, a + 2 * WIDTH) for a in starts))) == MOST_WINDOWS


# The gap over states and along time


def with_input(n=400):
    rng = np.random.default_rng(0)
    return Trajectories.from_arrays(
        np.arange(float(n)),
        states={"y": rng.uniform(-1, 2, n)},
        inputs={"u": rng.uniform(0, 3, n)},
        units={"y": "m"},
    )


def known(data, value, sd=0.1):
    """A gap that is known up to so much."""
    return Gap(value, np.full(data.n_obs, sd))


def mapped(data, value, variables):
    return gap_map(data, along(data), known(data, value), known(data, 0 * value), variables, 0.5, "")


def test_a_map_spans_the_data_and_has_the_mean_over_cells():
    data = with_input()
    y = data.states["y"]
    found = mapped(data, np.sin(y), ("y",))
    np.testing.assert_allclose(found.axes[0], np.linspace(y.min(), y.max(), MAP_POINTS))
    # A cell is a twentieth of the range wide, and one-sided at the ends.
    np.testing.assert_allclose(found.before, np.sin(found.axes[0]), atol=0.15)
    np.testing.assert_allclose(found.before[3:-3], np.sin(found.axes[0][3:-3]), atol=0.05)
    np.testing.assert_allclose(found.after, 0.0)


def test_a_map_of_two_variables_has_the_first_along_its_rows():
    data = with_input(3000)
    y, u = data.states["y"], data.inputs["u"]
    found = mapped(data, y * u, ("y", "u"))
    inside = (slice(4, -4), slice(4, -4))
    np.testing.assert_allclose(found.before[inside], np.outer(*found.axes)[inside], atol=0.3)
    np.testing.assert_allclose(found.probability, exceedance(found.before, np.full((MAP_POINTS, MAP_POINTS), 0.1), 0.5))
    assert found.samples.shape == (3000, 2) and found.units == ("m", "")


def test_where_no_sample_is_near_the_nearest_speaks():
    t = np.arange(2.0)
    data = Trajectories.from_arrays(t, states={"y": np.array([0.0, 1.0])})
    found = mapped(data, np.array([3.0, 7.0]), ("y",))
    assert np.all(np.isfinite(found.before)) and set(np.round(found.before[[0, 15, -16, -1]], 6)) == {3.0, 7.0}


def test_a_trace_of_a_long_record_is_thinned_evenly_from_its_first_row_to_its_last():
    data = with_input(MOST_SEARCHED + 123)
    gap = known(data, data.states["y"])
    found = gap_trace(along(data), gap, gap, 0.5, "")
    assert len(found.time) == len(found.before) == MOST_SEARCHED
    assert found.time[0] == data.time[0] and found.time[-1] == data.time[-1]
    assert set(np.diff(found.time)) == {1.0, 2.0}


def test_a_trace_of_a_short_record_has_all_its_rows():
    data = with_input(50)
    value = data.states["y"] * data.inputs["u"]
    found = gap_trace(along(data), known(data, value), known(data, 0.5 * value, 0.2), 0.5, "")
    np.testing.assert_array_equal(found.before, value)
    np.testing.assert_array_equal(found.after, 0.5 * value)
    assert set(found.before_sd) == {0.1} and set(found.after_sd) == {0.2}
    np.testing.assert_allclose(found.probability, exceedance(value, np.full(50, 0.1), 0.5))


def test_the_gap_is_that_of_the_model_before_and_what_is_left_with_an_effect_that_was_added():
    """Along a motion: a force in time is as smooth as that."""
    n, step = 300, 0.05
    t = step * np.arange(n)
    x = np.sin(1.3 * t) + 0.5 * np.sin(0.7 * t)
    rate = -x - (x**3) + 0.05 * np.random.default_rng(0).standard_normal(n)
    study = tiny_study_of([CUBE], Trajectories.from_arrays(t, states={"x": x}, derivatives={"x": rate}))
    trace = study.trace
    z = (trace.before + x**3) / trace.before_sd
    # Root mean square of 300 z-scores that hang together.
    assert np.sqrt(np.mean(z**2)) < 2 and np.median(trace.before_sd) < 0.05
    assert np.std(trace.after) < 0.1 * np.std(trace.before)
    # The truth is 0.05, estimated to 4 %; four of them.
    assert trace.threshold == study.map.threshold == pytest.approx(0.05, rel=0.16)
    at = study.map.axes[0]
    np.testing.assert_allclose(study.map.before[4:-4], -(at[4:-4] ** 3), atol=0.25)


def test_what_free_terms_can_say_is_no_gap():
    near = tiny_near([], lambda x: 0.8 * np.sin(3 * x), dictionary={"x": ["sin(3*x)"]})
    mean, _ = near.weighed.latent_force(near.weighed.before)
    x = tiny_data().states["x"]
    (free,) = near.weighed.before.mean * near.in_units(near.weighed.before)
    assert free == pytest.approx(0.8, abs=0.1)
    assert np.sqrt(np.mean(mean**2)) * near.regressors.target_scale < 0.2 * np.sqrt(np.mean((0.8 * np.sin(3 * x)) ** 2))
