"""Columns of time as instruments write them: dates with zones and fractions, counts of nanoseconds, summer time."""

import numpy as np
import pandas as pd
import pytest

import bayes_greybox as bg
from bayes_greybox.config.starting.starter import starter
from bayes_greybox.data.reading.door import layout_of
from bayes_greybox.running.errors import InputError

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


@pytest.mark.parametrize("kind", ["a cell", "a line at the end", "a row of units", "padded"])
def test_an_empty_cell_costs_the_others_no_digits(tmp_path, kind):
    t = EPOCH + 100 * np.arange(N, dtype=np.int64)
    header, *rows = table(t).to_csv(index=False).splitlines()
    if kind == "padded":
        rows = [row.replace(",", " ,") for row in rows]
    if kind == "a line at the end":
        rows.append("")
    else:
        rows[3] = f",{rows[3].split(',')[1]}"
    units = ["[ns],[m]"] if kind == "a row of units" else []
    (tmp_path / "run.csv").write_text("\n".join([header, *units, *rows]) + "\n\n")
    data = bg.read(tmp_path / "run.csv", **ASKED, missing="drop")
    kept = t if kind == "a line at the end" else np.delete(t, 3)
    np.testing.assert_array_equal(data.time, kept - EPOCH)
    # No time, but whole numbers all the same.
    with pytest.raises(InputError, match='"t" of .* holds whole numbers of more digits than a float does'):
        bg.read(tmp_path / "run.csv", dt=1.0, states=["t"], missing="drop")


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


def local(start, step, n=N):
    """Stamps of a clock in Berlin without its zone."""
    return pd.date_range(start, periods=n, freq=step, tz="Europe/Berlin").tz_localize(None)


@pytest.mark.parametrize("restart", ["error", "run"])
def test_a_clock_that_is_set_back_stands_still_where_rows_are_an_hour_apart(restart):
    frame = table(local("2024-10-26 18:00", "1h"))
    with pytest.raises(InputError, match="stands still in row 9, at 2024-10-27 02:00:00, by an hour.*there twice"):
        bg.read(frame, **ASKED, restart=restart)
    # Another step has no such hour.
    twice = table(np.repeat(pd.date_range("2024-10-27", periods=N // 2, freq="min"), 2))
    with pytest.raises(InputError, match="stamp 0 twice"):
        bg.read(twice, **ASKED)


@pytest.mark.parametrize(
    ("start", "step", "said"),
    [
        ("2024-03-30 18:00", "15min", "from 2024-03-31 01:45:00 to 2024-03-31 03:00:00"),
        ("2024-10-26 18:00", "2h", "from 2024-10-27 02:00:00 to 2024-10-27 03:00:00"),
        ("2024-05-01", "15min", None),
    ],
)
def test_a_step_that_is_an_hour_off_is_remarked_where_dates_have_no_zone(start, step, said):
    stamps = local(start, step)
    remarks = "\n".join(bg.read(table(stamps), **ASKED).remarks)
    assert ("is an hour off the others" in remarks) == (said is not None) and (said or "") in remarks
    zoned = stamps.tz_localize("Europe/Berlin", ambiguous=np.zeros(N, bool))
    for known in (zoned, [each.isoformat() for each in zoned]):
        assert "an hour off" not in "\n".join(bg.read(table(known), **ASKED).remarks)


def test_a_first_configuration_says_that_time_goes_back(tmp_path):
    def start(frame):
        path = tmp_path / "run.csv"
        frame.to_csv(path, index=False)
        found = starter(path, tmp_path / "run.toml", layout_of())
        return found.text, "\n".join(found.summary)

    runs = table(np.tile(np.arange(N / 2), 2))
    text, told = start(runs)
    assert 'restart = "run"' in text and "time that goes back, where a new run begins" in told
    text, told = start(table(np.random.default_rng(0).permutation(N).astype(float)))
    assert "restart" not in text and "sort the rows" in text and "have to be sorted" in told


def test_times_far_from_zero_are_told_with_all_their_digits():
    t = 1.7e9 + np.r_[np.arange(5), np.arange(3, 8)] * 0.1
    with pytest.raises(InputError, match="goes back in row 5, to 1700000000.3"):
        bg.read(table(t), **ASKED)
    y = np.sin(np.arange(10))
    with pytest.raises(InputError, match="from 1700000000.4 to 1700000000.3"):
        bg.Trajectories.from_arrays(t, states={"y": y})
    with pytest.raises(InputError, match="has the stamp 1700000000.4 twice"):
        bg.Trajectories.from_arrays(np.r_[t[:5], t[4] + np.arange(5)], states={"y": y})
    data = bg.Trajectories.from_arrays(t[:5], states={"y": y[:5]})
    with pytest.raises(InputError, match=r"run from 1700000000 to 1700000000\.4"):
        data.trim(0.0, 1.0)
    assert "from 1700000000.1" in data.trim(start=t[1]).remarks[-1]


@pytest.mark.parametrize("kind", ["frame", "parquet"])
def test_times_in_an_unnamed_index_are_a_column(tmp_path, kind):
    t = 0.1 * np.arange(N)
    frame = table(t).drop(columns="t").set_axis(t)
    path = tmp_path / "run.parquet"
    frame.to_parquet(path)
    data = bg.read(frame if kind == "frame" else path, time="index", states=["y"])
    np.testing.assert_array_equal(data.time, t)
    assert 'time = "index"' in starter(path, tmp_path / "run.toml", layout_of()).text


@pytest.mark.parametrize("sep", ["ab", "[;|]"])
def test_separators_of_several_characters_are_refused_in_words(tmp_path, sep):
    path = tmp_path / "run.csv"
    path.write_text("t;y\n0;1\n1;2\n2;4\n")
    with pytest.raises(InputError, match="sep must be one character"):
        bg.read(path, **ASKED, sep=sep)
