"""Effects with memory: found along the path of samples, told from each other, and added to the model."""

import json
from dataclasses import replace

import numpy as np
import pytest
import sympy
from sampled_oscillator import SIMULATION, force
from scipy.integrate import solve_ivp

import bayes_greybox as bg
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.extended import hidden_used
from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.report.pages.study_page import study_html
from bayes_greybox.running.errors import InputError


def only(*slugs):
    """These effects alone: the others cost time and tell no more."""
    return [
        replace(e, confusions=tuple({*slugs} & {*e.confusions}))
        for e in load_catalogue("mechanical")
        if e.slug in slugs
    ]


FEW = only("bouc-wen", "maxwell-damper", "actuator-lag", "coulomb-friction")
"""Enough to be told apart from."""

CUBIC, SMALL = bg.TrajectoryRows(interpolation="cubic"), bg.OrthogonalGP(variables=("y",), features=4)
"""What inputs do between samples, and an f that costs little: what it would take is not asked here."""

WHITE = bg.Odds(noise=1e-6)
"""The noise is white, and that is no question here: weighing all once more under another noise takes long."""

MEMORIES = {"bouc-wen", "dahl-friction", "maxwell-damper", "actuator-lag", "absorber", "lugre-friction"}

LIMIT, TAU = 0.3, 0.8

HIDDEN = {
    "bouc-wen": (-1.2, lambda v, F, z: v - (abs(v) * z + v * abs(z)) / (2 * LIMIT), lambda F, z: z),
    "maxwell-damper": (-0.7, lambda v, F, z: v - z / TAU, lambda F, z: z),
    "actuator-lag": (1.0, lambda v, F, z: (F - z) / TAU, lambda F, z: z - F),
}


def path(slug, phase=0.0, n=160, step=0.1):
    """Position, velocity and hidden state, by a solver of its own."""
    theta, rate, pull = HIDDEN[slug]
    t = step * np.arange(n)

    def rates(time, x):
        y, v, z = x
        F = force(time, phase)
        return [v, F - 2 * y - 0.15 * v + theta * pull(F, z), rate(v, F, z)]

    tight = {"rtol": 1e-8, "atol": 1e-9, "max_step": step}
    return t, force(t, phase), solve_ivp(rates, (0, t[-1]), [0.0, 0.0, 0.0], t_eval=t, **tight).y


def samples(slug, noise=0.01, seed=0, **given):
    t, F, x = path(slug, **given)
    y = x[0] + noise * np.std(x[0]) * np.random.default_rng(seed).standard_normal(len(t))
    units = {"t": "s", "y": "m", "F": "m/s^2"}
    return Trajectories.from_arrays(t, states={"y": y}, inputs={"F": F}, units=units)


def study(data, test=None, **given):
    model = given.pop("model", bg.GreyBox(simulation=SIMULATION, rows=CUBIC, discrepancy=SMALL))
    given = {"free_runs": False, "settle": False, "progress": False, "catalogue": FEW, "odds": WHITE} | given
    return bg.find_missing_effects(model, data, test, **given)


@pytest.fixture(scope="module")
def hysteresis():
    """With the f that studies have by default; under their odds of other noise nothing is found below."""
    some = only("bouc-wen", "dahl-friction", "coulomb-friction")
    model, held_out = bg.GreyBox(simulation=SIMULATION, rows=CUBIC), samples("bouc-wen", phase=1.0, seed=1)
    return study(samples("bouc-wen"), held_out, model=model, catalogue=some, free_runs=True)


def named(found, slug):
    assert found.verdict == "named", found.sentence
    row = found.effects.iloc[0]
    assert row["slug"] == slug and row["probability"] > 0.9
    assert abs(row["mean"] - HIDDEN[slug][0]) < 4 * row["sd"] < 0.1
    return row


def test_hysteresis_is_named_with_its_coefficient_and_its_yield_displacement(hysteresis):
    row = named(hysteresis, "bouc-wen")
    assert row["inner"]["yield_displacement"] == pytest.approx(LIMIT, rel=0.05)
    assert set(row["hidden"]) == {row["expression"]}


@pytest.mark.slow
def test_relaxation_is_named():
    some = only("maxwell-damper", "dahl-friction", "cubic-stiffness")
    row = named(study(samples("maxwell-damper"), catalogue=some), "maxwell-damper")
    (inner,) = row["inner"].values()
    assert inner == pytest.approx(TAU, rel=0.05)


@pytest.mark.slow
def test_a_lag_is_found_and_of_a_linear_machine_may_be_the_sensors():
    found = study(samples("actuator-lag"), catalogue=only("actuator-lag", "maxwell-damper", "cubic-input"))
    row = found.effects.set_index("slug").loc["actuator-lag"]
    assert found.verdict == "one of", found.sentence
    assert row["status"] == "added" and row["tied_with"] == ("lag of y",)
    # One transfer function: at 1 % noise the input between its samples tells a little.
    assert 0.1 < row["probability"] < 0.9
    (inner,) = row["inner"].values()
    assert inner == pytest.approx(TAU, rel=0.05)
    assert abs(row["mean"] - HIDDEN["actuator-lag"][0]) < 4 * row["sd"] < 0.1
    assert "another one beside it" in found.ties[0]["advice"]
    assert found.hypotheses.loc[("v", "instrument"), "probability"] > 0.1


@pytest.mark.slow
def test_an_input_that_is_late_is_no_lag():
    """Both leave less of the input, and later; along the path of a lag a delay fits worse than along its own."""
    t, late = 0.1 * np.arange(160), 0.15

    def other(time):
        return 0.8 * np.sin(0.9 * time + 0.4) + 0.6 * np.sin(2.1 * time)

    def rates(time, x):
        return [x[1], force(time) + 0.7 * other(time - late) - 2 * x[0] - 0.15 * x[1]]

    x = solve_ivp(rates, (0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-10, max_step=0.1).y
    y = x[0] + 0.01 * np.std(x[0]) * np.random.default_rng(0).standard_normal(len(t))
    data = Trajectories.from_arrays(t, states={"y": y}, inputs={"F": force(t), "G": other(t)})
    simulation = {"y": "v", "v": "F + 0.7*G - 2*y - 0.15*v"}
    model = bg.GreyBox(simulation=simulation, rows=CUBIC, discrepancy=SMALL)
    found = study(data, model=model, catalogue=only("actuator-lag", "cubic-input"))
    row = found.instrument.iloc[0]
    assert (row["suspect"], row["channel"], row["status"]) == ("delay", "G", "in the model"), found.sentence
    assert "actuator-lag" not in set(found.effects.loc[found.effects["status"] == "added", "slug"])
    # The input was recorded before it acted.
    assert abs(row["mean"] + late) < 4 * row["sd"] < 0.1


def test_the_extended_model_has_the_hidden_state(hysteresis):
    (name,) = hysteresis.effects.iloc[0]["hidden"]
    model = hysteresis.model
    assert set(model.simulation) == {"y", "v", name} and name in [term.name for term in model.dictionary["v"]]
    assert dict(model.rows.at_rest) == {name: "y"}
    assert model.discrepancy.variables == ("y", "v", "F")
    # The user's own model is as it was.
    assert set(hysteresis.base.simulation) == {"y", "v"}


def test_the_equations_that_are_taken_out_have_the_hidden_state(hysteresis):
    (name,) = hysteresis.effects.iloc[0]["hidden"]
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-0.5, 0.5, (8, 3)), rng.uniform(-1, 1, (8, 1))
    rates = hysteresis.to_callable()
    assert rates.states == rates.equations == ("y", "v", name) and rates.inputs == ("F",)
    (y, v, z), F = x.T, u[:, 0]
    record = json.loads(hysteresis.to_json())
    assert record["hidden_states"] == ["v", name]
    own = {each["name"]: each for each in record["equations"]}
    (term,), (inner,) = own["v"]["terms"], own["v"]["inner_parameters"]
    assert (inner["effect"], inner["unit"]) == ("bouc-wen", "m") and inner["mean"] == pytest.approx(LIMIT, rel=0.05)
    # Its rate by hand, with the value that the path has.
    bend = v - (abs(v) * z + v * abs(z)) / (2 * inner["mean"])
    by_hand = np.stack([v, F - 2 * y - 0.15 * v + term["mean"] * z, bend], axis=-1)
    np.testing.assert_allclose(rates(0.0, x, u), by_hand, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(hysteresis.to_callable("jax")(0.0, x, u), by_hand, rtol=1e-8, atol=1e-8)
    names = [sympy.Symbol(each, real=True) for each in (*rates.states, "F")]
    found = [sympy.lambdify(names, e)(y, v, z, F) for e in hysteresis.to_sympy().values()]
    np.testing.assert_allclose(np.stack(found, axis=-1), by_hand, rtol=1e-8, atol=1e-8)
    # What free runs integrate, draw by draw.
    added = hysteresis.amendments["v"].rates({"y": y, "v": v, "F": F, name: z}, 5)[1]
    assert np.ptp(added, axis=0).max() > 1e-4
    n = len(hysteresis.amendments["v"].alike)
    every = hysteresis.amendments["v"].rates({"y": y, "v": v, "F": F, name: z}, n)[1]
    drawn = hysteresis.to_callable(draws=n)(0.0, x, u)[..., 1]
    np.testing.assert_allclose(drawn, F - 2 * y - 0.15 * v + every, rtol=1e-8, atol=1e-8)
    shown = repr(hysteresis)
    assert f"\nd({name})/dt = " in shown and "yield_displacement = 0." in shown


@pytest.mark.slow
def test_an_effect_that_the_model_has_already_is_not_weighed_again(hysteresis):
    again = bg.GreyBox(
        hysteresis.model.dictionary, simulation=hysteresis.model.simulation, rows=CUBIC, discrepancy=SMALL
    )
    found = study(samples("bouc-wen"), model=again, catalogue=only("bouc-wen", "coulomb-friction"))
    assert "in the model already" in found.left_out["v", "bouc-wen"]
    assert "bouc-wen" not in set(found.effects["slug"])


def test_the_free_run_after_is_that_of_the_whole_system(hysteresis):
    t, _, exact = path("bouc-wen", phase=1.0)
    runs = hysteresis.free_run(samples("bouc-wen", phase=1.0, seed=1))
    assert set(runs) == {"y", "v"}
    for name, x in zip(("y", "v"), exact, strict=False):
        assert np.sqrt(np.mean((runs[name].after.mean - x) ** 2)) < 0.03 * np.std(x)
        assert np.sqrt(np.mean((runs[name].before.mean - x) ** 2)) > 0.2 * np.std(x)
    assert len(runs["y"].time) == len(t)


def test_the_gap_is_closed_on_held_out_samples_and_says_nothing_of_the_hidden_state(hysteresis):
    gap = hysteresis.gap
    assert gap.loc[("test", "sample NMSE", "v"), "after"] < 0.01 * gap.loc[("test", "sample NMSE", "v"), "before"]
    assert set(gap.index.get_level_values("variable")) <= {"y", "v"}
    assert hysteresis.checks.loc[("v", "linearity"), "ok"]


def test_its_page_and_its_record_have_the_rate_of_the_hidden_state(hysteresis, tmp_path):
    (name,) = hysteresis.effects.iloc[0]["hidden"]
    study_html(hysteresis, tmp_path / "study.html")
    text = (tmp_path / "study.html").read_text(encoding="utf-8")
    assert "Bouc-Wen hysteresis" in text and f"{name} = " in text
    (row,) = [
        e for e in json.loads(json.dumps(hysteresis.record(), default=float))["effects"] if e["status"] == "added"
    ]
    assert list(row["hidden"]) == [name]


@pytest.mark.slow
def test_a_study_with_a_memory_is_sampled_saved_and_loaded(tmp_path):
    data = samples("maxwell-damper")
    found = study(data, catalogue=only("maxwell-damper"), settle=True, draws=30, tune=40, chains=1)
    row = found.effects.iloc[0]
    theta = found.fit.summary().loc[("v", row["expression"])]
    assert abs(theta["mean"] - HIDDEN["maxwell-damper"][0]) < 5 * theta["sd"]
    found.save(tmp_path / "study.nc")
    read = bg.load(tmp_path / "study.nc")
    assert read.to_json() == found.to_json() and read.amendments["v"].hidden == found.amendments["v"].hidden
    again = read.fit
    assert dict(again.model.simulation) == dict(found.model.simulation)
    assert again.model.rows.at_rest == found.model.rows.at_rest
    held_out = samples("maxwell-damper", phase=1.0, seed=1)
    exact = path("maxwell-damper", phase=1.0)[2][0]
    run = again.simulate(again.model.complete(held_out)).states["y"].mean
    assert np.sqrt(np.mean((run - exact) ** 2)) < 0.1 * np.std(exact)


def test_rows_of_rates_leave_them_out_and_say_so():
    t, F, (y, v, _) = path("bouc-wen", n=60)
    rng = np.random.default_rng(0)
    a = np.gradient(v, t) + 0.02 * rng.standard_normal(len(t))
    data = Trajectories.from_arrays(t, states={"y": y, "v": v}, inputs={"F": F}, derivatives={"y": v, "v": a})
    found = study(
        data,
        model=bg.GreyBox(simulation=SIMULATION, discrepancy=SMALL),
        catalogue=only(*MEMORIES, "cubic-stiffness"),
    )
    said = {slug: why for (_, slug), why in found.left_out.items() if slug in MEMORIES}
    assert set(said) == MEMORIES and all("rows of rates" in why and "TrajectoryRows" in why for why in said.values())
    assert not MEMORIES & set(found.effects["slug"])


@pytest.mark.slow
def test_a_simulation_that_is_a_function_leaves_them_out_and_says_so():
    def rates(t, x, u):
        return [x[1], u[0] - 2 * x[0] - 0.15 * x[1]]

    t, F, (y, v, _) = path("bouc-wen", n=40)
    rng = np.random.default_rng(0)
    data = Trajectories.from_arrays(
        t, states={"y": y + 0.01 * rng.standard_normal(40), "v": v + 0.01 * rng.standard_normal(40)}, inputs={"F": F}
    )
    rows = replace(CUBIC, substeps=1)
    found = study(data, model=bg.GreyBox({"v": []}, simulation=rates, rows=rows, discrepancy=SMALL))
    said = {slug for (_, slug), why in found.left_out.items() if "as formulas" in why}
    assert said == MEMORIES & {e.slug for e in FEW}
    with pytest.raises(InputError, match="as formulas"):
        found.base.remembering([HiddenState("z", "v - z", "y")], data)


def test_where_nothing_is_missing_no_memory_is_found():
    t = 0.1 * np.arange(160)
    x = solve_ivp(
        lambda s, x: [x[1], force(s) - 2 * x[0] - 0.15 * x[1]], (0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-10
    ).y
    y = x[0] + 0.02 * np.std(x[0]) * np.random.default_rng(2).standard_normal(len(t))
    data = Trajectories.from_arrays(t, states={"y": y}, inputs={"F": force(t)}, units={"t": "s", "y": "m"})
    found = study(data, catalogue=only("bouc-wen", "maxwell-damper"), odds=bg.Odds())
    assert found.verdict == "no gap" and found.effects["probability"].max() < 0.2


def test_hidden_states_that_no_term_uses_are_no_part_of_the_answer():
    z, w, other = HiddenState("z", "w", "y"), HiddenState("w", "y - z", "v"), HiddenState("h", "v - h", "y")
    assert hidden_used({"v": [bg.Term("z - y")]}, (z, w, other)) == (z, w)
    assert hidden_used({"v": [bg.Term("y**3")]}, (z, w, other)) == ()
