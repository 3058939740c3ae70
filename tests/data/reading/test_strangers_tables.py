"""Tables that were once read wrongly or refused without a remedy: a test each, in the words of what was found."""

import numpy as np
import pandas as pd
import pytest
import scipy.io

import bayes_greybox as bg
from bayes_greybox import cli
from bayes_greybox.config.file import load_config
from bayes_greybox.config.starting.starter import starter
from bayes_greybox.data.reading.door import layout_of
from bayes_greybox.running.errors import InputError

N = 40
T = np.arange(N) * 0.1
DAYS = pd.date_range("2024-02-01", periods=N, freq="D")


def table(n=N, start=0.0, **columns):
    t = start + np.arange(n) * 0.1
    return pd.DataFrame({"t": t, "y": np.sin(t), "v": np.cos(t), **columns})


@pytest.mark.parametrize("form", ["%Y%m%d", "%Y%m%d%H%M", "%Y%m%d%H%M%S"])
@pytest.mark.parametrize("kind", [int, float, str])
def test_dates_of_digits_alone_are_dates(form, kind):
    frame = table(when=[kind(each) for each in DAYS.strftime(form)])
    data = bg.read(frame, states=["y"], time="when")
    np.testing.assert_array_equal(data.time, 86400.0 * np.arange(N))
    assert data.unit("t") == "s" and "converted to seconds" in " ".join(data.remarks)


@pytest.mark.parametrize("first", [20240240, 20241301, 18991231, 2024030, 202403040])
def test_numbers_that_are_no_dates_stay_numbers(first):
    """From one that is no day, or of another number of digits."""
    data = bg.read(table(when=first + np.arange(N)), states=["y"], time="when")
    np.testing.assert_array_equal(np.diff(data.time), 1.0)
    assert data.time[0] == first


def test_a_first_configuration_takes_them_for_the_time_and_no_day_for_a_state(tmp_path):
    path = tmp_path / "days.csv"
    table(date=DAYS.strftime("%Y%m%d"), other=DAYS.strftime("%Y%m%d")).drop(columns="t").to_csv(path, index=False)
    text = starter(path, tmp_path / "days.toml", layout_of()).text
    assert 'time = "date"' in text and "other has no role: it holds words or dates" in text
    # The day of a record beside the time of that day.
    table(date=20240304, time=pd.date_range("2024-03-04", periods=N, freq="s").strftime("%H:%M:%S")).drop(
        columns="t"
    ).to_csv(path, index=False)
    assert 'time = "time"' in starter(path, tmp_path / "days.toml", layout_of()).text


def test_parts_of_runs_have_the_name_of_the_run_and_a_number(tmp_path):
    twice = pd.concat([table(), table()], ignore_index=True)
    asked = {"states": ["y"], "time": "t", "restart": "run"}
    assert bg.read(twice, **asked).run_names == ("0", "1")
    # A run that is called 0 is no run without a name: its second part was taken for the run called 1.
    named = pd.concat([twice.assign(r=0), twice.assign(r=1)], ignore_index=True)
    assert bg.read(named, run="r", **asked).run_names == ("0/0", "0/1", "1/0", "1/1")
    for name in ("0", "1", "1_1"):
        (twice if name != "1_1" else table()).to_csv(tmp_path / f"{name}.csv", index=False)
    several = bg.read(str(tmp_path / "*.csv"), **asked)
    assert several.run_names == ("0/0", "0/1", "1/0", "1/1", "1_1")


def test_numbers_behind_names_are_taken_by_no_other_run():
    frames = [table().assign(r=name) for name in ("a", "a_2")]
    data = bg.read([pd.concat(frames), pd.concat(frames)], run="r", states=["y"], time="t")
    assert data.run_names == ("0/a", "0/a_2", "1/a", "1/a_2")
    from bayes_greybox.data.reading.door import _distinct

    assert _distinct(["a", "a", "a_2"]) == ["a", "a_3", "a_2"]


CONFIG = """
[data]
path = "train.csv"
time = "t"
states = ["y"]
differentiate = { rates = { y = "v" } }
test = { path = "test.csv" }

[dictionary]
v = ["y"]
"""


def test_a_rate_that_held_out_data_have_is_not_computed_either(tmp_path):
    table().drop(columns="v").to_csv(tmp_path / "train.csv", index=False)
    table().to_csv(tmp_path / "test.csv", index=False)
    path = tmp_path / "case.toml"
    path.write_text(CONFIG, encoding="utf-8")
    with pytest.raises(InputError, match=r'"v" was not measured, but .*test\.csv" has that column'):
        load_config(path).read_data()
    table().drop(columns="v").to_csv(tmp_path / "test.csv", index=False)
    train, test = load_config(path).read_data()
    assert test is not None and test.state_names == train.state_names == ("y", "v")


@pytest.mark.parametrize(("above", "skiprows"), [(0, 0), (2, 2), (3, [1])])
def test_empty_cells_of_a_column_that_is_alone_take_their_time(tmp_path, above, skiprows):
    pytest.importorskip("openpyxl")
    values: list[object] = [*np.sin(T)]
    values[5] = values[6] = values[20] = None
    cells = [["of the bench"]] * above if isinstance(skiprows, int) else []
    cells += [["y"], ["left out"]] if not isinstance(skiprows, int) else [["y"]]
    path = tmp_path / "one.xlsx"
    pd.DataFrame([*cells, *([value] for value in values)]).to_excel(path, header=False, index=False)
    with pytest.raises(InputError, match="missing"):
        bg.read(path, states=["y"], dt=0.1, skiprows=skiprows)
    data = bg.read(path, states=["y"], dt=0.1, skiprows=skiprows, missing="drop")
    kept = np.delete(np.arange(N), [5, 6, 20])
    np.testing.assert_allclose(np.sort(data.states["y"]), np.sort(np.sin(T[kept])))
    assert data.time[-1] == pytest.approx(T[-1]) and data.dropped == 3


def test_a_first_configuration_of_text_in_another_encoding(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    frame = table().rename(columns={"y": "weg [µm]", "v": "übergang"})
    frame.to_csv("messung.csv", index=False, encoding="latin-1")
    assert cli.main(["init", "messung.csv"]) == 0
    assert "text in cp1252" in capsys.readouterr().out
    assert 'encoding = "cp1252"' in (tmp_path / "messung.toml").read_text(encoding="utf-8")
    (tmp_path / "messung.toml").unlink()
    assert cli.main(["init", "messung.csv", "--encoding", "latin-1"]) == 0
    text = (tmp_path / "messung.toml").read_text(encoding="utf-8")
    assert 'encoding = "latin-1"' in text
    assert '{ expression = "' in text and "prior = [mean, sd]" in text
    train, _ = load_config(tmp_path / "messung.toml").read_data()
    assert "µm" in str(train.units.values())


@pytest.mark.parametrize(
    ("suffix", "lines"),
    [
        (".csv", ['t;"y, of the sensor";z', '0.{i};{y};"a, b"']),
        (".txt", ['t,"y; of the sensor",z', '0.{i},{y},"a; b"']),
        (".txt", ['t "y, of the sensor"', "0.{i} {y}"]),
        (".dat", ['t\t"y; of, the | sensor"', "0.{i}\t{y}"]),
        (".csv", ['"t","y; of the sensor"', '"0.{i}","{y}"']),
    ],
)
def test_what_stands_in_quotation_marks_separates_nothing(tmp_path, suffix, lines):
    head, row = lines
    rows = [row.replace("{i}", str(i)).replace("{y}", f"{i * i}.5") for i in range(1, 9)]
    path = tmp_path / f"run{suffix}"
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    name = head.split('"')[-2] if not head.startswith('"t"') else head.split('"')[3]
    data = bg.read(path, states={"y": name}, time="t")
    np.testing.assert_allclose(data.states["y"], [i * i + 0.5 for i in range(1, 9)])


def test_a_quotation_mark_that_is_an_inch_parts_no_line(tmp_path):
    path = tmp_path / "inch.csv"
    path.write_text('t,pos 3",pos 4"\n' + "".join(f"0.{i},{i * i},{i}\n" for i in range(1, 9)), encoding="utf-8")
    np.testing.assert_allclose(bg.read(path, states={"y": 'pos 3"'}, time="t").states["y"], np.arange(1, 9) ** 2)


AUTUMN = pd.date_range("2024-10-27 01:30", periods=N, freq="5min", tz="Europe/Berlin")
"""Local time is set back by an hour at three."""


def test_clocks_that_are_set_back_are_told_from_another_run(tmp_path):
    local = table(when=AUTUMN.tz_localize(None).strftime("%Y-%m-%d %H:%M:%S")).drop(columns="t")
    with pytest.raises(InputError, match=r"to 2024-10-27 .*by an hour.*in UTC or with their offset"):
        bg.read(local, states=["y"], time="when")
    # What it says helps.
    told = table(when=[each.isoformat() for each in AUTUMN]).drop(columns="t")
    for frame in (told, table(when=AUTUMN).drop(columns="t"), local.assign(when=AUTUMN.tz_convert("UTC"))):
        np.testing.assert_allclose(np.diff(bg.read(frame, states=["y"], time="when").time), 300.0)
    path = tmp_path / "night.csv"
    local.to_csv(path, index=False)
    assert "as clocks do when summer time ends" in starter(path, tmp_path / "night.toml", layout_of()).text


@pytest.mark.parametrize("zone", ["", "Z", "+01:00", ".250"])
def test_stamps_with_a_letter_between_date_and_time_are_dates(zone):
    when = [f"2024-03-05T08:{15 + i // 60:02d}:{i % 60:02d}{zone}" for i in range(N)]
    np.testing.assert_allclose(bg.read(table(when=when), states=["y"], time="when").time, np.arange(N))


def test_another_run_is_no_clock_that_was_set_back(tmp_path):
    days = table(when=pd.date_range("2024-10-27", periods=N, freq="s").strftime("%Y-%m-%d %H:%M:%S")).drop(columns="t")
    twice = pd.concat([days, days], ignore_index=True)
    with pytest.raises(InputError, match=r'to 2024-10-27 00:00:00: if another run begins there, pass restart="run"'):
        bg.read(twice, states=["y"], time="when")
    path = tmp_path / "twice.csv"
    twice.to_csv(path, index=False)
    text = starter(path, tmp_path / "twice.toml", layout_of()).text
    assert 'restart = "run"' in text and "summer time" not in text


@pytest.mark.parametrize("upright", [True, False])
def test_a_long_vector_hides_no_matrix_of_matlab(tmp_path, upright):
    Y = np.column_stack([np.sin(T), np.cos(T)])
    content = {"t": T, "Y": Y if upright else Y.T, "noise": np.arange(500.0), "gains": np.arange(3.0)}
    scipy.io.savemat(tmp_path / "run.mat", content)
    data = bg.read(tmp_path / "run.mat", states=["Y"], time="t")
    np.testing.assert_allclose(data.states["Y_2"], np.cos(T))
    # What is asked for is found whatever its length.
    alone = bg.read(tmp_path / "run.mat", states={"n": "noise"}, dt=0.1)
    assert alone.n_obs == 500
    with pytest.raises(InputError, match=r'no column "z".*Of other lengths than these are .*noise \(500\)'):
        bg.read(tmp_path / "run.mat", states=["z"], time="t")
    assert 'time = "t"' in starter(tmp_path / "run.mat", tmp_path / "run.toml", layout_of()).text


def test_two_rates_of_sampling_in_one_file_of_matlab(tmp_path):
    slow = np.arange(10) * 0.4
    content = {"t": T, "y": np.sin(T), "ts": slow, "temperature": np.cos(slow)}
    scipy.io.savemat(tmp_path / "run.mat", content)
    assert bg.read(tmp_path / "run.mat", states=["y"], time="t").n_obs == N
    assert bg.read(tmp_path / "run.mat", states=["temperature"], time="ts").n_obs == 10


def test_patterns_in_a_list(tmp_path):
    for name in ("a1", "a2", "a10", "b1"):
        table().to_csv(tmp_path / f"{name}.csv", index=False)
    asked = {"states": ["y"], "time": "t"}
    several = [str(tmp_path / "a*.csv"), tmp_path / "b?.csv"]
    assert bg.read(several, **asked).run_names == ("a1", "a2", "a10", "b1")
    # A file is read once, where it is named.
    assert bg.read([tmp_path / "a1*.csv", tmp_path / "a1.csv", tmp_path / "a*.csv"], **asked).run_names == (
        "a10", "a1", "a2",
    )  # fmt: skip
    with pytest.raises(InputError, match=r'No file matches ".*c\*\.csv"'):
        bg.read([tmp_path / "a1.csv", tmp_path / "c*.csv"], **asked)
    config = tmp_path / "case.toml"
    text = '[data]\npath = ["a*.csv", "b1.csv"]\ntime = "t"\nstates = ["y"]\nderivatives = { y = "v" }\n'
    config.write_text(f'{text}\n[dictionary]\ny = ["y"]\n', encoding="utf-8")
    assert load_config(config).read_data()[0].run_names == ("a1", "a2", "a10", "b1")
