"""The calibration benchmark's files, resumption, shell and figure, with a calibration made up beforehand."""

import json
import os

import numpy as np
import pandas as pd
import pytest

import bayes_greybox as bg
from bayes_greybox.criticism.calibration.calibrate import Calibration
from bayes_greybox.criticism.calibration.reliability import reliability
from benchmarks import calibration as benchmark
from benchmarks.__main__ import main


def made_up(replicates=100, broken=False):
    rng = np.random.default_rng(0)
    names = ["x_theta[x]", "x_theta[x**2]", "x_sigma", "x_f[data]", "x_log_likelihood"]
    pit = pd.DataFrame(rng.random((replicates, len(names))), columns=names)
    p = rng.random((replicates, 2))
    gamma, draws = (rng.random((replicates, 2)) < p) * 1.0, (rng.random((replicates, 50, 2)) < p[:, None]) * 1.0
    tests = pd.DataFrame({"kind": "rank", "p": 0.5, "adjusted": 1.0, "passed": True}, index=pd.Index(names))
    tests.index.name = "quantity"
    if broken:
        pit["x_sigma"] **= 2
        tests.loc["x_sigma", ["p", "adjusted", "passed"]] = [1e-6, 5e-6, False]
    coverage = pd.DataFrame(
        {"coverage": [0.51, 0.9], "se": 0.02, "places": 12},
        index=pd.MultiIndex.from_tuples(
            [("x", "data", 0.5), ("x", "data", 0.9)], names=["equation", "region", "level"]
        ),
    )
    return Calibration(
        level=0.01,
        tests=tests,
        ranks=(pit * 200).astype(int),
        kept=pit * 0 + 200,
        pit=pit,
        ess=pd.Series(200.0, index=names),
        inclusion={"x": reliability(gamma, p, draws, ["x", "x**2"], rng)},
        coverage=coverage,
        divergences=np.zeros(replicates, int),
        seconds=1.5,
    )


@pytest.fixture
def counted(monkeypatch):
    """Names of what was calibrated; the second is broken."""
    calls = []

    def calibrate(model, data, *, replicates, seed, progress):
        calls.append(type(model.prior).__name__)
        return made_up(replicates, broken=len(calls) == 2)

    monkeypatch.setattr(benchmark, "calibrate", calibrate)
    return calls


def test_the_shell_writes_tables_and_figures_and_goes_on_where_it_was(counted, tmp_path, capsys):
    words = ["calibration", "-o", str(tmp_path), "--replicates", "100", "--no-progress", "--cases"]
    assert main([*words, "2"]) == 0
    assert len(counted) == 2
    files = {
        "results.jsonl",
        "spike-and-slab_projected.csv",
        "calibration.csv",
        "summary.json",
        "figures",
    }
    assert files <= set(os.listdir(tmp_path))
    assert len(os.listdir(tmp_path / "figures")) == 2
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert [row["passed"] for row in summary["calibration"]] == [True, False]
    assert summary["calibration"][1]["worst"] == "x_sigma"
    assert summary["calibration"][0]["coverage_data"] == 0.9
    out = capsys.readouterr().out
    assert "spike-and-slab_projected" in out and "x_sigma" in out
    assert main([*words, "3"]) == 0
    assert len(counted) == 3
    # Other settings are another run.
    assert main([*words[:3], "--replicates", "50", "--no-progress", "--cases", "1"]) == 0
    assert len(counted) == 4


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["calibration", "--workers", "2"], "--workers does not apply to calibration"),
        (["hidden-effects", "--replicates", "50"], "--replicates does not apply to hidden-effects"),
        (["calibration", "--cases", "99"], "There are 17 variants to calibrate, not 99"),
        (["calibration", "--replicates", "3"], "replicates=3"),
    ],
)
def test_wrong_use_is_refused(words, sentence, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([*words]) == 2
    assert sentence in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


def test_a_folder_that_cannot_be_written_to_is_refused(counted, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["calibration", "-o", str(tmp_path / "file" / "out"), "--no-progress"]) == 2
    assert "Cannot write to the folder" in capsys.readouterr().err
    assert counted == []


def test_the_figure_has_a_panel_for_each_quantity_and_marks_what_failed():
    found = made_up(broken=True)
    figure = bg.figures.calibration(found)
    figure.canvas.draw()
    shown = [ax for ax in figure.axes if ax.get_visible()]
    assert [ax.get_title(loc="left") for ax in shown] == [*found.pit, "x: P(included)"]
    curves = {ax.get_title(loc="left"): ax.get_lines()[1] for ax in shown}
    np.testing.assert_allclose(curves["x_sigma"].get_ydata(), found.ecdf_differences["x_sigma"])
    assert curves["x_sigma"].get_color() != curves["x_f[data]"].get_color()
    band = found.band
    inside = (found.ecdf_differences["x_sigma"].to_numpy() - band.lower >= 0) & (
        found.ecdf_differences["x_sigma"].to_numpy() - band.upper <= 0
    )
    assert not inside.all()


def test_nothing_to_draw_is_refused():
    with pytest.raises(bg.InputError, match="no ranks"):
        bg.plots.plot_calibration(pd.DataFrame(), np.zeros(0), np.zeros(0), pd.DataFrame())
    with pytest.raises(bg.InputError, match="lacks the column 'count'"):
        found = made_up()
        bins = {"x": found.inclusion["x"].bins.drop(columns="count")}
        bg.plots.plot_calibration(found.ecdf_differences, found.band.lower, found.band.upper, found.tests, bins)
