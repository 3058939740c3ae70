"""Rows that are chosen by what the data have."""

from dataclasses import replace

import numpy as np
import pytest
from sampled_oscillator import SIMULATION, sampled

import bayes_greybox as bg
from bayes_greybox.model.rows.kinds import AsMeasured
from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.report.folders.record import run_record

SHORT = {"draws": 100, "tune": 100, "chains": 1, "progress": False}


def states(**measured):
    t = np.linspace(0, 1, 20)
    return bg.Trajectories.from_arrays(t, states={"y": np.cos(t), "v": -np.sin(t)}, **measured)


@pytest.mark.parametrize(
    ("measured", "kind", "words"),
    [
        ({}, bg.TrajectoryRows, "samples of y, v along a path"),
        ({"derivatives": {"v": np.ones(20)}}, bg.DerivativeRows, "measured rates"),
        ({"outputs": {"R": np.ones(20)}}, bg.DerivativeRows, "measured outputs"),
    ],
)
def test_rates_and_outputs_count_before_samples(measured, kind, words):
    data = states(**measured)
    rows = AsMeasured().chosen(data)
    assert type(rows) is kind and rows.in_words(data) == words


def test_filtered_rates_say_so():
    data = states().differentiate(method="savgol", window=7)
    assert AsMeasured().chosen(data).in_words(data) == "filtered rates"


def test_what_was_asked_for_stays():
    assert bg.WeakRows().chosen(states()).in_words(states()) == "integrals of y, v with test functions"
    assert bg.DerivativeRows().chosen(states()) == bg.DerivativeRows()
    assert bg.TrajectoryRows(substeps=3).chosen(states()) == bg.TrajectoryRows(substeps=3)


def test_completed_samples_are_samples_still():
    data = sampled(lambda y, v: -0.3 * y**3, n=60)
    model, completed = bg.GreyBox({"v": ["y**3"]}, simulation=SIMULATION, discrepancy=None).near(data)
    assert completed.derivative_names and type(AsMeasured().chosen(completed)) is type(model.rows)


@pytest.mark.slow
def test_a_fit_of_samples_needs_no_word_about_rows_and_says_what_it_took(tmp_path):
    data = sampled(lambda y, v: -0.3 * y**3, n=120)
    model = bg.GreyBox({"v": ["y**3"]}, simulation=SIMULATION, discrepancy=None)
    fit = model.fit(data, **SHORT)
    asked = bg.GreyBox({"v": ["y**3"]}, simulation=SIMULATION, discrepancy=None, rows=bg.TrajectoryRows())
    assert fit.inclusion().equals(asked.fit(data, **SHORT).inclusion())
    assert "120 rows (samples of y along a path)" in repr(fit)
    assert run_record(fit, {}, 0.0, None)["data"]["of"] == "samples of y along a path"
    fit.save(tmp_path / "fit.nc")
    assert bg.load(tmp_path / "fit.nc").model.rows == fit.model.rows


@pytest.mark.slow
def test_a_study_of_samples_needs_no_word_about_rows():
    data = sampled(lambda y, v: -0.3 * y**3, n=150)
    few = [replace(e, confusions=()) for e in load_catalogue("mechanical") if e.slug in ("cubic-stiffness", "backlash")]
    study = bg.find_missing_effects(
        bg.GreyBox(simulation=SIMULATION), data, catalogue=few, settle=False, free_runs=False, progress=False
    )
    assert study.effects["slug"][0] == "cubic-stiffness"
    assert type(study.base.rows) is bg.TrajectoryRows


def test_several_equations_of_samples_with_a_discrepancy_are_refused_with_both_remedies():
    with pytest.raises(bg.InputError, match=r"discrepancy=None.*data\.differentiate\(\)"):
        bg.GreyBox({"y": ["v"], "v": ["y"]}).fit(states(), **SHORT)
