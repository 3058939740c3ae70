"""Runs that begin anew where their inputs are not known."""

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.data.runs.gaps import FEWEST_PART_ROWS, after_gaps


def test_rows_after_gaps():
    even = np.arange(100) * 0.1
    assert after_gaps(even) == []
    assert after_gaps(np.delete(even, slice(40, 60))) == [40]
    assert after_gaps(np.array([0.0])) == []
    # A few samples that were dropped are no gap, nor are stamps that are uneven all along.
    assert after_gaps(np.delete(even, [40, 41, 42])) == []
    assert after_gaps(np.cumsum(np.random.default_rng(0).exponential(size=2000))) == []


def with_gap(cut: slice, **more) -> bg.Trajectories:
    t = np.delete(np.arange(400) * 0.05, cut)
    return bg.Trajectories.from_arrays(t, states={"y": np.sin(t)}, **more)


def test_a_run_begins_anew_after_a_gap_in_its_inputs():
    t = np.delete(np.arange(400) * 0.05, slice(200, 260))
    data = with_gap(slice(200, 260), inputs={"u": np.cos(3 * t)}, run_names=["rig"])
    assert data.run_names == ("rig", "rig, part 2")
    assert data.run_lengths == (200, 140)
    assert 'run "rig" has no rows from 9.95 to 13: it begins anew after them' in repr(data)
    np.testing.assert_array_equal(data.time, t)
    # It is said once, and what is read again is as it was.
    again = bg.Trajectories.from_frame(data.to_frame(), **data.metadata())
    assert again.run_names == data.run_names and again.remarks == data.remarks


@pytest.mark.parametrize("measured", ["derivatives", "outputs"])
def test_rows_that_stand_for_themselves_are_not_parted(measured):
    t = np.delete(np.arange(400) * 0.05, slice(200, 260))
    own = {"derivatives": {"y": np.cos(t)}} if measured == "derivatives" else {"outputs": {"F": np.cos(t)}}
    assert with_gap(slice(200, 260), inputs={"u": np.cos(3 * t)}, **own).n_run == 1
    assert with_gap(slice(200, 260)).n_run == 1, "nothing drives it in the gap but what its equations say"


@pytest.mark.parametrize(
    "cut", [slice(FEWEST_PART_ROWS - 1, 100), slice(300, 400 - FEWEST_PART_ROWS + 1)], ids=["before", "after"]
)
def test_a_part_of_a_few_rows_stays(cut):
    t = np.delete(np.arange(400) * 0.05, cut)
    data = with_gap(cut, inputs={"u": np.cos(3 * t)})
    assert data.n_run == 1 and "its inputs are taken across" in repr(data), "and it is said"


def test_a_change_of_spacing_is_no_gap():
    t = np.concatenate([np.arange(1000) * 0.01, 10 + np.arange(60.0)])
    data = bg.Trajectories.from_arrays(t, states={"y": np.sin(t)}, inputs={"u": np.cos(t)})
    assert data.n_run == 1 and not data.remarks


def test_parts_of_runs_at_late_stamps_have_names_of_their_own():
    t = 1.764086e9 + np.delete(np.arange(400) * 0.05, np.r_[100:160, 250:300])
    columns = {"states": {"y": [np.sin(t), np.sin(t)]}, "inputs": {"u": [np.cos(t), np.cos(t)]}}
    data = bg.Trajectories.from_arrays([t, t], run_names=["a", "a, part 2"], **columns)
    assert data.n_run == 6 and len(set(data.run_names)) == 6
    again = bg.Trajectories.from_frame(data.to_frame(), **data.metadata())
    assert again.run_names == data.run_names and again.take(data.run_names[-1]).n_obs == data.run_lengths[-1]


def test_a_table_with_a_gap_says_that_it_was_parted(tmp_path):
    rows = [f"{0.05 * k:.2f},{np.sin(0.05 * k)},{np.cos(0.15 * k)}" for k in range(400) if not 200 <= k < 260]
    path = tmp_path / "rig.csv"
    path.write_text("\n".join(["t,y,u", *rows]))
    data = bg.read(path, time="t", states=["y"], inputs=["u"])
    assert data.n_run == 2 and any("begins anew" in remark for remark in data.remarks)
