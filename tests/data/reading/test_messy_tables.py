"""Ten tables as they come from instruments and colleagues: each is read, or refused with a remedy that works."""

import os
import re

import numpy as np
import pandas as pd
import pytest
import scipy.io
import xarray as xr

import bayes_greybox as bg

N = 60
T = np.arange(N) * 0.1
Y, V = np.sin(T), np.cos(T)
FRAME = pd.DataFrame({"t": T, "y": Y, "v": V})
ASKED = {"time": "t", "states": ["y", "v"]}


def check(data, n=N):
    np.testing.assert_allclose(data.time, T[:n], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(data.states["y"], Y[:n], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(data.states["v"], V[:n], rtol=1e-9, atol=1e-9)


def remedy(refused, pattern):
    """What the message says to pass."""
    found = re.search(pattern, str(refused.value))
    assert found is not None, str(refused.value)
    return found.group(1)


def test_a_decimal_comma(tmp_path):
    path = tmp_path / "run.csv"
    FRAME.to_csv(path, index=False, sep=";", decimal=",")
    with pytest.raises(bg.InputError, match="row 0 holds") as refused:
        bg.read(path, **ASKED)
    mark = remedy(refused, r'pass decimal="(.)"')
    check(bg.read(path, decimal=mark, **ASKED))
    # The same cells in a frame of words.
    check(bg.read(pd.read_csv(path, sep=";", dtype=str), decimal=mark, **ASKED))


@pytest.mark.parametrize("bracketed", [True, False])
@pytest.mark.parametrize("suffix", [".csv", ".xlsx"])
def test_a_row_of_units_below_the_names(tmp_path, suffix, bracketed):
    units = ["s", "mm", "m/s"]
    row = pd.DataFrame([[f"[{unit}]" if bracketed else unit for unit in units]], columns=FRAME.columns)
    table = pd.concat([row, FRAME.astype(object)], ignore_index=True)
    path = tmp_path / f"run{suffix}"
    table.to_csv(path, index=False) if suffix == ".csv" else table.to_excel(path, index=False)
    data = bg.read(path, **ASKED)
    check(data)
    assert [data.unit(name) for name in ("t", "y", "v")] == units
    assert "was read as units: t in s, y in mm, v in m/s" in repr(data)


@pytest.mark.parametrize("decimals", [1, 2, 3, 4])
@pytest.mark.parametrize("bracketed", [True, False])
def test_a_row_of_units_above_decimal_commas(tmp_path, decimals, bracketed):
    """Three decimals were taken for groups of digits, and a minus in the first row for no number."""
    units = [f"[{unit}]" if bracketed else unit for unit in ("s", "mm", "N")]
    rows = [f"{T[i]:.1f};{-Y[i]:.{decimals}f};{V[i]:.{decimals}f}".replace(".", ",") for i in range(N)]
    (tmp_path / "run.csv").write_text("\n".join(["t;y;F", ";".join(units), *rows]))
    data = bg.read(tmp_path / "run.csv", time="t", states=["y"], inputs=["F"], decimal=",")
    np.testing.assert_allclose(data.states["y"], -Y, atol=10.0**-decimals)
    np.testing.assert_allclose(data.inputs["F"], V, atol=10.0**-decimals)
    assert data.units == {"t": "s", "y": "mm", "F": "N"}


def test_a_row_of_units_beside_the_names_of_runs(tmp_path):
    """The row of units was said to name no run."""
    path = tmp_path / "run.csv"
    text = FRAME.assign(run=np.repeat(["a", "b"], N // 2)).to_csv(index=False)
    path.write_text(text.replace("\n", "\ns,mm,m/s,\n", 1))
    data = bg.read(path, run="run", **ASKED)
    check(data)
    assert data.run_names == ("a", "b") and data.unit("y") == "mm"


def test_dates_in_place_of_seconds(tmp_path):
    path = tmp_path / "run.csv"
    stamps = pd.Timestamp("2024-04-03 08:00") + pd.to_timedelta(T, unit="s")
    FRAME.assign(t=stamps.strftime("%d.%m.%Y %H:%M:%S.%f")).to_csv(path, index=False)
    # Within one hour it does not matter which number is the day.
    data = bg.read(path, **ASKED)
    check(data)
    assert "seconds since the first, 03.04.2024 08:00:00" in repr(data) and data.unit("t") == "s"


def test_two_runs_one_below_the_other(tmp_path):
    path = tmp_path / "run.csv"
    pd.concat([FRAME, FRAME]).to_csv(path, index=False)
    with pytest.raises(bg.InputError, match=f"goes back in row {N}, to 0") as refused:
        bg.read(path, **ASKED)
    data = bg.read(path, restart=remedy(refused, r'pass restart="(\w+)"'), **ASKED)
    assert data.run_names == ("0", "1") and "2 runs" in repr(data)
    check(data.take(0))
    check(data.take(1))
    first, second = data.split(0.5, by="trajectory")
    assert first.run_names == ("0",) and second.run_names == ("1",)


def test_missing_cells(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(re.sub(r"(?m)^0\.3,.*$", "0.3,,n/a", FRAME.round({"t": 1}).to_csv(index=False)))
    with pytest.raises(bg.InputError, match='state "y" has 1 missing') as refused:
        bg.read(path, **ASKED)
    data = bg.read(path, missing=remedy(refused, r'pass missing="(\w+)"'), **ASKED)
    np.testing.assert_allclose(data.states["y"], np.delete(Y, 3), rtol=1e-12)
    assert data.dropped == 1 and "1 row with a missing value was left out" in repr(data)


def test_stamps_that_jitter(tmp_path):
    path = tmp_path / "run.csv"
    jitter = T + np.random.default_rng(0).uniform(-0.03, 0.03, N)
    pd.DataFrame({"t": jitter, "y": np.sin(jitter)}).to_csv(path, index=False)
    data = bg.read(path, time="t", states=["y"])
    np.testing.assert_allclose(data.time, jitter, rtol=1e-12)
    with pytest.raises(bg.InputError, match="not sampled evenly") as refused:
        data.differentiate(rates={"y": "v"})
    even = data.resample(float(remedy(refused, r"data\.resample\(([\d.e-]+)\)")))
    np.testing.assert_allclose(even.states["y"], np.sin(even.time), atol=1e-3)
    rates = even.differentiate(rates={"y": "v"})
    np.testing.assert_allclose(rates.derivatives["y"], np.cos(rates.time), atol=0.02)


def test_a_sheet_of_excel(tmp_path):
    FRAME.to_excel(tmp_path / "run.xlsx", index=False)
    check(bg.read(tmp_path / "run.xlsx", **ASKED))


def test_a_data_set_of_xarray(tmp_path):
    table = xr.Dataset({"y": ("t", Y, {"units": "mm"}), "v": ("t", V, {"units": "m s-1"})}, {"t": ("t", T)})
    data = bg.read(table, **ASKED)
    check(data)
    assert data.units == {"y": "mm", "v": "m*s^-1"}
    table.to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    check(bg.read(tmp_path / "run.nc", **ASKED))


@pytest.mark.skipif(os.environ.get("BAYES_GREYBOX_TYPECHECK", "0") == "1", reason="the checker of types answers first")
def test_a_frame_given_to_a_fit():
    model = bg.GreyBox(dictionary={"y": ["y"]})
    with pytest.raises(bg.InputError, match=r"bg\.read\(") as refused:
        model.fit(FRAME)
    assert remedy(refused, r"(time=\.\.\., states=)")
    check(bg.read(FRAME, **ASKED))


def test_a_matrix_of_matlab(tmp_path):
    scipy.io.savemat(tmp_path / "run.mat", {"t": T, "X": np.column_stack([Y, V]), "fs": 10.0})
    with pytest.raises(bg.InputError, match=r'has no column "y"') as refused:
        bg.read(tmp_path / "run.mat", **ASKED)
    names = remedy(refused, r"Its columns are (.*)\.").split(", ")
    assert names == ["t", "X_1", "X_2"]
    data = bg.read(tmp_path / "run.mat", time=names[0], states={"y": names[1], "v": names[2]})
    check(data)
    assert "the columns of X are X_1, X_2" in repr(data)
    assert bg.read(tmp_path / "run.mat", time="t", states=["X"]).state_names == ("X_1", "X_2")
