"""The names that users hold: all of them resolve, old ones too, and results have what they are said to have."""

import ast
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import pytest

import bayes_greybox as bg
from bayes_greybox.criticism.kept.file import load_checked

ROOT = Path(bg.__file__).parent
STUB = ast.parse((ROOT / "__init__.pyi").read_text(encoding="utf-8"))
NAMES = [alias.asname for node in STUB.body if isinstance(node, ast.ImportFrom) for alias in node.names]

# What was public before names were moved: it keeps working.
BEFORE = """
    Calibration calibrate compare cross_validate dataset_table load_dataset InputError read_table Trajectories Odds Fit
    GreyBox load Study find_missing_effects OrthogonalGP CustomPrior Laplace Normal RegularisedHorseshoe SpikeAndSlab
    systems Dictionary Term polynomial PriorComparison compare_priors figures plots study_figures __version__
""".split()
RETURNED = [
    "Verdict",
    "Prediction",
    "FreeRun",
    "Checks",
    "LooPit",
    "DiscrepancyGrid",
    "Loo",
    "DerivativeRows",
    "LearnedRates",
    "Noise",
    "priors",
    "Candidate",
    "NextExperiment",
    "signals",
]

FIGURES = """
    calibration autocorrelation coefficients discrepancy_over_states discrepancy_over_time fit_figures loo_pit predicted
    predictive sensitivity study_figures trade_off
""".split()
STUDY_FIGURES = """
    study_figures gap_map gap_over_time ranking rounds coefficients free_run added name_of marked support
""".split()
PLOTS = """
    Coefficient plot_calibration plot_autocorrelation plot_coefficients plot_comparison plot_confounding
    plot_discrepancy_over_states plot_discrepancy_over_time plot_free_run plot_gap_curve plot_gap_map plot_gap_over_time
    plot_hypotheses plot_loo_pit plot_posteriors plot_predicted plot_predictive plot_rounds plot_sensitivity
    plot_tradeoff save_figures
""".split()


def test_every_name_of_the_stub_resolves_and_is_listed():
    assert len(NAMES) == len(set(NAMES)) and None not in NAMES
    for name in NAMES:
        assert getattr(bg, name) is not None
    assert set(NAMES) <= set(dir(bg))
    assert {*BEFORE, *RETURNED, "catalogue", "read"} <= {*NAMES, "figures", "__version__"}
    with pytest.raises(AttributeError, match="no_such_name"):
        bg.no_such_name  # noqa: B018


@pytest.mark.parametrize("name", ["plots", "priors", "signals", "study_figures"])
def test_a_name_can_be_the_first_that_is_used(name):
    subprocess.run([sys.executable, "-c", f"import bayes_greybox as bg; bg.{name}"], check=True, cwd=ROOT.parent)


def test_one_door_has_every_figure_and_the_old_doors_lead_to_it():
    assert {*PLOTS, *FIGURES, "gap_map", "free_run", "ranking", "added_coefficients"} <= set(bg.plots.__all__)
    for name in bg.plots.__all__:
        assert callable(getattr(bg.plots, name))
    assert bg.figures is bg.plots
    for name in STUDY_FIGURES:
        new = {"coefficients": "added_coefficients"}.get(name, name)
        assert getattr(bg.study_figures, name) is getattr(bg.plots, new, getattr(bg.study_figures, name))
    assert bg.study_figures.coefficients is bg.plots.added_coefficients


def test_a_study_that_was_not_sampled_says_that_it_has_no_fit_and_how_to_get_one(study, tmp_path):
    replace(study, fit=None).save(tmp_path / "study.nc")
    with pytest.raises(bg.InputError, match=r"not sampled \(settle=False\).*study\.model\.fit"):
        load_checked(tmp_path / "study.nc")
    assert bg.load(tmp_path / "study.nc").fit is None
    assert "settle=False" in bg.Study.__doc__ and "`study.fit` is None" in bg.find_missing_effects.__doc__


def test_results_have_what_they_are_said_to_have(study):
    fit = study.fit
    for name in ("idata", "verdict", "model", "data", "sampling"):
        assert hasattr(fit, name)
    methods = """
        summary inclusion discrepancy discrepancy_grid trade_off predict simulate checks loo_pit whiteness sensitivity
        save to_html to_inferencedata drawn to_sympy to_latex to_callable to_json
    """.split()
    assert all(callable(getattr(bg.Fit, name)) for name in methods)
    assert all(callable(getattr(bg.Study, name)) for name in ("to_sympy", "to_latex", "to_callable", "to_json"))
    assert all(callable(getattr(bg.Study, name)) for name in ("save", "to_html", "record", "free_run"))
    assert isinstance(fit.to_callable(), bg.LearnedRates) and isinstance(study.to_callable(draws=2), bg.LearnedRates)
    tables = {"verdict", "sentence", "effects", "hypotheses", "corrections", "where", "gap", "rounds", "ties", "model"}
    assert tables <= {*(field.name for field in fields(study)), "sentence"}
    assert "\nd(ydot)/dt = F − y − 0.1·ydot − 0.8" in repr(study) and "\nd(ydot)/dt = " in repr(fit)
    assert study.sentence in repr(study) and study.record()["sentence"] == study.sentence
    assert list(study.record())[:2] == ["verdict", "sentence"]
    assert isinstance(fit.verdict, bg.Verdict) and isinstance(fit.predict(study.test), bg.Prediction)
    assert list(study.effects.columns[:10]) == [
        "equation", "slug", "name", "expression", "probability", "mean", "sd", "lower", "upper", "unit",
    ]  # fmt: skip
