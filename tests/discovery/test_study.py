"""Studies of forced oscillators, integrated here by a Runge-Kutta rule of its own, with and without hidden effects."""

import json

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.discovery.subject import studied_equations

N_OBS, STEP, NOISE = 400, 0.075, 0.05


def drive(t, phases):
    return np.sin(1.1 * t + phases[0]) + 0.7 * np.sin(2.3 * t + phases[1]) + 0.5 * np.sin(0.4 * t + phases[2])


def oscillator(hidden, seed, x0=(0.8, 0.0), k=2.0, noise=NOISE):
    """y'' = F − k y − 0.15 y' + hidden(y, y'), acceleration with white noise; fine steps of the classical rule."""
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 6, 3)
    fine, h = 4, STEP / 4

    def rate(t, x):
        return np.array([x[1], drive(t, phases) - k * x[0] - 0.15 * x[1] + hidden(*x)])

    x, path = np.array(x0, float), []
    for i in range(N_OBS * fine):
        if i % fine == 0:
            path.append(x)
        t = i * h
        k1 = rate(t, x)
        k2 = rate(t + h / 2, x + h / 2 * k1)
        k3 = rate(t + h / 2, x + h / 2 * k2)
        k4 = rate(t + h, x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    t, (y, v) = STEP * np.arange(N_OBS), np.array(path).T
    a = drive(t, phases) - k * y - 0.15 * v + hidden(y, v) + noise * rng.standard_normal(N_OBS)
    return bg.Trajectories.from_arrays(
        t,
        states={"y": y, "v": v},
        inputs={"F": drive(t, phases)},
        derivatives={"v": a},
        units={"t": "s", "y": "m", "v": "m/s", "F": "m/s**2"},
    )


def study(hidden, **changes):
    model = bg.GreyBox(
        simulation=changes.pop("simulation", {"y": "v", "v": "F - 2*y - 0.15*v"}),
        discrepancy=bg.OrthogonalGP(variables=("y", "v"), features=6),
    )
    given = {"settle": False, "progress": False, "free_runs": False, **changes.pop("settings", {})}
    return bg.find_missing_effects(model, oscillator(hidden, 1, **changes), oscillator(hidden, 2, (0.2, 0.5)), **given)


def added(found):
    return found.effects.query("status == 'added'").set_index("slug")


@pytest.fixture(scope="module")
def cubic():
    return study(lambda y, v: -0.3 * y**3, settings={"free_runs": True})


def test_sentence_tables_and_verdict_come_from_one_finding(cubic):
    top = cubic.hypotheses["probability"].idxmax()
    assert top == ("v", "cubic-stiffness") and cubic.hypotheses["probability"].sum() == pytest.approx(1.0)
    assert cubic.rounds["verdict"].tolist()[1] == "cubic-stiffness"
    assert cubic.against == () and cubic.checks["ok"].all()


def test_a_hidden_cubic_spring_is_named(cubic):
    assert cubic.verdict == "named"
    row = added(cubic).loc["cubic-stiffness"]
    # A power law whose exponent is about three has the rest.
    assert row["probability"] > 0.9
    # Four posterior standard deviations; the interval's coverage is measured by the benchmark.
    assert abs(row["mean"] + 0.3) < 4 * row["sd"]
    assert row["lower"] < row["mean"] < row["upper"]
    assert row["unit"] == "1/m²/s²"
    assert "cubic stiffness" in cubic.sentence


def test_it_is_found_where_it_acts(cubic):
    region = cubic.where.query("kind == 'region'").iloc[0]
    assert region["description"].startswith("|y| >")
    assert region["gap_share"] > 0.9
    trace = cubic.traces["v"]
    gap = np.abs(0.3 * cubic.train.states["y"] ** 3)
    # The threshold is one noise SD; rows within 30 % of it may fall on either side.
    clear = np.abs(np.log(gap / NOISE)) > np.log(1.3)
    # A force that is known along time alone, to half the threshold, is wrong on a few of them.
    assert np.mean((trace.probability > 0.5)[clear] == (gap > NOISE)[clear]) > 0.95


def test_adding_it_closes_the_gap_on_held_out_data(cubic):
    assert cubic.gap.loc[("test", "unexplained share", "v"), "closed"] > 0.95
    assert cubic.gap.loc[("test", "free-run NRMSE", "y"), "closed"] > 0.9
    assert cubic.paths["y"].after.mean.shape == (N_OBS,)


def test_the_record_is_plain_json(cubic):
    record = json.loads(json.dumps(cubic.record(), allow_nan=False))
    assert record["verdict"] == "named" and record["against"] == []
    assert {"instrument", "checks"} <= set(record) and all(check["ok"] for check in record["checks"])
    assert record["effects"][0]["slug"] == "cubic-stiffness"


def test_terms_of_the_simulation_are_no_effects_of_their_own(cubic):
    reason = cubic.left_out[("v", "viscous-damping")]
    assert "recalibration" in reason
    assert "viscous-damping" not in set(cubic.effects["slug"])


def test_nothing_hidden_is_no_gap():
    found = study(lambda y, v: 0.0 * y)
    assert found.verdict == "no gap"
    assert added(found).empty
    assert found.gap.loc[("test", "derivative NMSE", "v"), "closed"] == 0


def test_a_wrong_coefficient_is_recalibrated():
    found = study(lambda y, v: 0.0 * y, k=2.2)
    assert found.verdict == "recalibrate"
    row = found.corrections.loc[("v", "y")]
    assert row["probability"] > 0.95
    assert row["mean"] == pytest.approx(-0.2, abs=0.02)


@pytest.mark.slow
def test_the_inner_parameter_of_a_dead_zone_is_found():
    found = study(lambda y, v: -0.6 * np.sign(y) * np.maximum(np.abs(y) - 0.37, 0))
    row = added(found).loc["dead-zone"]
    assert row["inner"]["gap"] == pytest.approx(0.37, rel=0.1)


@pytest.mark.slow
def test_two_effects_are_both_found():
    found = study(lambda y, v: -0.3 * y**3 - 0.3 * v * np.abs(v))
    assert set(added(found).index) == {"cubic-stiffness", "quadratic-drag"}
    assert found.verdict == "named"


@pytest.mark.slow
def test_an_effect_that_no_entry_resembles_is_never_named():
    found = study(lambda y, v: 0.4 * np.exp(-(((y - 0.5) / 0.3) ** 2)))
    assert found.verdict in ("unknown", "partly named")
    assert found.hypotheses["probability"].idxmax() == ("v", "unknown")
    # Stand-ins that are stacked for it are told as such.
    assert (added(found)["probability"] < 0.5).all()
    assert found.verdict == "unknown" or any("the catalogue does not have" in text for text in found.against)


def test_the_same_seed_gives_the_same_study(cubic):
    again = study(lambda y, v: -0.3 * y**3)
    assert again.effects["mean"].tolist() == cubic.effects["mean"].tolist()


def test_a_function_as_simulation_is_corrected_through_the_dictionary():
    def rates(t, x, u):
        return [x[1], u[0] - 2 * x[0] - 0.15 * x[1]]

    train = oscillator(lambda y, v: -0.3 * y**3, 1)
    model = bg.GreyBox(
        simulation=rates, dictionary={"v": ["y"]}, discrepancy=bg.OrthogonalGP(variables=("y", "v"), features=6)
    )
    found = bg.find_missing_effects(
        model, train, roles={"position": "y", "velocity": "v"}, settle=False, free_runs=False, progress=False
    )
    assert "cubic-stiffness" in added(found).index
    assert found.corrections.empty


def test_data_without_a_rate_to_study_are_refused():
    t = np.linspace(0, 1, 20)
    data = bg.Trajectories.from_arrays(t, states={"y": t, "v": t**2})
    with pytest.raises(bg.InputError, match=r"looks at one equation, and the simulation has none that .*differentiate"):
        bg.find_missing_effects(bg.GreyBox(simulation={"y": "v"}), data, progress=False)


def test_kinematic_equations_of_a_function_are_passed_over():
    plain = oscillator(lambda y, v: -0.3 * y**3, 1)
    simulation = lambda t, x, u: [x[1], u[0] - 2 * x[0] - 0.15 * x[1]]  # noqa: E731

    def studied(**rates):
        columns = {"states": dict(plain.states), "inputs": dict(plain.inputs)}
        data = bg.Trajectories.from_arrays(plain.time, **columns, derivatives=rates)
        return studied_equations(bg.GreyBox(simulation=simulation), data)

    assert studied(y=plain.states["v"], v=plain.derivatives["v"]) == ("v",)
    with pytest.raises(bg.InputError, match="equals every measured derivative exactly"):
        studied(y=plain.states["v"])


@pytest.mark.slow
def test_a_simulation_without_any_term_is_studied():
    found = study(lambda y, v: -0.3 * y**3, simulation={"y": "v"})
    # All of the restoring force and the drive are missing; whatever is named, nothing breaks on an empty model.
    assert found.verdict in ("named", "partly named", "unknown") and found.corrections.empty
    alone = bg.find_missing_effects(
        bg.GreyBox(simulation=lambda t, x, u: [x[1], u[0] - 2 * x[0] - 0.15 * x[1]],
                   discrepancy=bg.OrthogonalGP(variables=("y", "v"), features=6)),
        oscillator(lambda y, v: -0.3 * y**3, 1),
        roles={"position": "y", "velocity": "v"}, settle=False, free_runs=False, progress=False,
    )  # fmt: skip
    assert "cubic-stiffness" in added(alone).index


@pytest.mark.slow
def test_a_second_place_of_the_same_effect_is_found():
    rng, t = np.random.default_rng(4), 0.05 * np.arange(300)
    first, second = (1 + 0.5 * np.sin(w * t + p) for w, p in ((1.7, 1.0), (0.6, 2.0)))
    # log(prey)' = 0.9 − 0.5 first − 0.4 second
    prey = np.exp(0.25 * (np.cos(1.7 * t + 1) - np.cos(1)) / 1.7 + 0.2 * (np.cos(0.6 * t + 2) - np.cos(2)) / 0.6)
    rate = 0.9 * prey - 0.5 * prey * first - 0.4 * prey * second + 0.02 * rng.standard_normal(300)
    data = bg.Trajectories.from_arrays(t, states={"prey": prey, "a": first, "b": second}, derivatives={"prey": rate})
    model = bg.GreyBox(simulation={"prey": "0.9*prey"}, discrepancy=bg.OrthogonalGP(features=6))
    found = bg.find_missing_effects(model, data, catalogue="population", settle=False, free_runs=False, progress=False)
    both = found.effects.query("status == 'added' and slug == 'bilinear-interaction'")
    assert sorted(both["expression"]) == ["prey*a", "prey*b"] and found.verdict == "named"


@pytest.mark.slow
def test_a_gap_that_was_not_measured_on_the_test_data_is_told_of_the_training_data():
    train = oscillator(lambda y, v: -0.3 * y**3, 1)
    test = oscillator(lambda y, v: -0.3 * y**3, 2)
    bare = bg.Trajectories.from_arrays(test.time, states=dict(test.states), inputs=dict(test.inputs))
    model = bg.GreyBox(
        simulation={"y": "v", "v": "F - 2*y - 0.15*v"}, discrepancy=bg.OrthogonalGP(variables=("y", "v"), features=6)
    )
    found = bg.find_missing_effects(model, train, bare, settle=False, progress=False)
    assert "of the gap on the training data" in found.sentence
    assert ("test", "free-run NRMSE", "y") in found.gap.index


def test_what_cannot_be_used_is_refused_before_the_search():
    train = oscillator(lambda y, v: 0.0 * y, 1)
    model = bg.GreyBox(simulation={"y": "v", "v": "F - 2*y - 0.15*v"})
    blind = bg.Trajectories.from_arrays(train.time, states=dict(train.states))
    with pytest.raises(bg.InputError, match="The test data have no 'F'"):
        bg.find_missing_effects(model, train, blind, progress=False)
    parts = {name: [column[:50], column[50:51]] for name, column in train.columns.items()}
    short = bg.Trajectories.from_arrays(
        [train.time[:50], train.time[50:51]],
        states={name: parts[name] for name in ("y", "v")},
        inputs={"F": parts["F"]},
        derivatives={"v": [train.derivatives["v"][:50], train.derivatives["v"][50:51]]},
    )
    with pytest.raises(bg.InputError, match="Run .* of the training data has one row.*free_runs=False"):
        bg.find_missing_effects(model, short, progress=False)
    for field, value in (("correction", 0.0), ("no_gap", 1.0), ("unknown", float("nan"))):
        with pytest.raises(bg.InputError, match=f"{field} = .* must be a probability above 0 and below 1"):
            bg.Odds(**{field: value})
    with pytest.raises(bg.InputError, match="they are parts of 1"):
        bg.Odds(effects=0.9)


@pytest.mark.slow
def test_several_equations_are_studied_with_the_odds_of_the_system():
    rng, t = np.random.default_rng(4), 0.05 * np.arange(150)
    hunter = 1.5 * np.exp(-0.3 * t)
    prey = np.exp(0.3 * t - 2.5 * (1 - np.exp(-0.3 * t)))
    noise = 0.02 * rng.standard_normal((2, 150))
    rates = {"prey": 0.3 * prey - 0.5 * prey * hunter + noise[0], "hunter": -0.3 * hunter + noise[1]}
    data = bg.Trajectories.from_arrays(t, states={"prey": prey, "hunter": hunter}, derivatives=rates)
    model = bg.GreyBox(
        simulation={"prey": "0.3*prey", "hunter": "-0.3*hunter"}, discrepancy=bg.OrthogonalGP(features=5)
    )
    given = {"catalogue": "population", "settle": False, "free_runs": False, "progress": False}
    found = bg.find_missing_effects(model, data, **given)
    assert found.verdict == "named" and found.settings["prior odds"]["no_gap"] == bg.Odds().no_gap
    assert added(found).index.tolist() == ["bilinear-interaction"]
    by_equation = found.hypotheses["probability"].groupby(level="equation").sum()
    assert by_equation.to_dict() == pytest.approx({"prey": 1.0, "hunter": 1.0})
    json.dumps(found.record(), allow_nan=False)


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [lambda y, v: 0.0 * y, lambda y, v: -0.6 * y**3])
def test_filtered_rates_go_through(hidden):
    plain = oscillator(hidden, 1, noise=0.0)
    rng = np.random.default_rng(0)
    v = plain.states["v"] + 0.002 * rng.standard_normal(N_OBS)
    measured = bg.Trajectories.from_arrays(
        plain.time, states={"y": plain.states["y"], "v": v}, inputs=dict(plain.inputs)
    )
    data = measured.differentiate("savgol")
    model = bg.GreyBox(
        simulation={"y": "v", "v": "F - 2*y - 0.15*v"}, discrepancy=bg.OrthogonalGP(variables=("y", "v"), features=4)
    )
    found = bg.find_missing_effects(model, data, settle=False, free_runs=False, progress=False)
    names = set(added(found).index)
    assert names <= {"cubic-stiffness"}
    assert (found.verdict == "no gap") == (hidden(1.0, 0.0) == 0.0)
    json.dumps(found.record(), allow_nan=False)
