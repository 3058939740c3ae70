"""How a fit does on data: on held-out ones where they were given, kept in its file, found once."""

from dataclasses import replace

import numpy as np
import pytest
from fabricated import estimated

import bayes_greybox as bg
from bayes_greybox.criticism import trial as module
from bayes_greybox.criticism.kept.file import kept_results, restore_results
from bayes_greybox.criticism.trial import trial, try_on
from bayes_greybox.greybox import Fit
from bayes_greybox.running.errors import InputError


@pytest.fixture(scope="module")
def parts():
    data = bg.systems.oscillator().simulate(np.linspace(0.0, 30.0, 90), noise=0.02, seed=1)
    return data.split(0.7)


@pytest.fixture(scope="module")
def made(parts):
    model = bg.GreyBox({"ydot": ["y**3", "ydot**3"]}, simulation={"y": "ydot"}, discrepancy=None)
    return estimated(model, parts[0])


def again(fit, known=True):
    """The fit, and what is known of it or nothing."""
    found = Fit(fit.model, fit.data, fit.sampling, fit.idata)
    found.memory.update(fit.memory if known else {})
    return found


@pytest.fixture
def fit(made):
    """The fit, of which nothing is known yet."""
    return again(made, known=False)


@pytest.fixture(scope="module")
def over_training(made):
    found = again(made, known=False)
    trial(found)
    return found


@pytest.fixture(scope="module")
def held_out(over_training, parts):
    found = again(over_training)
    try_on(found, parts[1])
    return found


def test_without_held_out_data_it_is_the_free_run_over_the_training_data(over_training):
    fit, found = over_training, trial(over_training)
    assert (found.held_out, found.nmse, found.n_obs) == (False, {}, fit.data.n_obs)
    assert found.run.nrmse().equals(fit.simulate(fit.data).nrmse()) and trial(fit) is found


def test_held_out_data_take_their_place(over_training, held_out, parts):
    fit, found = held_out, trial(held_out)
    assert not trial(over_training).held_out and found.held_out and found.n_obs == parts[1].n_obs
    assert found.nmse == fit.predict(parts[1]).nmse().to_dict()
    # The true terms, and 2 % noise on the rate alone.
    assert found.run.nrmse()["y"] < 0.05
    with pytest.raises(InputError, match="unknown name 'ydot'"):
        try_on(fit, bg.Trajectories.from_arrays(parts[1].time, states={"y": parts[1].states["y"]}))


@pytest.mark.slow
def test_the_file_keeps_it_so_that_nothing_is_integrated_again(fit, parts, tmp_path, monkeypatch):
    fit.save(tmp_path / "run.nc", test=parts[1])
    monkeypatch.setattr(module, "free_run", lambda *_: pytest.fail("integrated again"))
    read = bg.load(tmp_path / "run.nc")
    found, kept = trial(read), trial(fit)
    assert (found.held_out, found.nmse, found.run.holds) == (True, kept.nmse, kept.run.holds)
    for name, band in kept.run.states.items():
        for part in ("mean", "sd", "lower", "upper"):
            np.testing.assert_array_equal(getattr(found.run.states[name], part), getattr(band, part))
    np.testing.assert_array_equal(found.run.failed_at, kept.run.failed_at)
    assert found.run.data.metadata() == kept.run.data.metadata() and "trial" not in read.idata.children
    read.to_html(tmp_path / "read.html")
    fit.to_html(tmp_path / "made.html")
    assert (tmp_path / "read.html").read_bytes() == (tmp_path / "made.html").read_bytes()


def test_it_is_not_that_of_other_draws(held_out):
    fit = again(held_out)
    thinned = fit.idata.copy()
    thinned["posterior"] = thinned["posterior"].isel(draw=slice(0, 20))
    other = Fit(fit.model, fit.data, fit.sampling, thinned)
    text = kept_results(fit)["trial"]
    restore_results(other, text)
    assert other.memory == {}
    fit.memory.clear()
    restore_results(fit, text)
    assert trial(fit).held_out


def test_where_there_is_no_free_run_it_says_why(fit, parts, monkeypatch, tmp_path):
    open_ended = Fit(bg.GreyBox({"ydot": ["y**3", "ydot**3"]}, discrepancy=None), fit.data, fit.sampling, fit.idata)
    assert trial(open_ended).run is None and "'y' has no equation to integrate" in trial(open_ended).why
    assert try_on(open_ended, parts[1]).nmse["ydot"] == pytest.approx(fit.predict(parts[1]).nmse()["ydot"])
    open_ended.to_html(tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "There is no free run. State" in page and "error of the predicted d(ydot)/dt" in page
    monkeypatch.setattr(module, "FREE_RUN_ROWS", 10)
    assert "fit.simulate(data) makes it" in trial(fit).why


@pytest.mark.parametrize("ask", [Fit.predict, Fit.simulate, try_on])
def test_data_in_other_units_than_those_of_the_fit_are_refused(fit, parts, ask, tmp_path):
    units = {**fit.data.units, "y": "m"}
    known = Fit(fit.model, replace(fit.data, units=units), fit.sampling, fit.idata)
    with pytest.raises(InputError, match="test data have y in mm, the training data in m: convert them"):
        ask(known, replace(parts[1], units={**units, "y": "mm"}))
    with pytest.raises(InputError, match="have t in ms, the training data in"):
        ask(replace_units(known, t="s"), replace(parts[1], units={**units, "t": "ms"}))


def replace_units(fit, **units):
    return Fit(fit.model, replace(fit.data, units={**fit.data.units, **units}), fit.sampling, fit.idata)
