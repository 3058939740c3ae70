import sys

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io
import xarray as xr

from bayes_greybox.data.reading.door import read_table
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError

N = 12
T = np.arange(N) * 0.5
COLUMNS = {"time": T, "pos": np.sin(T), "acc": -np.sin(T), "force": T**2}
RUN = np.repeat(["b", "a"], [8, 4])


def write(folder, suffix, **extra):
    path = folder / f"run{suffix}"
    frame = pd.DataFrame(COLUMNS | extra)
    if suffix == ".parquet":
        frame.to_parquet(path)
    elif suffix == ".mat":
        scipy.io.savemat(path, {k: v for k, v in frame.items()} | {"fs": 2.0, "label": "run 1"})
    elif suffix == ".v73.mat":
        with h5py.File(path, "w", userblock_size=512) as file:
            for name, values in frame.items():
                file[name] = values.to_numpy()[None, :]
            file["remark"] = np.frombuffer(("more letters than rows " * N).encode("utf-16-le"), np.uint16)[:, None]
            file["remark"].attrs["MATLAB_class"] = np.bytes_("char")
        # The header by which MATLAB marks version 7.3 files: text, then version 2.0 and byte order.
        with open(path, "r+b") as file:
            file.write(b"MATLAB 7.3 MAT-file".ljust(116) + bytes(8) + b"\x00\x02IM")
    elif suffix == ".nc":
        xr.Dataset({k: ("row", v.to_numpy()) for k, v in frame.items()}).to_netcdf(path, engine="h5netcdf")
    else:
        frame.to_csv(path, index=False, sep={".tsv": "\t", ".txt": ";"}.get(suffix, ","))
    return path


@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".txt", ".parquet", ".mat", ".v73.mat", ".nc"])
def test_every_format_gives_the_same_data(tmp_path, suffix):
    data = read_table(
        write(tmp_path, suffix),
        time="time",
        states={"y": "pos"},
        inputs=["force"],
        derivatives={"y": "acc"},
        units={"time": "s", "y": "m"},
    )
    np.testing.assert_allclose(data.time, T, rtol=1e-15)
    np.testing.assert_allclose(data.states["y"], np.sin(T), rtol=1e-15)
    np.testing.assert_allclose(data.inputs["force"], T**2, rtol=1e-15)
    np.testing.assert_allclose(data.derivatives["y"], -np.sin(T), rtol=1e-15)
    assert data.unit("t") == "s" and data.unit("y") == "m"


def test_a_map_is_read_without_states(tmp_path):
    path = write(tmp_path, ".csv")
    data = read_table(path, dt=1.0, inputs={"x": "pos"}, outputs={"R": "acc"}, units={"x": "m", "R": "N"})
    np.testing.assert_allclose(data.rate("R"), -np.sin(T), rtol=1e-15)
    assert data.state_names == () and data.output_names == ("R",) and data.unit("R") == "N"
    assert read_table(path, dt=1.0, states=["pos"], outputs=["force"]).output_names == ("force",)
    with pytest.raises(InputError, match='has no column "forces"'):
        read_table(path, dt=1.0, states=["pos"], outputs=["forces"])


def test_text_with_spaces_between_columns(tmp_path):
    path = tmp_path / "run.txt"
    path.write_text("t y\n0 1\n1  2\n2 4\n")
    np.testing.assert_array_equal(read_table(path, time="t", states=["y"]).states["y"], [1.0, 2.0, 4.0])


def test_runs_come_in_the_order_of_the_file(tmp_path):
    data = read_table(write(tmp_path, ".csv", id=RUN), time="time", states=["pos"], trajectory="id")
    assert data.run_names == ("b", "a") and data.run_lengths == (8, 4)
    np.testing.assert_allclose(data.take("a").time, T[8:])


def test_sample_spacing_in_place_of_a_time_column(tmp_path):
    data = read_table(write(tmp_path, ".csv", id=RUN), dt=0.25, states=["pos"], trajectory="id")
    np.testing.assert_allclose(data.take("a").time, np.arange(4) * 0.25)


def test_empty_cells_are_missing_values(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,y\n0,1\n1,\n2,4\n")
    with pytest.raises(InputError, match=r'state "y" has 1 missing .* row 1'):
        read_table(path, time="t", states=["y"])
    data = read_table(path, time="t", states=["y"], missing="drop")
    assert data.dropped == 1 and data.n_obs == 2


def test_unknown_column_offers_the_nearest(tmp_path):
    path = write(tmp_path, ".csv")
    with pytest.raises(
        InputError,
        match=r'no column "Forse". Did you mean force or pos\? Its columns are time, pos, acc, force',
    ):
        read_table(path, time="time", states=["pos"], inputs=["Forse"])


def test_text_in_a_column_is_located(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,y\n0,1\n1,high\n2,4\n")
    with pytest.raises(InputError, match=r"""Column "y" of .* not numeric: row 1 holds 'high'"""):
        read_table(path, time="t", states=["y"])


def test_files_that_cannot_be_read_are_named(tmp_path):
    def read(name, content=None):
        path = tmp_path / name
        if content is not None:
            path.write_bytes(content)
        return read_table(path, time="t", states=["y"])

    with pytest.raises(InputError, match=r'no file ".*absent.csv"'):
        read("absent.csv")
    with pytest.raises(InputError, match=r'empty.csv" is empty'):
        read("empty.csv", b"")
    with pytest.raises(InputError, match=r'header.csv" has no rows'):
        read("header.csv", b"t,y\n")
    with pytest.raises(InputError, match=r"unknown extension; readable are .csv"):
        read("run.doc", b"t,y\n0,1\n")
    for name in ("run.parquet", "run.mat", "run.nc"):
        with pytest.raises(InputError, match=rf'{name}" cannot be read as'):
            read(name, b"not a table of this kind, only words" * 20)


def test_a_saved_fit_is_recognised(tmp_path):
    path = tmp_path / "fit.nc"
    xr.DataTree.from_dict({"posterior": xr.Dataset({"theta": ("draw", T)})}).to_netcdf(path, engine="h5netcdf")
    with pytest.raises(InputError, match=r'fit.nc" is a saved fit, not a table; open it with bg.load'):
        read_table(path, time="t", states=["y"])


def test_parquet_without_pyarrow_names_the_extra(tmp_path, monkeypatch):
    path = write(tmp_path, ".parquet")
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(InputError, match=r'pip install "\.\[tables\]"'):
        read_table(path, time="time", states=["pos"])


def test_contradictory_requests(tmp_path):
    path = write(tmp_path, ".csv", id=[None, *RUN[1:]])
    with pytest.raises(InputError, match="either time"):
        read_table(path, states=["pos"])
    with pytest.raises(InputError, match="either time"):
        read_table(path, time="time", dt=0.1, states=["pos"])
    with pytest.raises(InputError, match="dt must be positive"):
        read_table(path, dt=-1.0, states=["pos"])
    with pytest.raises(InputError, match="names no run in row 0"):
        read_table(path, time="time", states=["pos"], trajectory="id")
    with pytest.raises(InputError, match=r'states must be a list of names, such as \["pos"\]'):
        read_table(path, time="time", states="pos")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("run.csv", "t,y,F\n0,1,5\n1,2,6\n2,4,7\n"),
        ("run.csv", "t;y;F\n0;1;5\n1;2;6\n2;4;7\n"),
        ("run.csv", "t,y,F\n0,1,5,\n1,2,6,\n2,4,7,\n"),
        ("run.csv", "\ufefft,y,F\n0,1,5\n1,2,6\n2,4,7\n"),
        ("run.txt", "# t y F\n0 1 5\n1 2 6\n2 4 7\n"),
        ("run.csv", "# made on a Monday\n# t,y,F\n0,1,5\n1,2,6\n2,4,7\n"),
        ("run.csv", "# made on a Monday, twice\n\nt,y,F\n0,1,5\n1,2,6\n2,4,7\n"),
        ("run.tsv", "#t\ty\tF\n0\t1\t5\n1\t2\t6\n2\t4\t7\n"),
        ("run.txt", "% made on a Monday, twice\n%\n% t y F\n0 1 5\n1 2 6\n2 4 7\n"),
        ("run.csv", "% made on a Monday\nt,y,F\n0,1,5\n1,2,6\n2,4,7\n"),
        ("run.txt", "% t y F\n% [s] [m] [N]\n0 1 5\n1 2 6\n2 4 7\n"),
    ],
    ids=[
        "plain",
        "semicolons",
        "delimiters at the end",
        "mark",
        "savetxt",
        "remark",
        "remark above names",
        "tabs",
        "per cent",
        "per cent above names",
        "units behind per cent",
    ],  # fmt: skip
)
def test_text_is_read_as_it_is_meant(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    data = read_table(path, time="t", states=["y"], inputs=["F"])
    np.testing.assert_array_equal(data.time, [0, 1, 2])
    np.testing.assert_array_equal(data.states["y"], [1, 2, 4])
    np.testing.assert_array_equal(data.inputs["F"], [5, 6, 7])


@pytest.mark.parametrize("text", ["t,y\n0,1,9\n1,2,9\n2,4,9\n", "# t y\n0 1 9\n1 2 9\n2 4 9\n"])
def test_rows_with_more_values_than_names_are_refused(tmp_path, text):
    path = tmp_path / ("run.csv" if "," in text else "run.txt")
    path.write_text(text)
    with pytest.raises(InputError, match="names 2 columns, but its first row has 3|Length of header"):
        read_table(path, time="t", states=["y"])


@pytest.mark.parametrize("kind", ["dates", "durations"])
def test_dates_are_seconds_and_never_counted_in_nanoseconds(tmp_path, kind):
    stamps = pd.to_datetime("2024-05-01") + pd.to_timedelta(T, unit="s")
    frame = pd.DataFrame({"time": stamps if kind == "dates" else stamps - stamps[0], "pos": np.sin(T)})
    frame.to_parquet(tmp_path / "run.parquet")
    data = read_table(tmp_path / "run.parquet", time="time", states=["pos"])
    np.testing.assert_array_equal(data.time, T)
    assert data.unit("t") == "s"
    with pytest.raises(InputError, match=r'Column "time" .* holds dates, which only the time may'):
        read_table(tmp_path / "run.parquet", dt=0.5, states=["time"])
    with pytest.raises(InputError, match="holds dates"):
        Trajectories.from_arrays(frame["time"].to_numpy(), states={"pos": np.sin(T)})
