import os
import re
import sys

import numpy as np
import pandas as pd
import pytest
import scipy.io
import xarray as xr

import bayes_greybox as bg

UNTYPED = pytest.mark.skipif(
    os.environ.get("BAYES_GREYBOX_TYPECHECK", "0") == "1", reason="the checker of types answers first"
)
N = 40
T = np.arange(N) * 0.25
Y, V = np.sin(T), np.cos(T)
FRAME = pd.DataFrame({"t": T, "y": Y, "v": V})


def check(data, rtol=1e-12):
    np.testing.assert_allclose(data.time, T, rtol=rtol, atol=1e-12)
    np.testing.assert_allclose(data.states["y"], Y, rtol=rtol, atol=1e-12)


def remarks(data):
    return "\n".join(data.remarks)


def test_a_frame_is_read_as_its_file_is(tmp_path):
    FRAME.to_csv(tmp_path / "run.csv", index=False)
    settings = {"time": "t", "states": ["y"], "derivatives": {"y": "v"}, "units": {"t": "s", "y": "m"}}
    one, other = bg.read(FRAME, **settings), bg.read(tmp_path / "run.csv", **settings)
    check(one)
    pd.testing.assert_frame_equal(one.to_frame(), other.to_frame())
    assert one.metadata() == other.metadata() and one.remarks == ()
    check(bg.read({"t": T, "y": Y}, time="t", states=["y"]))


def test_the_index_of_a_frame_is_a_column():
    check(bg.read(FRAME.set_index("t"), time="t", states=["y"]))
    stamped = FRAME.set_index(pd.Timestamp("2024-05-01", tz="Europe/Berlin") + pd.to_timedelta(T, unit="s"))
    data = bg.read(stamped, time="index", states=["y"])
    check(data)
    assert "seconds since the first, 2024-05-01" in remarks(data) and data.unit("t") == "s"
    with pytest.raises(bg.InputError, match=r"the columns of the table are index, t, y, v\."):
        bg.read(stamped, states=["y"])


def test_several_files_are_several_runs_and_ten_comes_after_nine(tmp_path):
    for number in (9, 10):
        FRAME.assign(y=Y + number).to_csv(tmp_path / f"run{number}.csv", index=False)
    data = bg.read(tmp_path / "run*.csv", time="t", states=["y"])
    assert data.run_names == ("run9", "run10") and data.run_lengths == (N, N)
    np.testing.assert_allclose(data.take("run10").states["y"], Y + 10, rtol=1e-12)
    assert "2 sources were read as 2 runs: run9, run10" in repr(data)
    two = bg.read([FRAME, FRAME.assign(y=-Y)], time="t", states=["y"])
    assert two.run_names == ("0", "1")
    with pytest.raises(bg.InputError, match="No file matches"):
        bg.read(str(tmp_path / "trial*.csv"), time="t", states=["y"])
    with pytest.raises(bg.InputError, match="list of sources is empty"):
        bg.read([], time="t", states=["y"])


def test_runs_within_several_files_have_both_names(tmp_path):
    for name in "ab":
        FRAME.assign(id=np.repeat([1, 2], N // 2)).to_csv(tmp_path / f"{name}.csv", index=False)
    data = bg.read([tmp_path / "a.csv", tmp_path / "b.csv"], time="t", states=["y"], run="id")
    assert data.run_names == ("a/1", "a/2", "b/1", "b/2")


def test_files_with_different_units_are_refused(tmp_path):
    FRAME.rename(columns={"y": "y [m]"}).to_csv(tmp_path / "a.csv", index=False)
    FRAME.rename(columns={"y": "y [mm]"}).to_csv(tmp_path / "b.csv", index=False)
    with pytest.raises(bg.InputError, match=r"unit of y is m in .*a\.csv\" but mm in .*b\.csv"):
        bg.read(tmp_path / "*.csv", time="t", states=["y"])
    assert bg.read(tmp_path / "*.csv", time="t", states=["y"], units={"y": "mm"}).unit("y") == "mm"


def test_units_behind_names_are_read_and_may_be_replaced():
    table = FRAME.rename(columns={"t": "t (s)", "y": "y [mm]", "v": "v [Nm]"})
    data = bg.read(table, time="t", states=["y"], inputs=["v"])
    check(data)
    assert (data.unit("t"), data.unit("y"), data.unit("v")) == ("s", "mm", "N*m")
    # The name that the table has still names the column, and a given unit is the user's.
    data = bg.read(table, time="t (s)", states={"y": "y [mm]"}, units={"y": "cm", "t (s)": ""})
    assert (data.unit("t"), data.unit("y")) == (None, "cm")


@pytest.mark.parametrize("name", ["x[0]", "acc(1)", "f(x)", "speed (old)"])
def test_brackets_that_hold_no_unit_belong_to_the_name(name):
    data = bg.read(FRAME.rename(columns={"y": name}), time="t", states={"y": name})
    check(data)
    assert data.units == {}


def test_brackets_behind_one_name_hold_units_or_none_of_them_does():
    frame = FRAME.rename(columns={"y": "T (in)", "v": "T (out)", "t": "t (s)"})
    data = bg.read(frame, time="t", states={"y": "T (in)"}, inputs={"v": "T (out)"})
    assert data.units == {"t": "s"}
    check(data)
    assert bg.read(FRAME.rename(columns={"y": "T (in)", "v": "p (out)"}), time="t", states=["T"]).unit("T") == "in"


def test_a_unit_that_is_not_known_is_left_out_and_said():
    data = bg.read(FRAME.rename(columns={"y": "y [bananas]"}), time="t", states=["y"])
    assert data.units == {} and '"bananas" of y' in remarks(data)


def test_words_in_the_first_row_are_no_units():
    table = FRAME.astype(object)
    table.loc[0, "y"] = "high"
    with pytest.raises(bg.InputError, match=r'"y" of the table is not numeric: row 0 holds \'high\'; correct'):
        bg.read(table, time="t", states=["y"])


def test_rates_that_are_to_be_computed_are_those_of_differentiate():
    data = bg.read(FRAME[["t", "y"]], time="t", states=["y"], rates={"y": "w"})
    expected = bg.read(FRAME, time="t", states=["y"]).differentiate(rates={"y": "w"})
    pd.testing.assert_frame_equal(data.to_frame(), expected.to_frame())
    with pytest.raises(bg.InputError, match=r'measured rate of "y", pass derivatives=\{"y": "v"\}') as refused:
        bg.read(FRAME, time="t", states=["y"], rates={"y": "v"})
    assert "the table has that column" in str(refused.value)
    assert bg.read(FRAME, time="t", states=["y"], derivatives={"y": "v"}).derivative_names == ("y",)


def test_dates_in_words_are_seconds_of_each_run():
    stamps = (pd.Timestamp("2024-03-04 12:00:00") + pd.to_timedelta(np.tile(T, 2), unit="s")).astype(str)
    table = pd.DataFrame({"when": stamps, "y": np.tile(Y, 2), "run": np.repeat([1, 2], N)})
    data = bg.read(table, time="when", states=["y"], run="run")
    for run in (0, 1):
        check(data.take(run))
    assert data.run_names == ("1", "2") and "seconds since the first of each run" in remarks(data)
    with pytest.raises(bg.InputError, match="the unit of the time cannot be 'h'"):
        bg.read(table, time="when", states=["y"], run="run", units={"t": "h"})


def test_a_day_that_may_be_a_month_is_asked_for():
    days = pd.date_range("2024-03-04", periods=6)
    table = pd.DataFrame({"day": days.strftime("%d/%m/%Y"), "y": Y[:6]})
    with pytest.raises(bg.InputError, match="pass dayfirst=True or dayfirst=False"):
        bg.read(table, time="day", states=["y"])
    data = bg.read(table, time="day", states=["y"], dayfirst=True)
    np.testing.assert_array_equal(data.time, np.arange(6) * 86_400.0)
    # From the 13th on it can be told.
    table["day"] = pd.date_range("2024-03-13", periods=6).strftime("%d/%m/%Y")
    np.testing.assert_array_equal(bg.read(table, time="day", states=["y"]).time, np.arange(6) * 86_400.0)


def test_clock_times_and_fractions_that_are_left_out_where_they_are_zero():
    clock = pd.DataFrame({"t": ["00:59:59", "01:00:00.5", "01:00:02"], "y": [1.0, 2.0, 4.0]})
    np.testing.assert_allclose(bg.read(clock, time="t", states=["y"]).time, [0.0, 1.5, 3.0])
    dates = clock.assign(t="14.3.2024 " + clock["t"])
    np.testing.assert_allclose(bg.read(dates, time="t", states=["y"]).time, [0.0, 1.5, 3.0])
    with pytest.raises(bg.InputError, match="holds neither numbers nor dates: row 1 holds 'noon'"):
        bg.read(clock.assign(t=["00:59:59", "noon", "01:00:02"]), time="t", states=["y"])


def test_excel_is_read_with_its_sheets_and_dates(tmp_path):
    path = tmp_path / "run.xlsx"
    with pd.ExcelWriter(path) as book:
        FRAME.assign(t=pd.Timestamp("2024-05-01") + pd.to_timedelta(T, unit="s")).to_excel(book, sheet_name="first")
        FRAME.to_excel(book, sheet_name="second", index=False, startrow=3)
    data = bg.read(path, time="t", states=["y"])
    check(data, 1e-6)
    assert 'sheet "first"' in remarks(data)
    check(bg.read(path, time="t", states=["y"], sheet="second", skiprows=3))
    with pytest.raises(bg.InputError, match="has no sheet 'third'; its sheets are first, second"):
        bg.read(path, time="t", states=["y"], sheet="third")
    with pytest.raises(bg.InputError, match="pass skiprows="):
        bg.read(path, time="t", states=["y"], sheet="second")


def test_excel_without_openpyxl_names_the_extra(tmp_path, monkeypatch):
    FRAME.to_excel(tmp_path / "run.xlsx", index=False)
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(bg.InputError, match=r'needs openpyxl; install it with pip install "\.\[tables\]"'):
        bg.read(tmp_path / "run.xlsx", time="t", states=["y"])


@pytest.mark.parametrize(("name", "said"), [("run.xls", "save it as .xlsx"), ("run.npz", "numpy.load")])
def test_files_of_other_kinds_are_answered_with_what_to_do(tmp_path, name, said):
    with pytest.raises(bg.InputError, match=f"unknown extension.*{said}"):
        bg.read(tmp_path / name, time="t", states=["y"])


def test_objects_that_are_no_tables_are_named():
    with pytest.raises(bg.InputError, match="cannot read a ndarray; give the path of a file"):
        bg.read(np.zeros((3, 3)), time="t", states=["y"])
    with pytest.raises(bg.InputError, match="columns of one length"):
        bg.read({"t": T, "y": Y[:-1]}, time="t", states=["y"])


def test_a_preamble_without_marks_is_answered_with_the_lines_to_skip(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("Instrument 7\nOperator: x, y\n\n" + FRAME.to_csv(index=False))
    with pytest.raises(bg.InputError) as refused:
        bg.read(path, time="t", states=["y"])
    skiprows = int(re.search(r"pass skiprows=(\d+)", str(refused.value)).group(1))
    check(bg.read(path, time="t", states=["y"], skiprows=skiprows))


def test_columns_without_names_can_be_named(tmp_path):
    path = tmp_path / "run.csv"
    FRAME.to_csv(path, index=False, header=False)
    with pytest.raises(bg.InputError, match=r"first row holds numbers.*columns=\['c1', 'c2', 'c3'\]"):
        bg.read(path, time="c1", states={"y": "c2"})
    data = bg.read(path, time="c1", states={"y": "c2"}, columns=["c1", "c2", "c3"])
    check(data)
    assert "read as measurements" in remarks(data)


def test_text_of_another_encoding_is_answered_with_the_option(tmp_path):
    path = tmp_path / "run.csv"
    path.write_bytes(FRAME.rename(columns={"v": "Temperatur [°C]"}).to_csv(index=False).encode("latin-1"))
    with pytest.raises(bg.InputError, match='encoding="latin-1"'):
        bg.read(path, time="t", states=["y"])
    data = bg.read(path, time="t", states=["y"], inputs={"T": "Temperatur"}, encoding="latin-1")
    assert data.unit("T") == "°C"


LVM = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t{decimal}
Multi_Headings\tYes
X_Columns\t{columns}
***End_of_Header***\t
\t
"""
SEGMENT = """Channels\t2\t\t
Samples\t{n}\t{n}\t
Y_Unit_Label\tV\tm\t
X_Dimension\tTime\tTime\t
X0\t0{decimal}0E+0\t0{decimal}0E+0\t
Delta_X\t0{decimal}250000\t0{decimal}250000\t
***End_of_Header***\t\t\t
X_Value\tu\ty\tComment
"""


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("columns", ["One", "No"])
def test_labview_files_are_read_with_their_units_and_segments(tmp_path, decimal, columns):
    def rows(sign):
        lines = [f"{t if columns == 'One' else ''}\t{v}\t{sign * y}" for t, y, v in zip(T, Y, V, strict=True)]
        return "\n".join(lines).replace(".", decimal) + "\n\n"

    head = SEGMENT.format(n=N, decimal=decimal)
    path = tmp_path / "run.lvm"
    path.write_text(LVM.format(decimal=decimal, columns=columns) + head + rows(1) + head + rows(-1))
    data = bg.read(path, time="X_Value", states=["y"], inputs=["u"])
    assert data.run_names == ("0", "1") and "2 segments" in remarks(data)
    check(data.take(0))
    np.testing.assert_allclose(data.take(1).states["y"], -Y, rtol=1e-12)
    np.testing.assert_allclose(data.take(1).inputs["u"], V, rtol=1e-12)
    assert (data.unit("t"), data.unit("y"), data.unit("u")) == ("s", "m", "V")


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_labview_files_with_times_of_each_channel_have_units_in_their_places_and_one_time(tmp_path, end):
    # As LabVIEW writes them: lines without a tab at their end, a channel's cells two apart.
    head = "LabVIEW Measurement\nSeparator\tTab\nDecimal_Separator\t.\nX_Columns\tMulti\n***End_of_Header***\t\n\t\n"
    channels = "Channels\t2\t\nY_Unit_Label\tVolts\t\tm\nX_Dimension\tTime\t\tTime\n***End_of_Header***\n"
    names = "X_Value\tu\tX_Value\ty\tComment\n"

    def read(later):
        rows = "\n".join(f"{t}\t{v}\t{t + later}\t{y}" for t, y, v in zip(T, Y, V, strict=True))
        path = tmp_path / "run.lvm"
        path.write_text((head + channels + names + rows).replace("\n", end), newline="")
        return bg.read(path, time="X_Value", states=["y"], inputs=["u"])

    data = read(0.0)
    check(data)
    assert (data.unit("y"), data.unit("u")) == ("m", "volts")
    with pytest.raises(bg.InputError, match="times of its own for the channel 'y'.*one time: export"):
        read(0.1)


def test_other_text_under_the_name_of_a_labview_file_is_refused(tmp_path):
    FRAME.to_csv(tmp_path / "run.lvm", index=False)
    with pytest.raises(bg.InputError, match="is no LabVIEW measurement file; rename it to .txt"):
        bg.read(tmp_path / "run.lvm", time="t", states=["y"])


def test_structures_of_matlab_are_read_and_objects_answered_with_what_to_save(tmp_path):
    scipy.io.savemat(tmp_path / "run.mat", {"S": {"t": T, "x": np.column_stack([Y, V]), "name": "a run"}, "fs": 4.0})
    data = bg.read(tmp_path / "run.mat", time="S.t", states={"y": "S.x_1", "v": "S.x_2"})
    check(data)
    np.testing.assert_array_equal(data.states["v"], V)
    scipy.io.savemat(tmp_path / "words.mat", {"label": "only words"})
    with pytest.raises(bg.InputError, match=r"cannot be read: in MATLAB, save its columns as vectors"):
        bg.read(tmp_path / "words.mat", time="t", states=["y"])


def test_runs_may_be_a_dimension_of_a_data_set():
    both = xr.Dataset(
        {"y": (("time", "trial"), np.column_stack([Y, -Y]), {"units": "m"}), "u": ("time", V)},
        {"time": ("time", T, {"units": "s"}), "trial": ["up", "down"]},
    )
    data = bg.read(both, time="time", run="trial", states=["y"], inputs=["u"])
    assert data.run_names == ("up", "down") and (data.unit("t"), data.unit("y")) == ("s", "m")
    check(data.take("up"))
    np.testing.assert_array_equal(data.take("down").states["y"], -Y)
    np.testing.assert_array_equal(data.take("down").inputs["u"], V)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"dt": 0.1}, "not both"),
        ({"time": None, "dt": -1.0}, "dt must be positive"),
        pytest.param({"restart": "go"}, 'restart must be "error" or "run"', marks=UNTYPED),
        pytest.param({"constant": "drop"}, 'constant must be "error" or "keep", not \'drop\'', marks=UNTYPED),
        ({"columns": "tyv"}, r'columns must be a list of names, such as columns=\["tyv"\]'),
        ({"columns": ["a"]}, "columns names 1 columns, but the table has 3: t, y, v"),
        ({"run": "v", "time": "y", "states": "y"}, r'states must be a list of names, such as \["y"\]'),
    ],
)
def test_requests_that_cannot_be_met(changes, said):
    with pytest.raises(bg.InputError, match=said):
        bg.read(FRAME, **{"time": "t", "states": ["y"]} | changes)
    with pytest.raises(bg.InputError, match="more than once"):
        bg.read(FRAME.set_axis(["t", "y", "y"], axis=1), time="t", states=["y"])


def test_a_cell_that_holds_a_list_is_no_number():
    with pytest.raises(bg.InputError, match=r'Column "y" of the table is not numeric: row 0 holds \[1, 2\]'):
        bg.read({"t": [0.0, 1.0], "y": [[1, 2], [3, 4]]}, time="t", states=["y"])


def test_dates_in_cells_are_never_counted_in_ticks():
    """A column of Python's own dates is one of objects, which pandas makes nanoseconds of."""
    stamps = [pd.Timestamp("2024-05-01").to_pydatetime() + pd.Timedelta(seconds=t) for t in T]
    table = FRAME.assign(t=pd.Series(stamps, dtype=object))
    data = bg.read(table, time="t", states=["y"])
    check(data)
    assert data.unit("t") == "s"
    with pytest.raises(bg.InputError, match="is not numeric: row 0 holds"):
        bg.read(table, dt=0.25, states={"y": "t"})


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        (["1.000,5", "1.001,5", "1.002,5"], 'pass decimal="," and thousands="."'),
        (["1.000.000", "1.000.001", "1.000.002"], 'pass decimal="," and thousands="."'),
        (["1,000.5", "1,001.5", "1,002.5"], 'pass thousands=","'),
        (["0,5", "1,5", "2,5"], 'pass decimal=","'),
        (["00:01.5", "00:02.5", "00:03.5"], "neither numbers nor dates"),
        (["1", "2", "?"], r"row 2 holds '\?'"),
    ],
)
def test_numbers_with_marks_are_no_dates(cells, said):
    with pytest.raises(bg.InputError, match=said):
        bg.read(pd.DataFrame({"t": cells, "y": [1.0, 2.0, 4.0]}), time="t", states=["y"])


@pytest.mark.parametrize("separator", ["|", ";", "\t"])
def test_what_separates_names_separates_values_too(tmp_path, separator):
    names = separator.join(["t", '"y, filtered"', "v"])
    path = tmp_path / "run.csv"
    path.write_text(f"{names}\n{FRAME.to_csv(index=False, header=False, sep=separator)}")
    check(bg.read(path, time="t", states={"y": "y, filtered"}))


def test_what_is_nearly_a_request_is_answered_with_the_request(tmp_path):
    (tmp_path / "run.csv").write_text(FRAME.to_csv(index=False))
    with pytest.raises(bg.InputError, match=r"states=\{'my_y': 'my y'\}"):
        bg.read(FRAME.rename(columns={"y": "my y"}), time="t", states=["my y"])
    with pytest.raises(bg.InputError, match=r'is a folder; .*such as ".*/\*\.csv"'):
        bg.read(tmp_path, time="t", states=["y"])
    with pytest.raises(bg.InputError, match="has no table after its first 500 lines; check skiprows"):
        bg.read(tmp_path / "run.csv", time="t", states=["y"], skiprows=500)
    with pytest.raises(bg.InputError, match="it cannot be -1"):
        bg.read(tmp_path / "run.csv", time="t", states=["y"], skiprows=-1)
    check(bg.read(pd.DataFrame(FRAME.to_numpy()), time=0, states={"y": 1}))
    check(bg.read(FRAME.set_index("t")["y"], time="t", states=["y"]))
