"""Columns of time as instruments write them: dates with zones and fractions, counts of nanoseconds, summer time."""

import numpy as np
import pandas as pd
import pytest

import bayes_greybox as bg
from bayes_greybox.config.starting.starter import starter
from bayes_greybox.data.errors import InputError
from bayes_greybox.data.reading.door import layout_of

N = 40
EPOCH = 1_700_000_000_000_000_001
"""In nanoseconds: an odd number, and no float."""

ASKED = {"time": "t", "states": ["y"]}


def table(t, **columns):
    return pd.DataFrame({"t": t, "y": np.sin(0.3 * np.arange(len(t))), **columns})


def test_dates_of_an_unnamed_index_are_the_time_of_a_first_configuration(tmp_path):
    path = tmp_path / "run.parquet"
    days = pd.date_range("2024-03-05", periods=N, freq="h")
    table(np.arange(N)).drop(columns="t").set_axis(days).to_parquet(path)
    text = starter(path, tmp_path / "run.toml", layout_of()).text
    assert 'time = "index"' in text and "dt = " not in text
    # What counts is still no time.
    counted = tmp_path / "run.csv"
    table(np.arange(N)).rename(columns={"t": "index"}).to_csv(counted, index=False)
    text = starter(counted, tmp_path / "run2.toml", layout_of()).text
    assert "dt = 1.0" in text and "counts the rows" in text


@pytest.mark.parametrize("zone", ["+02:00", "Z", "+0200", ""])
def test_fractions_that_are_left_out_where_they_are_zero_may_have_a_zone_behind_them(zone):
    seconds = [f"{i // 2:02d}" + (".500000" if i % 2 else "") for i in range(N)]
    stamps = [f"2024-03-05T08:15:{second}{zone}" for second in seconds]
    np.testing.assert_allclose(bg.read(table(stamps), **ASKED).time, 0.5 * np.arange(N))
    german = [f"05.03.2024 08:15:{second}" for second in seconds]
    np.testing.assert_allclose(bg.read(table(german), **ASKED, dayfirst=True).time, 0.5 * np.arange(N))


def test_stamps_of_which_some_lack_their_zone_are_refused():
    stamps = ["2024-06-01T12:00:00+02:00", "2024-06-01T12:00:01", "2024-06-01T14:00:02+02:00"]
    with pytest.raises(InputError, match=r"with a time zone and without one, as '2024-06-01T12:00:01' in row 1: write"):
        bg.read(table(stamps), **ASKED)
    # Days have none, whatever stands before their last number.
    np.testing.assert_array_equal(bg.read(table(["2024-06-01", "2024-06-02"]), **ASKED).time, [0, 86400])


@pytest.mark.parametrize("form", ["%Y-%m-%d %H:%M:%S", "%d.%m.%Y %H:%M", "%d.%m.%y"])
def test_a_day_that_does_not_exist_is_named_and_not_the_first_row(form):
    stamps = list(pd.date_range("2024-02-20", periods=9, freq="D").strftime(form))
    stamps[4] = stamps[4].replace("24", "31", 1) if form.startswith("%d") else stamps[4].replace("-24", "-31")
    with pytest.raises(InputError, match=f"neither numbers nor dates: row 4 holds '{stamps[4]}'"):
        bg.read(table(stamps), **ASKED, dayfirst=True)


@pytest.mark.parametrize("kind", ["frame", "csv", "missing"])
def test_nanoseconds_keep_their_digits(tmp_path, kind):
    t = EPOCH + 100 * np.arange(N, dtype=np.int64)
    source = table(t)
    if kind == "csv":
        source.to_csv(tmp_path / "run.csv", index=False)
        source = tmp_path / "run.csv"
    if kind == "missing":
        source["t"] = pd.array([None, *t[1:]], dtype="Int64")
    data = bg.read(source, **ASKED, missing="drop")
    np.testing.assert_array_equal(np.diff(data.time), 100.0)
    assert "more digits than a float holds, counts from the first, 1700000000" in "\n".join(data.remarks)


def test_nanoseconds_of_each_run_count_from_its_first():
    t = EPOCH + 100 * np.arange(N, dtype=np.int64)
    frame = pd.concat([table(t, run=0), table(t + 10**15, run=1)])
    data = bg.read(frame, **ASKED, run="run")
    for i in range(2):
        np.testing.assert_array_equal(data.take(i).time, 100.0 * np.arange(N))
    given = bg.Trajectories.from_arrays([t, t + 10**15], states={"y": [np.sin(t - t[0]), np.cos(t - t[0])]})
    np.testing.assert_array_equal(given.time, data.time)
    assert "counts from its first stamp, 1700000000000000001" in given.remarks[0]


def test_whole_numbers_that_are_no_time_are_refused_where_they_would_lose_digits():
    long = table(np.arange(N), count=EPOCH + np.arange(N))
    with pytest.raises(InputError, match='"count" of the table holds whole numbers of more digits.*subtract'):
        bg.read(long, **ASKED, inputs=["count"])
    with pytest.raises(InputError, match='state "n" of run "0" holds whole numbers of more digits.*subtract'):
        bg.Trajectories.from_arrays(np.arange(N), states={"n": long["count"]})
    # Those that floats hold stay what they are.
    held = bg.read(table(2**54 + 4 * np.arange(N)), **ASKED)
    assert held.time[0] == 2**54 and not held.remarks


def test_streams_keep_digits_within_runs_and_refuse_to_lose_them_elsewhere(tmp_path):
    t = EPOCH + 100 * np.arange(N, dtype=np.int64)
    path = tmp_path / "run.parquet"
    table(t, v=np.cos(0.3 * np.arange(N))).to_parquet(path)
    np.testing.assert_array_equal(np.diff(bg.stream(path, **ASKED).whole_runs().sample.time), 100.0)
    rates = bg.stream(path, **ASKED, derivatives={"y": "v"})
    with pytest.raises(InputError, match='"t" of .*whole numbers of more digits.*give them less the first'):
        rates.sample  # noqa: B018
