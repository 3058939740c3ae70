"""Checks in a saved fit: read back whole, made again where the file has none."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from fabricated import estimated, fabricate

import bayes_greybox as bg
from bayes_greybox.criticism.checks.checks import checks
from bayes_greybox.criticism.discrepancy import discrepancy_table
from bayes_greybox.criticism.kept import file as kept
from bayes_greybox.criticism.kept.file import save_found
from bayes_greybox.criticism.trial import trial
from bayes_greybox.inference.kept import netcdf


@pytest.fixture(scope="module")
def fit():
    data = bg.systems.oscillator().simulate(np.linspace(0.0, 30.0, 60), noise=0.02, seed=1)
    model = bg.GreyBox({"ydot": ["y**3", "ydot**3"]}, simulation={"y": "ydot"}, discrepancy=None)
    return estimated(model, data)


def test_checks_come_back_with_the_fit(fit, tmp_path, monkeypatch):
    made = fit.checks()
    fit.save(tmp_path / "run.nc")
    read = bg.load(tmp_path / "run.nc")
    monkeypatch.setattr("bayes_greybox.criticism.checks.checks.loo_pit", lambda *_: pytest.fail("made again"))
    found = read.checks()
    assert str(found) == str(made) and found.ok == made.ok
    pd.testing.assert_frame_equal(found.table, made.table)
    pd.testing.assert_frame_equal(found.sensitivity, made.sensitivity)
    for name in made.loo_pit:
        np.testing.assert_array_equal(found.loo_pit[name].value, made.loo_pit[name].value)
        assert found.loo_pit[name].wrong == made.loo_pit[name].wrong
        np.testing.assert_array_equal(found.whiteness[name].bound, made.whiteness[name].bound)
        assert found.whiteness[name].standing_out == made.whiteness[name].standing_out


def test_what_is_found_later_is_added_to_a_saved_fit_as_if_all_were_saved_anew(fit, tmp_path):
    fit.memory.clear()
    fit.save(tmp_path / "before.nc")
    fit.checks()
    trial(fit)
    save_found(fit, tmp_path / "before.nc", tmp_path / "added.nc")
    fit.save(tmp_path / "anew.nc")
    added, anew = (netcdf.read(tmp_path / name) for name in ("added.nc", "anew.nc"))
    xr.testing.assert_identical(added, anew)
    assert all(v.encoding["zlib"] for v in added[netcdf.TRIED].data_vars.values())
    # What was there is as it was, and nothing that was sealed can be changed.
    assert netcdf.TRIED not in netcdf.read(tmp_path / "before.nc").children
    raw = bytearray((tmp_path / "added.nc").read_bytes())
    raw[len(raw) // 2] ^= 1
    (tmp_path / "added.nc").write_bytes(raw)
    with pytest.raises(bg.InputError, match="damaged"):
        bg.load(tmp_path / "added.nc")


def test_what_cannot_be_added_is_refused(fit, tmp_path):
    fit.save(tmp_path / "run.nc")
    with pytest.raises(bg.InputError, match="Cannot write"):
        save_found(fit, tmp_path / "run.nc", tmp_path / "nowhere" / "run.nc")


def test_without_checks_in_the_file_they_are_made(fit, tmp_path):
    fit.memory.clear()
    fit.save(tmp_path / "run.nc")
    read = bg.load(tmp_path / "run.nc")
    assert read.memory == {}
    assert str(read.checks()) == str(checks(fit))


def test_checks_of_another_format_are_not_read(fit, tmp_path, monkeypatch):
    fit.checks()
    monkeypatch.setattr(kept, "RESULTS_FORMAT", kept.RESULTS_FORMAT + 1)
    fit.save(tmp_path / "run.nc")
    monkeypatch.undo()
    assert netcdf.TRIED in netcdf.read(tmp_path / "run.nc").children
    assert bg.load(tmp_path / "run.nc").memory == {}


def test_checks_of_another_version_are_made_again_but_its_trial_stays(fit, tmp_path, monkeypatch):
    fit.checks()
    trial(fit)
    monkeypatch.setattr(kept, "version", lambda name: "0.0.1")
    fit.save(tmp_path / "run.nc")
    monkeypatch.undo()
    assert [name.split(".")[-1] for name in bg.load(tmp_path / "run.nc").memory] == ["trial"]


def test_results_replace_those_that_a_saved_fit_had(fit, tmp_path):
    fit.memory.clear()
    discrepancy_table(fit)
    fit.save(tmp_path / "before.nc")
    fit.checks()
    save_found(fit, tmp_path / "before.nc", tmp_path / "added.nc")
    read = bg.load(tmp_path / "added.nc")
    assert str(read.checks()) == str(fit.checks())
    assert {name.split(".")[-1] for name in read.memory} == {"checks", "plain_trade_offs"}


def test_checks_are_not_those_of_other_draws(fit, tmp_path):
    fit.checks()
    fit.save(tmp_path / "run.nc")
    with xr.open_datatree(tmp_path / "run.nc", engine="h5netcdf") as opened:
        tree = opened.load()
    theta = tree["posterior"]["ydot_theta"]
    tree["posterior"]["ydot_theta"] = theta + 1.0
    tree.to_netcdf(tmp_path / "changed.nc", engine="h5netcdf")
    assert bg.load(tmp_path / "run.nc").memory
    assert not bg.load(tmp_path / "changed.nc").memory


def test_the_plain_kernel_is_not_drawn_again_for_a_saved_fit(tmp_path, monkeypatch):
    data = bg.systems.oscillator().simulate(np.linspace(0.0, 30.0, 60), noise=0.02, seed=1)
    model = bg.GreyBox({"ydot": ["y"]}, discrepancy=bg.OrthogonalGP(features=4))
    drawn = fabricate(model, data, draws=50, weight=0.1 * np.random.default_rng(0).standard_normal((2, 50, 16)))
    fit = bg.Fit(drawn.model, drawn.data, drawn.sampling, drawn.idata)
    made = discrepancy_table(fit)
    fit.save(tmp_path / "run.nc")
    with xr.open_datatree(tmp_path / "run.nc", engine="h5netcdf") as opened:
        tree = opened.load()
    tree["posterior"]["ydot_sigma"] = 2.0 * tree["posterior"]["ydot_sigma"]
    tree.to_netcdf(tmp_path / "changed.nc", engine="h5netcdf")
    asked = []
    monkeypatch.setattr("bayes_greybox.criticism.trade_off.redrawn", lambda design, draws: asked.append(1) or draws)
    read = bg.load(tmp_path / "run.nc")
    pd.testing.assert_frame_equal(discrepancy_table(read), made)
    assert made["overlap_none"]["ydot"] > 10 * made["overlap"]["ydot"] and not asked
    # Of other draws the file says nothing.
    discrepancy_table(bg.load(tmp_path / "changed.nc"))
    assert asked
