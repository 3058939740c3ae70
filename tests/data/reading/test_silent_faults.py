"""Tables of which a column, a row or a digit could be lost without a word: each is read as it is, or refused."""

import os

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import bayes_greybox as bg

UNTYPED = pytest.mark.skipif(
    os.environ.get("BAYES_GREYBOX_TYPECHECK", "0") == "1", reason="the checker of types answers first"
)
ASKED = {"time": "t", "states": ["y"]}


def written(path, text):
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        (
            "run.txt",
            "Time (s) pos vel\n0 1 2\n1 2 4\n2 5 3\n",
            "names 4 columns, but its first row has 3 values.*quotation",
        ),
        (
            "run.csv",
            "t,force, left,pos,vel\n0,1,2,3\n1,2,4,4\n2,5,3,4\n",
            "names 5 columns, but its first row has 4 values",
        ),
        ("run.txt", "t pos vel\n0 1 2\n1 2\n2 5 3\n", "names 3 columns, but line 3 has 2 values; write nan"),
    ],
)
def test_fewer_values_than_names_are_refused(tmp_path, name, text, said):
    with pytest.raises(bg.InputError, match=said):
        bg.read(written(tmp_path / name, text), dt=1.0, states=["pos"])


def test_names_in_quotation_marks_and_empty_last_cells_are_counted_as_pandas_counts_them(tmp_path):
    path = written(tmp_path / "run.csv", 't,"force, left",y,"rest\nof it"\n0,1,2,\n1,2,4,\n2,5,3,\n')
    np.testing.assert_array_equal(bg.read(path, inputs={"F": "force, left"}, **ASKED).inputs["F"], [1, 2, 5])
    path = written(tmp_path / "run.txt", '"Time (s)"  y v\n 0 2  1\n 1 4 2 \n 2 3 5\n')
    np.testing.assert_array_equal(bg.read(path, time="Time", states=["y"]).states["y"], [2, 4, 3])
    path = written(tmp_path / "run.tsv", "t\ty\tv\n0\t2\t\n1\t4\t\n2\t3\t7\n")
    np.testing.assert_array_equal(bg.read(path, **ASKED).states["y"], [2, 4, 3])
    names = written(tmp_path / "names.txt", "Time (s) pos vel\n0 1 2\n1 2 4\n2 5 3\n")
    data = bg.read(names, skiprows=1, columns=["t", "y", "v"], **ASKED)
    np.testing.assert_array_equal(data.states["y"], [1, 2, 5])


@pytest.mark.parametrize("suffix", [".csv", ".xlsx"])
@pytest.mark.parametrize("name", ["y", "y [mm]"])
def test_two_columns_of_one_name_are_refused(tmp_path, suffix, name):
    frame = pd.DataFrame([[0, 1, 2], [1, 2, 4], [2, 5, 3]], columns=["t", name, name])
    path = tmp_path / f"run{suffix}"
    frame.to_csv(path, index=False) if suffix == ".csv" else frame.to_excel(path, index=False)
    with pytest.raises(bg.InputError, match="more than once; rename one, or name all") as refused:
        bg.read(path, **ASKED)
    assert f'"{name}"' in str(refused.value)
    np.testing.assert_array_equal(bg.read(path, columns=["t", "x", "y"], **ASKED).states["y"], [2, 4, 3])


@pytest.mark.parametrize("kind", ["csv", "txt", "xlsx"])
def test_an_empty_row_takes_its_time_where_there_are_no_stamps(tmp_path, kind):
    y = [1.0, 2.0, np.nan, 5.0, 3.0]
    margins = [np.nan]
    cells = [*margins, *y, *margins, *margins]
    if kind == "xlsx":
        path = tmp_path / "run.xlsx"
        pd.DataFrame({"y": cells, "v": cells}).to_excel(path, index=False)
    else:
        sep = "," if kind == "csv" else " "
        rows = ["" if np.isnan(v) else f"{v}{sep}{v}" for v in cells]
        path = written(tmp_path / f"run.{kind}", "\n".join([f"y{sep}v", *rows, ""]))
    data = bg.read(path, dt=0.5, states=["y"], missing="drop")
    np.testing.assert_array_equal(data.time, [0.0, 0.5, 1.5, 2.0])
    assert data.dropped == 1
    with pytest.raises(bg.InputError, match="missing"):
        bg.read(path, dt=0.5, states=["y"])


def test_an_empty_row_between_runs_with_stamps_parts_them_and_no_more(tmp_path):
    path = written(tmp_path / "run.csv", "t,y\n0,1\n1,2\n2,4\n\n  \n0,3\n1,5\n2,4\n\n")
    data = bg.read(path, restart="run", **ASKED)
    assert data.run_lengths == (3, 3) and data.dropped == 0


@pytest.mark.parametrize("suffix", [".csv", ".xlsx"])
def test_the_first_row_below_given_names_is_kept(tmp_path, suffix):
    frame = pd.DataFrame({"t": ["2024-03-13 08:00:00", "2024-03-13 08:00:01", "2024-03-13 08:00:02"], "y": [1, 2, 4]})
    frame["who"] = ["Al", "Al", "Bo"]
    path = tmp_path / f"run{suffix}"
    write = frame.to_csv if suffix == ".csv" else frame.to_excel
    write(path, index=False, header=False)
    data = bg.read(path, columns=["t", "y", "who"], **ASKED)
    np.testing.assert_array_equal(data.states["y"], [1, 2, 4])
    assert "was read as measurements" in repr(data)
    if suffix == ".csv":
        path = written(tmp_path / "comma.csv", "0;1,5\n1;2,5\n2;4,5\n")
        data = bg.read(path, columns=["t", "y"], decimal=",", **ASKED)
        np.testing.assert_array_equal(data.states["y"], [1.5, 2.5, 4.5])
        path = tmp_path / "run.csv"
    # A row of names is none of measurements.
    write(path, index=False)
    np.testing.assert_array_equal(bg.read(path, columns=["t", "y", "Sensor 1"], **ASKED).states["y"], [1, 2, 4])


def test_points_that_group_digits_are_no_decimal_points(tmp_path):
    path = written(tmp_path / "run.csv", "t;y;v\n0;999,5;1.234\n1;1.234;2.500\n2;2.500;1.000\n")
    for name in ("y", "v"):
        with pytest.raises(bg.InputError, match=r'if the point groups its digits, pass thousands="\."'):
            bg.read(path, time="t", states={"y": name}, decimal=",")
    data = bg.read(path, time="t", states=["y", "v"], decimal=",", thousands=".")
    np.testing.assert_array_equal(data.states["y"], [999.5, 1234.0, 2500.0])
    np.testing.assert_array_equal(data.states["v"], [1234.0, 2500.0, 1000.0])
    with pytest.raises(bg.InputError, match='decimal and thousands are both "."'):
        bg.read(path, thousands=".", **ASKED)
    dated = path.read_text()
    for i in range(3):
        dated = dated.replace(f"\n{i};", f"\n{13 + i}.02.2024;")
    data = bg.read(written(path, dated), time="t", states=["y"], decimal=",", thousands=".")
    np.testing.assert_array_equal(data.time, 86_400.0 * np.arange(3))


def test_a_data_set_of_several_runs_needs_one_of_its_dimensions():
    y = np.array([[0.0, 1.0, 3.0], [2.0, 1.0, 0.0]])
    runs = xr.Dataset({"y": (("trial", "i"), y)})
    with pytest.raises(bg.InputError, match='has the dimensions trial and i.* pass run="trial"'):
        bg.read(runs, dt=1.0, states=["y"])
    assert bg.read(runs, dt=1.0, states=["y"], run="trial").run_lengths == (3, 3)
    assert bg.read(runs.isel(trial=[0]), dt=1.0, states=["y"]).run_lengths == (3,)


def test_years_of_two_digits_are_asked_for():
    table = pd.DataFrame({"t": ["24-03-05", "24-03-06", "24-04-07"], "y": [1.0, 2.0, 4.0]})
    with pytest.raises(bg.InputError, match="year may be first or last: write it with four digits"):
        bg.read(table, **ASKED)
    long = bg.read(table.assign(t="20" + table["t"]), **ASKED)
    np.testing.assert_array_equal(long.time, np.array([0, 1, 33]) * 86_400.0)
    # 24 March 2005, 24 March 2006, 24 April 2007.
    data = bg.read(table, dayfirst=True, **ASKED)
    np.testing.assert_array_equal(data.time, np.array([0, 365, 761]) * 86_400.0)
    with pytest.raises(bg.InputError, match="neither numbers nor dates"):
        bg.read(table, dayfirst=False, **ASKED)
    # Within a day all readings agree.
    clock = table.assign(t=["24-03-05 08:00:00", "24-03-05 08:00:01.5", "24-03-05 08:01:00"])
    np.testing.assert_allclose(bg.read(clock, **ASKED).time, [0.0, 1.5, 60.0])


@pytest.mark.parametrize("kind", [int, float, str])
def test_stamps_without_any_mark_are_dates(kind):
    stamps = [20240305235958, 20240305235959, 20240306000001]
    table = pd.DataFrame({"t": [kind(t) for t in stamps], "y": [1.0, 2.0, 4.0]})
    data = bg.read(table, **ASKED)
    np.testing.assert_array_equal(data.time, [0.0, 1.0, 3.0])
    assert data.unit("t") == "s"
    # A count of that size is none.
    counts = table.assign(t=[20240399000000, 20240399000001, 20240399000002])
    np.testing.assert_array_equal(bg.read(counts, **ASKED).time, counts["t"])


FRAME = pd.DataFrame({"t": [0.0, 1.0, 2.0, 3.0], "y": [1.0, 2.0, 4.0, 3.0]})


@UNTYPED
@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"derivatives": ["ydot"]}, r"derivatives must be a mapping, such as derivatives=\{"),
        ({"units": ["m"]}, r"units must be a mapping"),
        ({"rates": ["y"]}, r"rates must be a mapping"),
        ({"time": None, "dt": "0.1"}, "dt must be positive and a number, not '0.1'"),
        ({"time": None, "dt": np.inf}, "dt must be positive and a number, not inf"),
        ({"skiprows": "3"}, "skiprows counts lines"),
        ({"skiprows": 1.5}, "skiprows counts lines"),
    ],
)
def test_arguments_of_another_kind_are_refused_in_words(changes, said):
    with pytest.raises(bg.InputError, match=said):
        bg.read(FRAME, **ASKED | changes)


@UNTYPED
def test_nothing_is_given_by_none_and_numbers_by_those_of_numpy(tmp_path):
    FRAME.to_csv(tmp_path / "run.csv", index=False)
    for skiprows in (None, np.int64(0), []):
        data = bg.read(tmp_path / "run.csv", time="t", states=["y"], inputs=None, outputs=None, skiprows=skiprows)
        np.testing.assert_array_equal(data.states["y"], FRAME["y"])
    with pytest.raises(bg.InputError, match="give at least one column in states"):
        bg.read(FRAME, time="t", states=None, outputs=["y"])


def test_an_index_that_is_a_column_as_well_is_read_once():
    data = bg.read(FRAME.set_index("t", drop=False), **ASKED)
    np.testing.assert_array_equal(data.time, FRAME["t"])
    two = FRAME.assign(run=["a", "a", "b", "b"]).set_index(["run", "t"], drop=False)
    assert bg.read(two, run="run", **ASKED).run_names == ("a", "b")
    with pytest.raises(bg.InputError, match='both an index and a column "t", which differ'):
        bg.read(FRAME.set_index(FRAME["t"] + 1.0), **ASKED)


def test_a_column_without_any_date_is_named():
    with pytest.raises(bg.InputError, match='"t" of the table has no time in any row'):
        bg.read(FRAME.assign(t=pd.NaT), **ASKED)


@pytest.mark.parametrize("text", ["t,y\n0,1\n1,2\n", "x" * 300 + ".csv", "t,y\n" + "0,1\n" * 200, "run*" + "y" * 300])
def test_text_that_is_no_path_is_said_to_be_none(text):
    with pytest.raises(bg.InputError, match="cannot be the path of a file"):
        bg.read(text, **ASKED)
    with pytest.raises(bg.InputError, match="cannot be the path of a file"):
        bg.read([text], **ASKED)


def test_blanks_around_labels_of_runs_are_no_part_of_them():
    table = FRAME.assign(run=["Run 1 ", "Run 1", " Run 2", "Run 2"])
    assert bg.read(table, run="run", **ASKED).run_names == ("Run 1", "Run 2")


@pytest.mark.parametrize(
    ("stated", "known"),
    [("Nl/min", None), ("Volts", "volts"), ("Bar", "bar"), ("Meter/Sec", "meter/sec"), ("mV", "mV"), ("MV", "MV")],
)
def test_capitals_of_units_have_a_meaning_but_in_words(stated, known):
    data = bg.read(FRAME.rename(columns={"y": f"y [{stated}]"}), **ASKED)
    assert data.unit("y") == known
    assert bool(data.remarks) == (known is None)
