"""Studies of a displacement alone: what is missing, what is not, and what is the sensor's."""

from dataclasses import replace

import numpy as np
import pytest
from fabricated import estimated
from sampled_oscillator import SIMULATION, sampled
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

import bayes_greybox as bg
import bayes_greybox.discovery.study as study_module
from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.physics.formula.grammar import read
from bayes_greybox.report.pages.study_page import study_html
from bayes_greybox.report.words.doubts import doubts

CUBIC = {"hidden": lambda y, v: -0.5 * y**3}

SHORT = 200
"""Samples that are enough where the question is what a sensor does, or its noise; one number, so that programs serve
several tests."""


def only(*slugs, domain="mechanical"):
    """These effects alone: the others cost time and tell no more."""
    effects = load_catalogue(domain)
    return [replace(e, confusions=tuple({*slugs} & {*e.confusions})) for e in effects if e.slug in slugs]


SEVERAL = only(
    "cubic-stiffness", "quadratic-stiffness", "power-law-stiffness", "dead-zone", "bilinear-stiffness",
    "viscous-damping", "coulomb-friction", "quadratic-drag", "power-law-drag", "constant-force",
)  # fmt: skip
"""Effects that could stand in the place of a cubic spring, with nonlinear parameters too, and others that could not."""
TWO = only("cubic-stiffness", "quadratic-stiffness")
FEW = only("cubic-stiffness", "quadratic-stiffness", "coulomb-friction")
WITH_FORCE = only("cubic-stiffness", "quadratic-stiffness", "coulomb-friction", "constant-force")
"""An offset of a sensor is much like a force that stays."""


def study(data, test=None, rows=None, **given):
    """A study; of inputs that are splines between their samples, unless `rows` leave open what they are."""
    model = bg.GreyBox(simulation=SIMULATION, rows=rows or bg.TrajectoryRows(interpolation="cubic"))
    given = {"free_runs": False, "settle": False, "progress": False, "catalogue": FEW} | given
    return bg.find_missing_effects(model, data, test, **given)


def short(**given):
    return sampled(**given, n=SHORT)


@pytest.fixture(scope="module")
def cubic_and_reads():
    """A study, and how many formulas were read for it."""
    before = read.cache_info().misses
    data = (sampled(**CUBIC, noise=0.03, seed=seed, n=2 * SHORT) for seed in (0, 1))
    found = study(*data, bg.TrajectoryRows(), catalogue=SEVERAL, free_runs=True)
    return found, read.cache_info().misses - before


@pytest.fixture(scope="module")
def cubic(cubic_and_reads):
    return cubic_and_reads[0]


def test_formulas_are_read_by_effect_and_not_by_value_of_an_inner_parameter(cubic_and_reads):
    # An effect has at most a few ways to be bound, and a few formulas; values there are hundreds.
    assert cubic_and_reads[1] < 5 * len(SEVERAL)


def test_a_missing_effect_is_named_with_its_coefficient(cubic):
    assert cubic.verdict in ("named", "one of") and cubic.against == ()
    row = cubic.effects.iloc[0]
    # These samples know the exponent of a power law to a few tenths: only that may stand in its place.
    assert row["slug"] == "cubic-stiffness" and row["probability"] > 0.5
    assert set(row["tied_with"]) <= {"power-law-stiffness"}
    assert abs(row["mean"] + 0.5) < 3 * row["sd"] < 0.1


def test_what_follows_from_the_units_of_a_position_and_of_time_has_a_unit(cubic):
    units = dict(zip(cubic.effects["slug"], cubic.effects["unit"], strict=True))
    assert units["cubic-stiffness"] == "1/m²/s²" and units["quadratic-drag"] == "1/m"
    assert cubic.corrections["unit"].to_dict() == {("v", "F"): "", ("v", "v"): "1/s", ("v", "y"): "1/s²"}
    assert cubic.maps["v"].units == ("m", "m/s") and cubic.maps["v"].unit == "m/s²"
    assert "[1/(m²·s²)] y³" in repr(cubic) and " m " in f"{' '.join(cubic.where['description'])} "


def test_exact_paths_at_its_posterior_are_those_of_the_linear_rows(cubic):
    row = cubic.checks.loc[("v", "linearity")]
    assert row["ok"] and np.isnan(row["p"]) and row["khat"] < 0.7
    (doubt,) = [each for each in doubts(cubic) if each.topic == "Linear rows"]
    assert doubt.against is False and "k-hat" in doubt.text


def test_the_gap_is_shown_closed_on_held_out_samples(cubic):
    gap = cubic.gap.loc[("test", "sample NMSE", "v")]
    assert gap["after"] < 0.1 * gap["before"]
    free = cubic.gap.loc[("test", "free-run NRMSE", "y")]
    assert free["after"] < 0.3 * free["before"]
    assert "closed" not in cubic.sentence or cubic.verdict == "named"


def test_free_runs_hold_inputs_where_the_rows_do():
    data, rows = sampled(**CUBIC, noise=0.02, n=60), bg.TrajectoryRows(interpolation="zoh")
    model = bg.GreyBox({"v": ["y**3"]}, simulation=SIMULATION, rows=rows, discrepancy=None)
    fit = estimated(model, data, draws=5)
    own, held, linear = (
        fit.simulate(data, **given).states["y"].mean
        for given in ({}, {"interpolation": "zoh"}, {"interpolation": "linear"})
    )
    np.testing.assert_array_equal(own, held)
    assert np.max(np.abs(own - linear)) > 0.01 * np.std(data.states["y"])


def held(hidden, n=90, step=0.2, noise=0.01, correlation=0.0):
    """Samples of an oscillator whose force stays until the next sample; noise may go on from one to the next too."""
    t = step * np.arange(n)
    force = np.convolve(np.random.default_rng(3).standard_normal(n + 4), np.ones(5) / 2, "valid")
    x, y = np.array([0.3, 0.0]), np.zeros(n)
    for k in range(n):
        y[k] = x[0]
        x = solve_ivp(
            lambda _, x, k=k: [x[1], force[k] - 2 * x[0] - 0.15 * x[1] + hidden(*x)], (0, step), x, rtol=1e-9
        ).y[:, -1]
    white = np.random.default_rng(4).standard_normal(n)
    error = lfilter([np.sqrt(1 - correlation**2)], [1.0, -correlation], white)
    y += noise * np.std(y) * error
    return bg.Trajectories.from_arrays(t, states={"y": y}, inputs={"F": force}, units={"t": "s", "y": "m"})


@pytest.mark.slow
def test_inputs_that_are_held_are_no_error_of_a_sensor_under_correlated_noise():
    """Noise that goes on hides at first how the inputs act, and half a step late is what holding does."""
    found = study(held(lambda y, v: 0.0, noise=0.1, correlation=0.6), rows=bg.TrajectoryRows(), catalogue=TWO)
    assert found.verdict == "no gap", found.sentence
    assert found.base.rows.interpolation == "zoh"


@pytest.mark.slow
def test_inputs_that_are_held_are_no_lag_of_the_actuator():
    data = held(CUBIC["hidden"])
    found = study(data, rows=bg.TrajectoryRows(), catalogue=only("cubic-stiffness", "actuator-lag"))
    assert found.verdict == "named", found.sentence
    assert [row["slug"] for _, row in found.effects.iterrows() if row["status"] == "added"] == ["cubic-stiffness"]
    assert found.model.rows.interpolation == found.base.rows.interpolation == "zoh"
    assert any("held" in text for text in found.warnings)
    # What was said is taken as said, and nothing is said of it.
    said = study(data, rows=bg.TrajectoryRows(interpolation="zoh"), catalogue=only("cubic-stiffness"))
    assert said.model.rows.interpolation == "zoh" and not any("held" in text for text in said.warnings)


@pytest.mark.slow
def test_of_two_inputs_one_is_held():
    """With one way for both, either the heater or the weather seems to be half a sample late."""
    rng, t = np.random.default_rng(6), 0.5 * np.arange(160)
    heater, air = 3.0 * np.repeat(rng.uniform(size=40) > 0.5, 4), [20.0]

    def weather(s):
        return 5 + 6 * np.sin(2 * np.pi * s / 24)

    for a, b, level in zip(t[:-1], t[1:], heater[:-1], strict=True):
        step = solve_ivp(lambda s, x, u=level: 0.15 * (weather(s) - x) + u, (a, b), air[-1:], rtol=1e-9, atol=1e-9)
        air.append(step.y[0, -1])
    data = bg.Trajectories.from_arrays(
        t, states={"T": np.array(air) + 0.05 * rng.standard_normal(len(t))},
        inputs={"weather": weather(t), "heater": heater}, units={"t": "h", "T": "degC", "weather": "degC"},
    )  # fmt: skip
    model = bg.GreyBox({"T": []}, simulation={"T": "0.15*(weather - T) + heater"}, rows=bg.TrajectoryRows())
    thermal = only("linear-cooling", "actuator-lag", domain="thermal")
    found = bg.find_missing_effects(model, data, catalogue=thermal, settle=False, free_runs=False, progress=False)
    assert found.verdict == "no gap", found.sentence
    assert found.base.rows.interpolation == ("cubic", "zoh")
    assert any("so heater was held" in text for text in found.warnings)


@pytest.mark.slow
def test_what_held_out_samples_deny_is_not_named(cubic):
    misfit = cubic.gap.xs("misfit of samples", level="metric")["after"]
    np.testing.assert_allclose(misfit, 1.0, atol=0.15)
    changed = short(hidden=lambda y, v: -0.5 * y**3 - 0.1 * v, noise=0.03, seed=1)
    found = study(short(**CUBIC, noise=0.03), changed)
    assert found.effects.iloc[0]["slug"] == "cubic-stiffness" and found.verdict == "partly named"
    (text,) = [each for each in found.against if "held-out samples" in each]
    left = found.gap.loc[("test", "misfit of samples", "v"), "after"]
    assert left > 1.5 and f"{left:.2g} times" in text and "held-out samples" in found.sentence
    assert [each.against for each in doubts(found) if each.topic == "Held-out samples"] == [True]
    assert [each.against for each in doubts(cubic) if each.topic == "Held-out samples"] == [False]


@pytest.mark.slow
def test_held_out_samples_that_no_path_follows_are_no_proof(monkeypatch, tmp_path):
    real = study_module.gap_rows

    def gap_rows(model, amendments, data, part, *rest):
        if part == "test":
            raise bg.InputError("No path through the samples was found.")
        return real(model, amendments, data, part, *rest)

    monkeypatch.setattr(study_module, "gap_rows", gap_rows)
    found = study(short(**CUBIC, noise=0.03), short(**CUBIC, noise=0.03, seed=1))
    assert found.verdict == "partly named" and set(found.gap.index.get_level_values("data")) == {"train"}
    assert any("could not be compared with held-out data" in text for text in found.warnings)
    assert found.against == ("no path of the extended model follows held-out samples",)
    study_html(found, tmp_path / "study.html")
    assert "training data" in found.sentence


def test_a_free_run_of_other_samples_starts_where_the_path_through_them_does(cubic):
    path = cubic.free_run(short(**CUBIC, noise=0.03, seed=2))["y"]
    truth = short(**CUBIC, noise=0.0).states["y"]
    errors = [float(np.sqrt(np.mean((band.mean - truth) ** 2))) for band in (path.before, path.after)]
    assert errors[1] < 0.2 * errors[0] and errors[1] < 0.1 * np.std(truth)


def test_the_extended_model_is_fitted_to_the_samples(cubic):
    assert cubic.corrected.samples is not None and cubic.corrected.state_names == ("y", "v")
    terms = [term.name for term in cubic.model.dictionary["v"]]
    assert "y**3" in terms and cubic.model.rows.follows_path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "catalogue"), [(0, "mechanical"), (1, FEW), (2, FEW)], ids=["all", "few", "few again"]
)
def test_nothing_missing_is_no_gap(seed, catalogue):
    assert study(short(noise=0.05, seed=seed), catalogue=catalogue).verdict == "no gap"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bend", "kind"),
    [
        (lambda t, y: y + 0.15, "offset"),
        (lambda t, y: np.interp(t - 0.07, t, y), "delay"),
        # It saturates, by some 6 % at the ends of its range.
        (lambda t, y: 4 * np.tanh(y / 4), "cubic error"),
    ],
    ids=["offset", "delay", "saturating"],
)
def test_what_the_sensor_does_is_no_missing_effect(bend, kind):
    found = study(short(noise=0.01, bend=bend), rows=bg.TrajectoryRows(), catalogue="mechanical")
    assert found.verdict in ("instrument", "recalibrate", "no gap", "unknown")
    assert not (found.effects.status == "added").any()
    if found.verdict == "instrument":
        assert kind in found.instrument["suspect"][found.instrument["status"] != ""].tolist()


@pytest.mark.slow
def test_an_input_that_reads_too_much_is_put_right_along_the_path_and_the_effect_found_beside_it():
    def offset(data):
        return replace(data, inputs={"F": data.inputs["F"] + 0.2})

    train, test = (offset(short(**CUBIC, noise=0.01, seed=seed)) for seed in (0, 1))
    found = study(train, test, catalogue=WITH_FORCE)
    added = found.effects[found.effects["status"] == "added"].set_index("slug")
    sensors = found.instrument.loc[found.instrument["status"] != "", "suspect"].tolist()
    # A constant force is the same.
    assert "cubic-stiffness" in added.index and (sensors == ["offset"] or "constant-force" in added.index)
    assert abs(added.loc["cubic-stiffness", "mean"] + 0.5) < 4 * added.loc["cubic-stiffness", "sd"]
    # What is left of held-out samples is the noise of their sensor.
    assert found.gap.loc[("test", "sample NMSE", "v"), "after"] < 2 * 0.01**2


def test_of_several_equations_the_one_in_question_is_asked_for():
    simulation = {"y": "v + 0.1*y", "v": "F - 2*y - 0.15*v"}
    model = bg.GreyBox(simulation=simulation, rows=bg.TrajectoryRows())
    with pytest.raises(bg.InputError, match="name the one in question"):
        bg.find_missing_effects(model, sampled(n=60), settle=False, progress=False)


def test_a_fit_to_samples_survives_a_file(tmp_path):
    data = short(**CUBIC)
    terms = {"v": ["y", "y**3"]}
    model = bg.GreyBox(terms, simulation=SIMULATION, rows=bg.TrajectoryRows(), discrepancy=None)
    fit = estimated(model, data, draws=5)
    table = fit.summary()
    assert abs(table.loc[("v", "y**3"), "mean"] + 0.5) < 5 * table.loc[("v", "y**3"), "sd"]
    fit.save(tmp_path / "fit.nc")
    again = bg.load(tmp_path / "fit.nc")
    np.testing.assert_array_equal(again.data.samples.states["y"], data.states["y"])
    assert again.model.rows == fit.model.rows
    np.testing.assert_allclose(again.equations["v"].rows.target, fit.equations["v"].rows.target, rtol=1e-10)
    other = short(**CUBIC, seed=4)
    assert float(again.predict(other).nmse()["v"]) < 0.1
    assert float(again.simulate(other).nrmse()["y"]) < 0.2


def of_kind(kind, n=SHORT):
    """Noise of unit spread that is not white and normal."""
    rng = np.random.default_rng(5)
    e = rng.standard_normal(n)
    if kind == "heavy tails":
        return 0.5 * rng.standard_t(2, n)
    for i in range(1, n):
        e[i] = 0.9 * e[i - 1] + np.sqrt(1 - 0.9**2) * e[i]
    return e


@pytest.mark.slow
# Tails are told from few samples that are far off.
@pytest.mark.parametrize(("kind", "n"), [("correlated noise", SHORT), ("heavy tails", 400)])
def test_noise_of_the_sensor_that_is_not_white_is_found_and_the_effect_beside_it(kind, n):
    data = sampled(**CUBIC, noise=0.0, n=n, bend=lambda t, y: y + 0.03 * np.std(y) * of_kind(kind, n))
    found = study(data, catalogue=TWO)
    row = found.effects.iloc[0]
    assert row["slug"] == "cubic-stiffness" and row["probability"] > 0.9 and found.verdict == "named"
    assert abs(row["mean"] + 0.5) < 4 * row["sd"]
    assert kind in found.instrument.loc[found.instrument["status"] != "", "suspect"].tolist()


@pytest.mark.slow
def test_correlated_noise_alone_is_no_gap():
    data = short(noise=0.0, bend=lambda t, y: y + 0.03 * np.std(y) * of_kind("correlated noise"))
    assert study(data, catalogue=TWO).verdict == "no gap"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bend", "kind", "size", "catalogue"),
    [
        (lambda t, y: CubicSpline(t, y)(t - 0.07), "delay", 0.07, TWO),
        (lambda t, y: y + 0.15, "offset", 0.15, WITH_FORCE),
        (lambda t, y: y + 0.06 * y**2, "quadratic error", 0.06, TWO),
    ],
    ids=["delay", "offset", "bend"],
)
def test_beside_a_sensor_that_is_off_the_effect_is_found_and_free_runs_show_what_the_sensor_shows(
    bend, kind, size, catalogue
):
    given = CUBIC | {"noise": 0.005, "bend": bend}
    found = study(short(**given), short(**given, seed=1), catalogue=catalogue, free_runs=True)
    added = found.effects[found.effects["status"] == "added"].set_index("slug")
    sensors = found.instrument[found.instrument["status"] != ""].set_index("suspect")
    assert list(added.index) == ["cubic-stiffness"] and list(sensors.index) == [kind]
    assert abs(added.loc["cubic-stiffness", "mean"] + 0.5) < 4 * added.loc["cubic-stiffness", "sd"]
    assert sensors.loc[kind, "mean"] == pytest.approx(size, abs=4 * sensors.loc[kind, "sd"])
    # A free run of the right model, seen through the sensor that was found, is off by the sensor's noise alone.
    free = found.gap.loc[("test", "free-run NRMSE", "y")]
    assert free["after"] < 0.02 < free["before"]


@pytest.mark.slow
def test_where_all_is_learned_a_gain_of_the_only_sensor_is_its_unit_and_no_suspect():
    data, rows = short(**CUBIC, noise=0.01), bg.TrajectoryRows(interpolation="cubic")
    model = bg.GreyBox({"v": ["y", "v", "F"]}, simulation={"y": "v"}, rows=rows)
    found = bg.find_missing_effects(model, data, catalogue=TWO, free_runs=True, settle=False, progress=False)
    added = found.effects[found.effects["status"] == "added"].set_index("slug")
    assert list(added.index) == ["cubic-stiffness"]
    assert abs(added.loc["cubic-stiffness", "mean"] + 0.5) < 4 * added.loc["cubic-stiffness", "sd"]
    assert ("gain", "y") not in set(zip(found.instrument["suspect"], found.instrument["channel"], strict=True))
    # Before and after are each on rows near their own model.
    assert found.gap.loc[("train", "sample NMSE", "v"), "closed"] > 0.5


@pytest.mark.slow
def test_what_a_sensor_at_its_end_shows_is_left_out_and_said():
    # Noise of the sensor is clipped with what it shows.
    data = short(**CUBIC, noise=0.03)
    data = replace(data, states={"y": np.minimum(data.states["y"], np.quantile(data.states["y"], 0.9))})
    found = study(data)
    row = found.effects.iloc[0]
    assert found.verdict == "named" and row["slug"] == "cubic-stiffness" and abs(row["mean"] + 0.5) < 4 * row["sd"]
    count = int(np.sum(data.states["y"] == data.states["y"].max()))
    assert f"y is clipped at {count} samples, which are left out" in found.sentence


@pytest.mark.slow
def test_a_sensor_that_stays_where_its_path_does_not_speaks_against_the_answer():
    # It sticks at its largest value now and then, wherever the path is.
    data = short(**CUBIC, noise=0.03)
    y = data.states["y"].copy()
    for first in range(20, SHORT, 60):
        y[first : first + 5] = np.max(data.states["y"])
    found = study(replace(data, states={"y": y}))
    assert found.verdict != "named"
    assert any("where its path does not reach it" in text for text in found.against)


@pytest.mark.slow
def test_held_inputs_are_weighed_from_the_simulation_as_given_too():
    """Lines between the samples of an infusion lead to a hypothesis from which that of held inputs is not found."""
    rng, t = np.random.default_rng(5), np.arange(0.0, 48.0, 0.5)
    k, infused = 0.25, np.zeros(len(t))
    for first, length, rate in ((3, 5, 3.4), (24, 4, 2.2), (51, 6, 3.0), (73, 3, 1.8)):
        infused[first : first + length] = rate
    c = [0.0]
    for rate in infused[:-1]:
        c.append(c[-1] * np.exp(-0.5 * k) + rate * (1 - np.exp(-0.5 * k)) / k)
    noisy = np.array(c) + 0.02 * np.std(c) * rng.standard_normal(len(t))
    data = bg.Trajectories.from_arrays(t, states={"c": noisy}, inputs={"u": infused}, units={"t": "h", "c": "mg/l"})
    model = bg.GreyBox({"c": []}, simulation={"c": f"u - {k}*c"}, rows=bg.TrajectoryRows())
    about = {"settle": False, "free_runs": False, "progress": False}
    found = bg.find_missing_effects(model, data, catalogue="compartment", **about)
    assert found.base.rows.interpolation == "zoh"
    # Along lines a memory of c with the time of a sample stands for all of c', and u has a fiftieth of its coefficient.
    assert max(found.effects["probability"]) < 0.5 and max(found.corrections["probability"]) < 0.5, found.sentence
