"""Inputs of one table stand beside the measurements of another, at the measurements' times."""

import numpy as np
import pandas as pd
import pytest

import bayes_greybox as bg

INPUTS = {"t": [0.0, 1.0, 2.0, 3.0], "F": [0.0, 10.0, 20.0, 0.0]}


def measured(t):
    return {"t": t, "x": np.arange(len(t)) + 1.0}


def test_lines_between_samples_and_nothing_beyond_them():
    table = bg.join(INPUTS, measured([-0.5, 0.25, 1.0, 2.5, 3.0, 3.1]), time="t")
    np.testing.assert_allclose(table["F"], [np.nan, 2.5, 10.0, 10.0, 0.0, np.nan])
    assert list(table) == ["t", "x", "F"] and table["x"].tolist() == [1, 2, 3, 4, 5, 6]


def test_a_command_is_held_up_to_the_next_and_the_last_one_on():
    table = bg.join(INPUTS, measured([-0.5, 0.25, 1.0, 2.5, 9.0]), time="t", how="hold")
    np.testing.assert_allclose(table["F"], [np.nan, 0.0, 10.0, 20.0, 0.0])
    once = bg.join({"t": [1.0], "F": [7.0]}, measured([0.0, 1.0, 2.0]), time="t", how="hold")
    np.testing.assert_allclose(once["F"], [np.nan, 7.0, 7.0])


def test_the_offset_is_what_the_first_clock_shows_at_the_seconds_zero():
    late = {**INPUTS, "t": [12.5, 13.5, 14.5, 15.5]}
    table = bg.join(late, measured([0.0, 0.5, 2.0]), time="t", offset=12.5)
    np.testing.assert_allclose(table["F"], [0.0, 5.0, 20.0])


def test_a_line_through_a_gap_is_no_input():
    t = [0.0, 1.0, 2.0, 3.0, 9.0, 10.0]
    table = bg.join({"t": t, "F": t}, measured([2.5, 3.0, 5.0, 9.0, 9.5]), time="t")
    np.testing.assert_allclose(table["F"], [2.5, 3.0, np.nan, 9.0, 9.5])


def test_dates_are_compared_as_dates_and_units_are_kept(tmp_path):
    (tmp_path / "plc.csv").write_text(
        "when,F [N]\n2024-03-25 10:00:00,0\n2024-03-25 10:00:10,100\n2024-03-25 10:00:20,0\n"
    )
    (tmp_path / "camera.csv").write_text("stamp,x (mm)\n2024-03-25 10:00:05,1\n2024-03-25 10:00:12.5,2\n")
    table = bg.join(tmp_path / "plc.csv", tmp_path / "camera.csv", time=("when", "stamp"))
    data = bg.read(table, time="stamp", states=["x"], inputs=["F"])
    np.testing.assert_allclose(data.inputs["F"], [50.0, 75.0])
    np.testing.assert_allclose(data.time, [0.0, 7.5])
    assert data.unit("F") == "N" and data.unit("x") == "mm"


def test_each_run_has_its_own_inputs():
    inputs = pd.DataFrame({"t": [0, 1, 0, 1.0], "F": [0, 1, 10, 20.0], "trial": ["a", "a", "b", "b"]})
    rows = pd.DataFrame({"t": [0.5, 0.5], "x": [1.0, 2.0], "trial": ["b", "a"]})
    assert bg.join(inputs, rows, time="t", run="trial")["F"].tolist() == [15.0, 0.5]
    with pytest.raises(bg.InputError, match='no inputs of run "c"'):
        bg.join(inputs, rows.assign(trial="c"), time="t", run="trial")


def test_rows_without_inputs_are_counted_where_they_are_left_out():
    table = bg.join(INPUTS, measured(np.arange(-1.0, 3.1, 0.25)), time="t")
    data = bg.read(table, time="t", states=["x"], inputs=["F"], missing="drop")
    assert data.dropped == 4 and data.n_obs == 13


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"how": "cubic"}, 'how must be "linear" or "hold"'),
        ({"offset": np.nan}, "offset must be a number"),
        ({"time": ("a", "b", "c")}, "one for each of the two tables"),
        ({"time": "T"}, 'no column "T"'),
        ({"offset": 100.0}, "No row of the table lies within the record.*give offset="),
    ],
)
def test_what_cannot_be_joined_is_refused(asked, words):
    with pytest.raises(bg.InputError, match=words):
        bg.join(INPUTS, measured([0.0, 1.0]), **{"time": "t", **asked})


def test_two_columns_of_one_name_and_times_that_do_not_compare_are_refused():
    with pytest.raises(bg.InputError, match='Both tables have a column "x"'):
        bg.join({"t": [0.0, 1.0], "x": [0.0, 1.0]}, measured([0.0, 1.0]), time="t")
    with pytest.raises(bg.InputError, match="does not go forward after 2"):
        bg.join({"t": [0.0, 2.0, 1.0], "F": [0.0, 1.0, 2.0]}, measured([0.0, 1.0]), time="t")
    dated = {"t": ["2024-03-25 10:00:00", "2024-03-25 10:00:01"], "F": [0.0, 1.0]}
    with pytest.raises(bg.InputError, match="dates in only one of them"):
        bg.join(dated, measured([0.0, 1.0]), time="t")
    with pytest.raises(bg.InputError, match="are in ms and in s: convert one"):
        bg.join({"t [ms]": [0.0, 1.0], "F": [0.0, 1.0]}, {"t [s]": [0.0, 1.0], "x": [1.0, 2.0]}, time="t")
