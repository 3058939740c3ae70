import os

import numpy as np
import pandas as pd
import pytest

import bayes_greybox as bg
from bayes_greybox.data.trajectories import Trajectories

H = 0.01
T = np.arange(4_000) * H
SLOW, FAST = 2 * np.pi * 0.3, 2 * np.pi * 23.0


def two_runs(fast=0.0, **changes):
    times = [T, T[:1_500]]
    y = [np.sin(SLOW * t) + fast * np.sin(FAST * t) for t in times]
    settings = {"states": {"y": y}, "outputs": {"R": [np.cos(t) for t in times]}}
    return Trajectories.from_arrays(times, **{**settings, "run_names": ["long", "short"], **changes})


def test_resampling_follows_every_run_and_says_how():
    rng = np.random.default_rng(0)
    times = [T[::4][:n] + rng.uniform(-0.01, 0.01, n) for n in (900, 300)]
    data = Trajectories.from_arrays(times, states={"y": [np.sin(t) for t in times]}, inputs={"F": times})
    even = data.resample(0.05)
    assert even.run_names == data.run_names and data.remarks == ()
    for run, time in enumerate(times):
        part = even.take(run)
        np.testing.assert_allclose(part.time, time[0] + 0.05 * np.arange(part.n_obs), rtol=1e-14)
        assert time[-1] - 0.05 < part.time[-1] <= time[-1]
        # Error of a cubic spline: 5/384 of the fourth power of the longest step.
        np.testing.assert_allclose(part.states["y"], np.sin(part.time), atol=5 / 384 * 0.06**4 * 2)
        np.testing.assert_allclose(part.inputs["F"], part.time, atol=1e-12)
    assert f"resampled every 0.05 by a cubic spline through the samples of each run: 1200 rows to {even.n_obs}" in repr(
        even
    )
    even.differentiate(rates={"y": "v"})


@pytest.mark.parametrize(("method", "value"), [("linear", 2.0), ("held", 1.0)])
def test_other_ways_between_samples(method, value):
    data = Trajectories.from_arrays([0.0, 1.0, 2.0, 3.0], states={"y": [1.0, 3.0, 2.0, 5.0]}).resample(0.5, method)
    assert data.n_obs == 7 and data.states["y"][1] == value and data.states["y"][-1] == 5.0


def test_decimation_keeps_the_slow_in_phase_and_the_fast_out():
    data = two_runs(fast=1.0).decimate(10)
    assert data.run_lengths == (400 - 20, 150 - 20) and data.dropped == 40
    np.testing.assert_allclose(data.take("short").time, T[100:1_400:10], rtol=1e-14)
    # Every tenth sample alone would show 23 Hz as 3 Hz. Hamming's window leaves ripples of 53 dB, 2.2e-3.
    np.testing.assert_allclose(data.states["y"], np.sin(SLOW * data.time), atol=2 * 2.2e-3)
    np.testing.assert_allclose(data.rate("R"), np.cos(data.time), atol=2.2e-3)
    aliased = two_runs(fast=1.0).take("long").states["y"][::10]
    assert np.max(np.abs(aliased - np.sin(SLOW * T[::10]))) > 0.5
    assert "decimated by 10 behind a symmetric low pass" in repr(data) and "5500 rows to 510" in repr(data)


def test_trimming_and_dropping_leave_the_other_rows_as_they_are():
    data = two_runs()
    part = data.trim(10.0, 20.0)
    assert part.run_names == ("long", "short") and part.run_lengths == (1_001, 500)
    assert data.trim(-np.inf, 20.0).run_lengths == data.trim(end=20.0).run_lengths
    assert data.trim(start=15.0).run_names == ("long",)
    assert "trimmed to times from 10 to 20: 5500 rows to 1501" in repr(part)
    fewer = part.drop([0, -1])
    np.testing.assert_array_equal(fewer.time, part.time[1:-1])
    pd.testing.assert_frame_equal(part.drop(slice(0, 5)).to_frame(), part.drop(np.arange(1_501) < 5).to_frame())
    assert fewer.dropped == 2 and fewer.remarks == (*part.remarks, "2 of 1501 rows dropped on request")
    assert part.drop([]) is part
    back = Trajectories.from_frame(fewer.to_frame(), **fewer.metadata())
    assert back.remarks == fewer.remarks


def test_a_band_that_a_record_shows_many_times_over_is_the_same_behind_decimation():
    """What a narrow band on many rows costs, decimation saves: the rates agree."""
    data = two_runs()
    slow, few = (d.take("long").differentiate("bandlimited", band=1.0) for d in (data, data.decimate(10)))
    common, i, j = np.intersect1d(np.round(slow.time, 6), np.round(few.time, 6), return_indices=True)
    assert len(common) > 100
    np.testing.assert_allclose(slow.rate("y")[i], few.rate("y")[j], atol=SLOW * 2 * 2.2e-3)
    assert f"differentiated by bandlimited, window {few.filter.window}, band 1: 380 rows to" in repr(few)


BAD = {
    "alias": (lambda d: d.resample(0.05), r"Resample it at 0\.01 first, then data\.decimate\(5\)"),
    "step": (lambda d: d.resample(0.0), "step must be positive"),
    "endless step": (lambda d: d.resample(np.inf), "step must be positive and a number, not inf"),
    "limit of no rows": (lambda d: d.drop(slice("a")), "names no rows"),
    "gap": (lambda d: d.drop(slice(100, 120)).resample(0.01), r'"long" has a gap from 0\.99 to 1\.2.*data\.trim'),
    "factor": (lambda d: d.decimate(1), "factor must be a whole number, 2 or more, not 1"),
    "short": (lambda d: d.decimate(100), 'Run "short" has 1500 rows: by 100 fewer than two'),
    "uneven": (lambda d: d.drop([7]).decimate(2), r"not sampled evenly.*data\.resample\(0\.01\)"),
    "filtered": (lambda d: d.differentiate(window=5).decimate(2), "decimate before differentiate"),
    "no limit": (lambda d: d.trim(), "trim needs start, end or both"),
    "beyond": (lambda d: d.trim(100.0), "No row lies between 100.0 and None: .* from 0 to 39.99"),
    "no row": (lambda d: d.drop([5_500]), "There is no row 5500; the data have 5500, from 0 to 5499"),
    "all rows": (lambda d: d.drop(slice(None)), "No row is left"),
    "wrong mask": (lambda d: d.drop(np.ones(3, bool)), "rows has 3 truth values, but the data have 5500 rows"),
    "kept by a wrong mask": (lambda d: d.keep(np.ones(3, bool)), "rows has 3 truth values"),
    "one row": (lambda d: d.trim(0.0, 0.0).decimate(2), "has 1 rows: by 2 fewer than two would be left"),
    "words": (lambda d: d.drop(["a"]), "rows must be numbers of rows"),
}


@pytest.mark.parametrize("make, words", BAD.values(), ids=BAD.keys())
def test_what_cannot_be_done_is_said_with_what_can(make, words):
    with pytest.raises(bg.InputError, match=words):
        make(two_runs())


@pytest.mark.skipif(os.environ.get("BAYES_GREYBOX_TYPECHECK", "0") == "1", reason="the checker of types answers first")
def test_a_way_between_samples_that_there_is_not():
    with pytest.raises(bg.InputError, match='method must be "cubic", "linear" or "held"'):
        two_runs().resample(0.01, "quartic")
    with pytest.raises(bg.InputError, match="step must be positive and a number, not '0.1'"):
        two_runs().resample("0.1")
    with pytest.raises(bg.InputError, match="start must be a number, in the unit of the time, not '1'"):
        two_runs().trim("1")


@pytest.mark.parametrize(("start", "step"), [(1.0, 0.02), (0.3, 0.05), (1.7e9, 0.01)])
def test_held_columns_at_their_own_times_are_themselves(start, step):
    t = start + step * np.arange(500)
    u = (np.arange(500) // 7 % 2).astype(float)
    data = bg.Trajectories.from_arrays(t, states={"y": np.sin(t)}, inputs={"u": u})
    again = data.resample(step, "held")
    assert again.n_obs == 500
    np.testing.assert_array_equal(again.inputs["u"], u)


def test_rows_are_kept_by_their_numbers_as_they_are_dropped():
    data = bg.Trajectories.from_arrays(np.arange(10.0), states={"y": np.arange(10.0) ** 2})
    mask = (np.arange(10) < 4).tolist()
    for rows in (mask, [0, 1, 2, 3], slice(4), np.array(mask)):
        kept = data.keep(rows)
        np.testing.assert_array_equal(kept.time, [0, 1, 2, 3])
        assert kept.dropped == 6
    assert data.keep(np.arange(10)) is data


def test_the_row_that_there_is_not_is_named():
    data = bg.Trajectories.from_arrays(np.arange(10.0), states={"y": np.arange(10.0)})
    with pytest.raises(bg.InputError, match="no row -50"):
        data.drop([-50, 3])
