"""Studies of outputs: a force measured beside position and speed, a flow beside a pressure; no derivative anywhere."""

import io
import json
import re

import numpy as np
import pytest
from fabricated import estimated
from rich.console import Console
from static_map import KNOWN, drag_study, few, rig

import bayes_greybox as bg
from bayes_greybox.discovery.subject import studied_equations
from bayes_greybox.report.terminal.fit import fit_tables
from bayes_greybox.report.terminal.study import study_tables
from bayes_greybox.report.words.asked import asked

GIVEN = {"settle": False, "progress": False}


def added(study):
    return study.effects.query("status == 'added'").set_index("slug")


def test_what_a_force_lacks_is_named_with_its_unit():
    row = added(drag_study()).loc["quadratic-drag"]
    assert drag_study().verdict == "named" and row["lower"] < 0.6 < row["upper"] and row["unit"] == "kg/m"
    # Nobody knows which way a force counts: a positive coefficient is as likely as a negative one.
    model = bg.GreyBox(simulation={"R": "-20*x - 2*v"})
    against = bg.find_missing_effects(model, reversed_force(rig(0)), catalogue=few(), **GIVEN)
    assert added(against).loc["quadratic-drag", "probability"] == pytest.approx(row["probability"], abs=1e-4)


def reversed_force(data):
    return bg.Trajectories.from_arrays(
        data.time, states=dict(data.states), outputs={"R": -data.rate("R")}, units=dict(data.units)
    )


def test_an_output_is_called_by_its_name_and_has_no_free_run():
    study = drag_study()
    assert study.sentence.startswith("The simulation lacks quadratic drag in R (probability ")
    assert set(study.gap.index.get_level_values("metric")) == {"output NMSE", "unexplained share"}
    assert study.paths == {} and study.gap.loc[("test", "output NMSE", "R"), "after"] < 0.004
    with pytest.raises(bg.InputError, match="nothing to integrate: what was studied, R, has no derivative"):
        study.free_run(rig(1))
    json.dumps(study.record(), default=float)
    console = Console(width=200, record=True, file=io.StringIO())
    for table in study_tables(study):
        console.print(table)
    text = console.export_text()
    assert "Not integrated, so it has no veto" in text and not re.search(r"d\(R\)|derivative|\brates?\b", text)


def test_rows_may_come_in_any_order():
    order = np.random.default_rng(4).permutation(200)
    model = bg.GreyBox(simulation=KNOWN)
    shuffled = bg.find_missing_effects(model, rig(0, order=order), catalogue=few(), **GIVEN)
    assert shuffled.verdict == "named" and not shuffled.instrument["status"].any()
    found, before = (added(study).loc["quadratic-drag"] for study in (shuffled, drag_study()))
    assert found["mean"] == pytest.approx(before["mean"], rel=1e-3)


@pytest.mark.slow
def test_noise_that_hangs_together_is_found_and_nothing_else():
    data, model = rig(0, drag=0.0, n=300, correlation=0.9), bg.GreyBox(simulation=KNOWN)
    study = bg.find_missing_effects(model, data, effects_at_most=1, **GIVEN)
    assert study.verdict in ("no gap", "instrument") and added(study).empty
    (text,) = study.instrument.query("status == 'in the model'")["text"]
    assert text.startswith("the noise of R is correlated over")


@pytest.mark.slow
def test_a_flow_over_a_pressure_needs_no_state():
    rng, p = np.random.default_rng(0), 2 + 1.9 * np.sin(0.07 * np.arange(150))
    flow = 0.3 * p + 0.8 * np.sqrt(p) + 0.05 * rng.standard_normal(150)
    data = bg.Trajectories.from_arrays(np.arange(150), inputs={"p": p}, outputs={"q": flow})
    model = bg.GreyBox(simulation={"q": "0.3*p"})
    found = bg.find_missing_effects(model, data, catalogue="fluid", roles={"level": "p"}, **GIVEN)
    assert added(found).index.tolist() == ["torricelli-outflow"]
    # Without a word on what the pressure is to the catalogue nothing has a name, and the study says what to give.
    mute = bg.find_missing_effects(model, data, catalogue="fluid", **GIVEN)
    assert (
        any("no column plays the role 'level'; give roles={'level': " in each.text for each in asked(mute))
        or added(mute).size
    )


def test_outputs_are_studied_beside_states():
    data = rig(0)
    both = bg.Trajectories.from_arrays(
        data.time, states=dict(data.states), derivatives={"v": -data.states["x"] + 0.1}, outputs={"R": data.rate("R")}
    )
    model = bg.GreyBox(simulation={"x": "v", "v": "-x", "R": "20*x + 2*v"})
    assert studied_equations(model, both) == ("v", "R")
    assert studied_equations(bg.GreyBox({"R": []}, simulation={"x": "v", "R": "x"}), both) == ("R",)
    # An output that is a state is measured twice, and not kinematic.
    assert studied_equations(bg.GreyBox(simulation={"x": "v", "R": "x"}), data) == ("R",)


def test_what_a_study_of_an_output_cannot_use_is_refused():
    data, model = rig(0), bg.GreyBox(simulation=KNOWN)
    bare = bg.Trajectories.from_arrays(data.time, states=dict(data.states))
    with pytest.raises(bg.InputError, match="The test data have no 'R', which the training data have"):
        bg.find_missing_effects(model, data, bare, progress=False)
    with pytest.raises(bg.InputError, match="not the output 'R': give formulas"):
        bg.find_missing_effects(bg.GreyBox(simulation=lambda t, x, u: x), data, progress=False)
    exact = bg.Trajectories.from_arrays(
        data.time, states=dict(data.states), outputs={"R": 20 * data.states["x"] + 2 * data.states["v"]}
    )
    with pytest.raises(bg.InputError, match="equals every measured output exactly"):
        bg.find_missing_effects(model, exact, progress=False)


@pytest.fixture(scope="module")
def fit():
    """A fit of the extended model."""
    model = bg.GreyBox({"R": ["v*abs(v)"]}, simulation=KNOWN, discrepancy=None)
    return estimated(model, rig(0))


def test_a_fit_of_an_output_predicts_it_and_is_read_back(fit, tmp_path):
    truth = rig(5)
    bare = bg.Trajectories.from_arrays(truth.time, states=dict(truth.states))
    predicted = fit.predict(bare)["R"].rate.mean
    assert np.mean((predicted - truth.rate("R")) ** 2) < 0.004 * np.var(truth.rate("R"))
    assert fit.predict(truth).nmse()["R"] < 0.004
    with pytest.raises(bg.InputError, match="The data have no 'R' to compare"):
        fit.predict(bare).nmse()
    with pytest.raises(bg.InputError, match=r"nothing to integrate: what the model learns, R, .*fit\.predict"):
        fit.simulate(truth)
    assert fit.summary().loc[("R", "sigma"), "unit"] == "N"
    fit.save(tmp_path / "run.nc")
    again = bg.load(tmp_path / "run.nc").data
    assert again.output_names == ("R",) and again.metadata() == fit.data.metadata()
    np.testing.assert_array_equal(again.rate("R"), fit.data.rate("R"))


def test_tables_of_a_fit_call_an_output_by_its_name(fit):
    console = Console(width=200, record=True, file=io.StringIO())
    for table in fit_tables(fit, fit.predict(rig(1)).nmse()):
        console.print(table)
    text = console.export_text()
    assert "Coefficients of R" in text and "Error on held-out data (NMSE): R" in text
