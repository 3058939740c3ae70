"""`bg.Noise` in ordinary fits: what is found, what is held, what files keep, and intervals that cover."""

import numpy as np
import pytest
from fabricated import fabricate
from scipy.stats import multivariate_normal, norm

import bayes_greybox as bg
from bayes_greybox.config import load_config
from bayes_greybox.criticism.checks.other_noise import suggestion
from bayes_greybox.data.noise.state_space import StateSpaceNoise
from bayes_greybox.data.noise.weighted import WeightedNoise
from bayes_greybox.inference.kept.model_record import describe, rebuild

TRUTH, STEP = -0.8, 0.1
SMALL = {"draws": 60, "tune": 60, "chains": 2, "progress": False}


def data_with(kind, seed=0, n=300, rho=0.9, runs=1):
    """ẋ = −0.8 x + noise along slow paths, so that noise that hangs together looks like x."""
    rng = np.random.default_rng(seed)
    time, xs, rates = np.arange(n) * STEP, [], []
    for _ in range(runs):
        x = np.sin(0.7 * time + rng.uniform(0, 6)) + 0.6 * np.sin(0.31 * time + rng.uniform(0, 6))
        e = rng.standard_normal(n)
        if kind == "correlated":
            for i in range(1, n):
                e[i] = rho * e[i - 1] + np.sqrt(1 - rho**2) * e[i]
        if kind == "varying":
            e *= np.abs(x) + 0.05
        if kind == "heavy":
            e = 0.3 * rng.standard_t(2, n)
        xs.append(x)
        rates.append(TRUTH * x + 0.3 * e)
    return bg.Trajectories.from_arrays([time] * runs, states={"x": xs}, derivatives={"x": rates})


def model_with(noise, **changes):
    parts = {"dictionary": {"x": ["x"]}, "prior": bg.Normal(), "discrepancy": None, "noise": noise}
    return bg.GreyBox(**{**parts, **changes})


def found_in(model):
    assert isinstance(model.noise, bg.Noise) and model.noise.found is not None
    return model.noise.found


# What is found


def test_a_correlation_is_found():
    for seed in range(3):
        model, data = model_with(bg.Noise(correlation="fit")).with_noise_found(data_with("correlated", seed, 600))
        found = found_in(model)["x"]
        # e^(−h/τ) = 0.9
        assert 0.5 < found["correlation_time"] < 2.0 and found["white_share"] < 0.2
        assert isinstance(data.noise["x"], StateSpaceNoise) and data.noise["x"].time_scale == found["correlation_time"]


def test_the_correlation_that_is_held_is_the_likeliest_with_coefficients_integrated_out():
    """Six terms take a good part of 150 correlated rows: residuals alone say a shorter correlation than there is."""
    terms, prior_sd = [f"sin({0.3 * k:.1f}*x)" for k in range(1, 7)], 10.0
    data = data_with("correlated", seed=3, n=150)
    model, _ = model_with(bg.Noise(correlation="fit"), dictionary={"x": terms}).with_noise_found(data)
    found = found_in(model)["x"]
    x, y = data.states["x"], data.derivatives["x"] / np.sqrt(np.mean(data.derivatives["x"] ** 2))
    Phi = np.column_stack([np.sin(0.3 * k * x) for k in range(1, 7)])
    Phi = prior_sd * Phi / np.sqrt(np.mean(Phi**2, axis=0))
    sigmas = np.exp(np.linspace(np.log(0.02), np.log(3.0), 120))

    def log_p(tau, white):
        """∫ N(y; 0, σ²R + ΦDΦᵀ) p(σ) dσ by dense covariances, σ of even steps in log σ."""
        R = (1 - white) * np.exp(-np.abs(data.time[:, None] - data.time) / tau) + white * np.eye(len(y))
        logs = [multivariate_normal(cov=s**2 * R + Phi @ Phi.T).logpdf(y) + norm.logpdf(s) + np.log(s) for s in sigmas]
        return np.logaddexp.reduce(logs)

    tau, white = found["correlation_time"], found["white_share"]
    best = log_p(tau, white)
    # As near as the grid is fine: 0.15 in log τ, and what turns leave.
    assert best > max(log_p(tau * np.exp(0.3), white), log_p(tau * np.exp(-0.3), white)) - 0.01
    assert best > max(log_p(tau, min(white + 0.05, 1.0)), log_p(tau, max(white - 0.05, 0.0))) - 0.01


def test_noise_of_the_state_is_found():
    model, data = model_with(bg.Noise(depends_on="fit")).with_noise_found(data_with("varying"))
    found = found_in(model)["x"]
    assert found["depends_on"] == "x" and 0.5 <= found["exponent"] <= 1.25
    assert isinstance(data.noise["x"], WeightedNoise)
    assert np.corrcoef(data.noise["x"].sd, np.abs(data.states["x"]))[0, 1] > 0.95


def test_heavy_tails_are_found_and_outliers_weigh_less():
    model, data = model_with(bg.Noise(tails="fit")).with_noise_found(data_with("heavy"))
    assert 1.5 <= found_in(model)["x"]["degrees"] <= 3.0
    noise = data.noise["x"]
    assert isinstance(noise, WeightedNoise)
    error = np.abs(data.derivatives["x"] - TRUTH * data.states["x"])
    assert np.corrcoef(noise.sd, error)[0, 1] > 0.9


def test_white_noise_stays_white_where_the_data_may_say():
    asked = bg.Noise(correlation="fit", depends_on="fit", tails="fit")
    model, data = model_with(asked).with_noise_found(data_with("white"))
    assert found_in(model) == {"x": {}} and data.noise["x"].local


def test_given_values_are_kept_and_several_runs_are_apart():
    asked = bg.Noise(correlation=0.5, depends_on="x", tails=4.0)
    model, data = model_with(asked).with_noise_found(data_with("correlated", runs=2))
    found = found_in(model)["x"]
    assert (found["correlation_time"], found["depends_on"], found["degrees"]) == (pytest.approx(0.5), "x", 4.0)
    assert data.noise["x"].run_lengths == (300, 300)
    assert np.all(data.noise["x"].covariance()[:300, 300:] == 0)


def test_f_is_not_taken_for_noise():
    # What the dictionary lacks is a function of x; noise must not absorb it.
    data = data_with("white", n=400)
    bent = {"x": data.derivatives["x"] + 0.8 * np.cos(2 * data.states["x"])}
    data = bg.Trajectories.from_arrays(data.time, states=data.states, derivatives=bent)
    asked = bg.Noise(correlation="fit")
    with_f = model_with(asked, discrepancy=bg.OrthogonalGP(features=10)).with_noise_found(data)[0]
    without = model_with(asked).with_noise_found(data)[0]
    assert found_in(with_f) == {"x": {}} and found_in(without)["x"]["white_share"] < 1


def test_the_assembled_equation_has_the_noise_that_a_fit_has():
    model, data = model_with(bg.Noise(correlation="fit")), data_with("correlated")
    held, own = model.with_noise_found(data)
    np.testing.assert_allclose(model.designs(data)["x"].Phi, held.designs(own)["x"].Phi)
    # Finding it again starts from the rows as they came.
    again, _ = held.with_noise_found(data)
    assert again.noise == held.noise


# What is refused


@pytest.mark.parametrize(
    "wrong", [{"correlation": "fast"}, {"correlation": 0.0}, {"tails": -2.0}, {"depends_on": ""}, {"scale": 0.0}]
)
def test_what_is_no_noise_is_refused(wrong):
    (name,) = wrong
    with pytest.raises(bg.InputError, match=name):
        bg.Noise(**wrong)


def test_data_that_cannot_say_it_are_refused():
    with pytest.raises(bg.InputError, match="'z'.*neither a state nor an input; known: x"):
        model_with(bg.Noise(depends_on="z")).designs(data_with("white"))
    with pytest.raises(bg.InputError, match="on 12 rows: give at least 20"):
        model_with(bg.Noise(tails="fit")).designs(data_with("white", n=12))
    data = data_with("white")
    second = np.gradient(data.states["x"], STEP)
    moving = bg.Trajectories.from_arrays(data.time, states={"y": data.states["x"], "v": second})
    filtered = moving.differentiate(method="savgol", window=9)
    with pytest.raises(bg.InputError, match=r"known correlation: leave Noise\(correlation=...\) out"):
        model_with(bg.Noise(correlation="fit"), dictionary={"y": ["y"]}).designs(filtered)


# Fits


def test_a_number_and_a_noise_that_asks_for_nothing_are_the_same():
    data = data_with("white", n=60)
    fits = [model_with(noise).fit(data, **SMALL) for noise in (0.7, bg.Noise(scale=0.7))]
    assert fits[0].data is data and fits[1].data is data
    for name, values in fits[0].idata["posterior"].dataset.items():
        np.testing.assert_array_equal(values, fits[1].idata["posterior"].dataset[name])
    assert all(fit.noise.shape == (1, 0) for fit in fits)


@pytest.mark.slow
def test_a_file_keeps_the_noise(tmp_path):
    asked = bg.Noise(correlation="fit", depends_on="x", tails="fit")
    fit = model_with(asked).fit(data_with("correlated", runs=2), **SMALL)
    fit.save(tmp_path / "fit.nc")
    back = bg.load(tmp_path / "fit.nc")
    assert back.model.noise == fit.model.noise and not back.noise.empty
    assert back.noise.equals(fit.noise)
    np.testing.assert_array_equal(
        back.equations["x"].rows.noise.covariance(), fit.equations["x"].rows.noise.covariance()
    )
    np.testing.assert_array_equal(back.equations["x"].design.y, fit.equations["x"].design.y)
    assert back.checks().table.equals(fit.checks().table)


def test_the_record_of_a_model_has_the_noise():
    data = data_with("white")
    for noise in (0.5, bg.Noise(0.5, "fit", "x", 4.0)):
        model = model_with(noise)
        assert rebuild(describe(model, data)).noise == noise


def test_leaving_rows_out_of_correlated_noise_is_conditioning_on_the_others():
    data = data_with("correlated", n=60, runs=2)
    rows = model_with(bg.Noise(correlation="fit", depends_on="x")).assemble(data)["x"].rows
    R, first = rows.noise.covariance(), np.r_[0:30, 60:110]
    expected = np.linalg.slogdet(R[np.ix_(first, first)])[1]
    assert rows.log_det_of(first) == pytest.approx(expected, abs=1e-8)
    out = np.array([3, 4, 70])
    kept = np.delete(np.arange(120), out)
    removed = rows.without(out)
    expected = np.linalg.slogdet(R[np.ix_(kept, kept)])[1] - rows.noise.log_det
    assert removed.log_det == pytest.approx(expected, abs=1e-8)


@pytest.mark.slow
def test_intervals_cover_under_correlated_noise_and_white_noise_does_not():
    # 40 data sets; under noise that hangs together over ten rows white noise's 90 % interval is three times too narrow.
    inside = {"white": 0, "correlated": 0}
    for seed in range(40):
        data = data_with("correlated", seed + 100)
        white = model_with(1.0).assemble(data)["x"]
        truth = TRUTH / float(white.frame.coefficient_scale[0])
        correlated = model_with(bg.Noise(correlation="fit")).designs(data)["x"]
        for name, design in (("white", white.design), ("correlated", correlated)):
            Phi, y = np.asarray(design.Phi)[:, 0], np.asarray(design.y)
            mean = Phi @ y / (Phi @ Phi)
            sigma = np.sqrt((y @ y - mean * (Phi @ y)) / (float(design.n_obs) - 1))
            inside[name] += int(abs(truth - mean) < 1.645 * sigma / np.sqrt(Phi @ Phi))
    # Of 40 at 90 %, fewer than 31 has probability 0.4 %.
    assert inside["correlated"] >= 31
    assert inside["white"] <= 22


KINDS = pytest.mark.parametrize(
    ("kind", "option"), [("correlated", "correlation"), ("heavy", "tails"), ("varying", "depends_on")]
)


def at_the_truth(data):
    """A posterior of the coefficient that the data were made with, under white noise."""
    model = model_with(1.0)
    theta = TRUTH / model.assemble(data)["x"].frame.coefficient_scale
    return fabricate(model, data, draws=1, theta=np.tile(theta, (2, 1, 1)))


@KINDS
def test_residuals_say_which_noise_to_try(kind, option):
    text = suggestion(at_the_truth(data_with(kind, n=900 if kind == "varying" else 300)), "x")
    assert text.endswith(f"try GreyBox(noise=bg.Noise({option}='fit')).")
    assert suggestion(at_the_truth(data_with("white")), "x") == ""


@pytest.mark.slow
@KINDS
def test_checks_name_the_noise_to_try(kind, option):
    data = data_with(kind, n=900 if kind == "varying" else 300)
    checks = model_with(1.0).fit(data, **SMALL).checks()
    assert not checks.ok and checks.reasons[-1].endswith(f"try GreyBox(noise=bg.Noise({option}='fit')).")
    if kind == "correlated":
        better = model_with(bg.Noise(correlation="fit")).fit(data, **SMALL).checks()
        assert better.whiteness["x"].p > 0.01


def test_no_noise_is_suggested_for_a_rest_that_moves_as_systems_do():
    data = data_with("white")
    smooth = StateSpaceNoise((data.time,), "matern32", 1.5, 0.0)
    rest = smooth.correlated(np.random.default_rng(1).standard_normal((1, 300)))[0]
    rate = {"x": TRUTH * data.states["x"] + 0.3 * rest + 0.01 * np.random.default_rng(2).standard_normal(300)}
    data = bg.Trajectories.from_arrays(data.time, states=data.states, derivatives=rate)
    assert suggestion(at_the_truth(data), "x") == ""


# Configuration

CONFIG = """
[data]
system = "oscillator"
t = { stop = 10.0, points = 30 }

[dictionary]
ydot = ["y"]

[noise]
"""


@pytest.mark.parametrize(
    ("text", "noise"),
    [
        ("scale = 0.5", 0.5),
        ('correlation = "fit"', bg.Noise(correlation="fit")),
        ('scale = 0.5\ncorrelation = 0.2\ndepends_on = "y"\ntails = 4.0', bg.Noise(0.5, 0.2, "y", 4.0)),
    ],
)
def test_a_file_can_say_it(tmp_path, text, noise):
    path = tmp_path / "config.toml"
    path.write_text(CONFIG + text, encoding="utf-8")
    assert load_config(path).build_model().noise == noise


def test_a_wrong_value_in_a_file_is_named(tmp_path):
    path = tmp_path / "config.toml"
    path.write_text(CONFIG + 'correlation = "fats"', encoding="utf-8")
    with pytest.raises(bg.InputError, match=r"\[noise\] correlation"):
        load_config(path)
