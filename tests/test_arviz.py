"""ArviZ's functions on a whole fit, as its users call them: no variable is named, and nothing is filtered.

ArviZ has two generations. Version 1, for Python 3.12 and later, takes `fit.idata`; version 0.23, the newest for Python
3.11, takes `fit.to_inferencedata()`, and brings a preview of version 1 in packages beside it.
"""

import importlib
import warnings
from importlib.metadata import version

import numpy as np
import pytest
import xarray as xr
from matplotlib import pyplot

import bayes_greybox as bg
from bayes_greybox.criticism import prediction
from bayes_greybox.criticism.prediction import predictive_group

OLD = version("arviz").startswith("0.")
"""Whether `arviz` is of the generation before 1."""

PREVIEW = version("arviz-plots").startswith("0.")
"""Whether the plots of generation 1 are those of the preview."""

PLOTS = ["forest", "pair", "dist", "rank", "trace", "prior_posterior", "loo_pit", "ppc_dist", "energy", "autocorr"]
if PREVIEW:
    # Of arrays with coordinates of different names it makes no pairs, whatever they are of.
    PLOTS.remove("pair")

OLD_PLOTS = ["forest", "pair", "posterior", "rank", "trace", "dist_comparison", "loo_pit", "ppc", "energy", "autocorr"]

TABLES = ["summary", "loo", "compare", "ess", "rhat"]

MOST_PIXELS = 30e6
"""Of a figure, which takes 120 MB of memory."""

TALLEST = 2 * 1080
"""Pixels of a forest plot: two screens."""

N_CHAIN, N_DRAW, N_OBS = 2, 300, 60

RANK_SHARE = 1e-3
"""R̂ may move by this share when draws are given in other units. The two draws beside the median of an even number are
equally far from it but for rounding, which decides their order among the folded ranks. Of 1,200 rescalings of normal
draws of this size, 314 moved R̂ by more than 1e-6 of itself, and none by more than 2.4e-4."""

# What ArviZ calls in other libraries, and they will change, is between these.
pytestmark = [pytest.mark.filterwarnings(f"ignore::{kind}") for kind in ("DeprecationWarning", "FutureWarning")]


@pytest.fixture(scope="module")
def fit():
    """As few draws as leave densities of left-out rows without a warning."""
    data = bg.systems.oscillator().simulate(np.linspace(0.0, 20.0, N_OBS), noise=0.02, seed=1)
    model = bg.GreyBox({"ydot": ["y", "y**3", "ydot**3"]}, discrepancy=bg.OrthogonalGP(features=8))
    return model.fit(data, draws=N_DRAW, tune=200, chains=N_CHAIN, progress=False)


@pytest.fixture(scope="module")
def old(fit):
    """The fit as ArviZ takes it that is of the older generation, and that ArviZ."""
    if not OLD:
        pytest.skip("ArviZ is of generation 1.")
    return fit.to_inferencedata(), _arviz()


@pytest.fixture
def figure_size():
    """Width and height in pixels of the current figure, drawn."""

    def size():
        figure = pyplot.gcf()
        figure.canvas.draw()
        return figure.get_size_inches() * figure.dpi

    yield size
    pyplot.close("all")


@pytest.mark.parametrize("name", PLOTS)
def test_a_plot_of_everything(name, fit, figure_size):
    base, plots = importlib.import_module("arviz_base"), importlib.import_module("arviz_plots")
    # Eight quantities make 64 pairs; ArviZ 1 refuses more than 40 panels unless it is told otherwise.
    most = None if name == "pair" else 40
    with base.rc_context({"plot.max_subplots": most}):
        getattr(plots, f"plot_{name}")(fit.idata)
    _require_sensible(name, *figure_size())


@pytest.mark.parametrize("name", OLD_PLOTS)
def test_a_plot_of_everything_by_the_older_arviz(name, old, figure_size):
    idata, arviz = old
    # This one has no default for what was observed.
    needed = {"y": "ydot_rate"} if name == "loo_pit" else {}
    getattr(arviz, f"plot_{name}")(idata, **needed)
    _require_sensible(name, *figure_size())


@pytest.mark.parametrize("name", TABLES)
def test_a_table_of_everything(name, fit):
    stats = importlib.import_module("arviz_stats")
    _require_right(name, getattr(stats, name), fit.idata, fit)


@pytest.mark.parametrize("name", TABLES)
def test_a_table_of_everything_by_the_older_arviz(name, old, fit):
    idata, arviz = old
    _require_right(name, getattr(arviz, name), idata, fit)


def test_prior_predictive_draws_and_the_sensitivity_to_the_prior(fit, figure_size):
    plots, stats = importlib.import_module("arviz_plots"), importlib.import_module("arviz_stats")
    assert fit.idata["prior_predictive"]["ydot_rate"].shape[2] == N_OBS
    plots.plot_ppc_dist(fit.idata, group="prior_predictive", num_samples=20)
    _require_sensible("ppc_dist", *figure_size())
    found = stats.psense(fit.idata, group="prior")
    assert set(found) == set(fit.idata["posterior"]) and float(found["ydot_sigma"]) >= 0


def test_a_term_that_no_draw_includes_is_plotted_too(fit, figure_size):
    plots = importlib.import_module("arviz_plots")
    tree = fit.idata.copy(deep=True)
    tree["posterior"]["ydot_theta"][..., 0] = 0.0
    for name in ("dist", "rank", "prior_posterior"):
        with warnings.catch_warnings():
            # A single value has no density, which is right.
            warnings.filterwarnings("ignore", "Your data appears to have a single value")
            getattr(plots, f"plot_{name}")(tree)
        _require_sensible(name, *figure_size())


def test_what_plots_would_drown_in_has_a_group_of_its_own(fit):
    names = ["theta", "sigma", "amplitude", "length_scale", "pi", "tau"]
    for source in ("posterior", "prior"):
        group, details = fit.idata[source], fit.idata[f"{source}_details"]
        assert set(group) == {f"ydot_{name}" for name in names}
        assert {"ydot_weight", "ydot_gamma", "ydot_prior_sd"} <= set(details)
        assert details["ydot_weight"].dims == ("chain", "draw", "ydot_basis")
        assert "ydot_basis" not in group.sizes
        for coordinate in ("chain", "draw"):
            np.testing.assert_array_equal(details[coordinate], group[coordinate])
    # What the package itself reads has both.
    assert {"ydot_theta", "ydot_weight", "ydot_inclusion"} <= set(fit.drawn())
    assert fit.draws("ydot").weight.shape == (N_CHAIN * N_DRAW, 64)


def test_every_draw_has_its_predictive_draw_where_it_has_its_densities(fit, monkeypatch):
    shape = (N_CHAIN, N_DRAW, N_OBS)
    assert fit.idata["posterior_predictive"]["ydot_rate"].shape == shape
    assert fit.idata["log_likelihood"]["ydot_rate"].shape == shape
    # Beyond as many numbers as the densities may be, they are thinned, with the numbers of the draws.
    monkeypatch.setattr(prediction, "PREDICTIVE_DRAWS", N_CHAIN * N_DRAW - 1)
    monkeypatch.setattr(prediction, "MOST_NUMBERS", N_CHAIN * N_DRAW * N_OBS - 1)
    values, kept = predictive_group(fit)
    np.testing.assert_array_equal(kept, np.arange(0, N_DRAW, 2))
    assert values["ydot_rate"].shape == (N_CHAIN, N_DRAW // 2, N_OBS)


def test_a_predictive_draw_is_of_the_draw_with_its_number(fit):
    """Draws of the coefficients and of f explain the predictive draws up to noise of that draw's σ."""
    (equation,) = fit.equations.values()
    draws = fit.draws("ydot")
    Phi, Psi, _ = equation.parts()
    mean = equation.rows.simulated + equation.frame.target_scale * (draws.theta @ Phi.T + draws.weight @ Psi.T)
    predicted = fit.idata["posterior_predictive"]["ydot_rate"].to_numpy().reshape(mean.shape)
    noise = (predicted - mean) / fit.idata["posterior"]["ydot_sigma"].to_numpy().reshape(-1, 1)
    # Of 36,000 standard normal numbers; five standard errors.
    assert abs(noise.mean()) < 5 / np.sqrt(noise.size)
    assert abs(noise.var() - 1) < 5 * np.sqrt(2 / noise.size)


def test_what_arviz_takes_is_a_new_object_of_all_groups(fit):
    given = fit.to_inferencedata()
    assert given is not fit.idata
    groups = set(given.groups()) if OLD else set(given.children)
    assert groups == set(fit.idata.children)
    assert type(given).__name__ == ("InferenceData" if OLD else "DataTree")
    for name in ("posterior", "posterior_details", "observed_data"):
        values = given[name] if OLD else given[name].to_dataset()
        xr.testing.assert_identical(values, fit.idata[name].to_dataset())
    assert dict(given.attrs) == dict(fit.idata.attrs)


def test_a_saved_fit_opens_in_arviz(fit, tmp_path):
    fit.save(tmp_path / "run.nc")
    opened = _arviz().from_netcdf(tmp_path / "run.nc")
    assert opened["posterior"]["ydot_theta"].shape == (N_CHAIN, N_DRAW, 3)
    assert opened["posterior_details"]["ydot_weight"].shape == (N_CHAIN, N_DRAW, 64)


def _arviz():
    with warnings.catch_warnings():
        # Early versions 0.23 speak of the next generation once a day.
        warnings.simplefilter("ignore", FutureWarning)
        return importlib.import_module("arviz")


def _require_sensible(name, width, height):
    assert width * height <= MOST_PIXELS
    assert name != "forest" or height <= TALLEST


def _require_right(name, function, groups, fit):
    """The same numbers as the package's own."""
    if name == "compare":
        found = function({"one": groups, "other": groups})
        assert sorted(found.index) == ["one", "other"] and np.all(found["elpd_diff"] == 0)
        return
    found = function(groups)
    if name == "summary":
        lengths, terms = ("y", "ydot"), ("y", "y**3", "ydot**3")
        expected = [f"ydot_{quantity}" for quantity in ("amplitude", "pi", "sigma", "tau")]
        expected += [f"ydot_length_scale[{name}]" for name in lengths] + [f"ydot_theta[{term}]" for term in terms]
        assert sorted(found.index) == sorted(expected)
    elif name == "loo":
        ours = bg.cross_validate(fit, scheme="loo", refit=None, progress=False)
        # They differ by how long a tail is smoothed.
        assert abs(float(getattr(found, "elpd", None) or found.elpd_loo) - ours.elpd) < 0.05 * ours.se
    else:
        column, rtol = ("r_hat", RANK_SHARE) if name == "rhat" else ("ess_bulk", 1e-6)
        np.testing.assert_allclose(found["ydot_theta"], fit.summary()[column].loc["ydot"].iloc[:3], rtol=rtol)
