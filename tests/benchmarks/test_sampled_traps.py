"""Traps for a study of samples: their data, what counts as wrong and as right, and the run over all of them."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from shell import refuse

from bayes_greybox.discovery.decision.decide import VERDICTS
from bayes_greybox.physics.catalogue.loading import catalogue
from bayes_greybox.running.errors import InputError
from benchmarks.__main__ import main
from benchmarks.registry import BENCHMARKS
from benchmarks.runner import Asked, perform
from benchmarks.sampled_traps import trap as making
from benchmarks.sampled_traps.run import SAMPLED_TRAPS, cases, judged, score, study, traps

TRAPS = traps()


def weighed(**effects: tuple[float, str]) -> pd.DataFrame:
    """A table of effects: probability and status by slug."""
    rows = [(slug.replace("_", "-"), *found) for slug, found in effects.items()]
    return pd.DataFrame(rows, columns=["slug", "probability", "status"])


def named(name, seed) -> dict:
    """A study that names a spring, whatever the trap."""
    trap, spring = TRAPS[name], weighed(cubic_stiffness=(0.97, "added"))
    found = {"verdict": "named", "likeliest": "cubic-stiffness", "probability": 0.97}
    return {**found, **judged(trap, "named", spring), "ring": trap.control, "seconds": 2.0}


def run(study, folder, names, seed=1):
    asked = Asked(folder, only=names, seed=seed, progress=False)
    return perform(replace(SAMPLED_TRAPS, run=study), cases(asked), asked)["traps"]


@pytest.fixture
def coarse(monkeypatch):
    """Paths of few digits, made fast."""

    def solve(*given, rtol, atol, method, **settings):
        return solve_ivp(*given, rtol=1e-2, atol=1e-3, method="RK23", **settings)

    monkeypatch.setattr(making, "solve_ivp", solve)


@pytest.mark.parametrize("trap", TRAPS.values(), ids=lambda trap: trap.name)
def test_samples_are_of_the_simulations_states(coarse, trap):
    data = trap.data(0)
    assert np.isfinite(data.matrix(data.state_names)).all() and not data.derivatives
    measured, hidden = set(data.state_names), set(trap.simulation) - set(data.state_names)
    assert measured <= set(trap.simulation) and trap.equation in trap.simulation
    # Every hidden state is the rate of one that is measured, as a speed is.
    assert hidden == {trap.simulation[name] for name in measured} - set(data.input_names)
    assert data.input_names == (("u",) if "u" in " ".join(trap.simulation.values()) else ())
    if trap.hold == "held":
        # Held for many samples: the input hardly ever changes.
        assert np.mean(np.diff(data.inputs["u"]) != 0) < 0.05


@pytest.mark.slow
def test_draws_are_those_of_a_seed_and_of_a_trap(coarse):
    for trap in TRAPS.values():
        data, again, other = (trap.data(seed) for seed in (3, 3, 4))
        for name, x in data.states.items():
            np.testing.assert_array_equal(x, again.states[name])
            assert not np.array_equal(x, other.states[name])
    first = [making.generator(3, number).random() for number in range(1, 25)]
    assert len(set(first)) == 24


def test_a_path_is_that_of_its_equation_and_a_held_drive_is_constant_between_its_breaks():
    t = np.linspace(0.0, 2.0, 21)
    x = making.path(lambda _, x, u: (x[1], -4 * x[0]), (1.0, 0.0), t, begin=-1.0)
    np.testing.assert_allclose(x, [np.cos(2 * (t + 1)), -2 * np.sin(2 * (t + 1))], atol=1e-8)
    value, breaks = making.staircase(np.random.default_rng(0), 2.0, 0.5, 1.0)
    levels = value(breaks[:3] - 0.25)
    np.testing.assert_array_equal(value(breaks[:2]), levels[1:])
    asked = []

    def drive(time):
        asked.append(time)
        return value(time)

    (x,) = making.path(lambda _, x, u: (u,), (0.0,), t, drive, breaks=breaks)
    np.testing.assert_allclose(x[[5, 10, 15]], 0.5 * np.cumsum(levels), atol=1e-12)
    assert sorted(set(asked)) == [0.25, 0.75, 1.25, 1.75]


def test_noise_and_drives_have_the_size_that_they_are_asked_for():
    rng = np.random.default_rng(0)
    x = np.sin(np.linspace(0.0, 300.0, 20_000))
    for clean in (x, 3 * x):
        # A relative error of 0.5 %, at four standard errors.
        noise = making.noisy(rng, x, 0.1, clean) - x
        assert np.std(noise) == pytest.approx(0.1 * np.std(clean), rel=0.02)
    drive = making.multisine(rng, 1.0, 5.0, 9, 2.5)(np.linspace(0.0, 2000.0, 40_000))
    assert np.sqrt(np.mean(drive**2)) == pytest.approx(2.5, rel=0.02)


def test_what_may_be_named_is_in_the_catalogue():
    for trap in TRAPS.values():
        assert trap.allowed | trap.wanted <= set(catalogue(trap.catalogue)["slug"])
        assert not trap.allowed & trap.wanted
        # Controls have an answer, and traps none.
        assert trap.control == bool(trap.wanted or trap.answer) == trap.name.startswith("control-")
        assert trap.answer in (None, *VERDICTS)
    assert len(TRAPS) == 29 and sum(trap.control for trap in TRAPS.values()) == 6


@pytest.mark.parametrize(
    ("name", "verdict", "effects", "wrong", "right"),
    [
        # Traps: a name is wrong if it is in a verdict or sure, and nothing excuses it.
        ("aliased-hum", "named", {"cubic_stiffness": (0.6, "added")}, ["cubic-stiffness"], False),
        ("aliased-hum", "partly named", {"cubic_stiffness": (0.6, "added")}, [], True),
        ("aliased-hum", "partly named", {"cubic_stiffness": (0.95, "added")}, ["cubic-stiffness"], False),
        ("aliased-hum", "one of", {"dead_zone": (0.52, "added"), "cubic_stiffness": (0.4, "one of")}, [], True),
        ("aliased-hum", "unknown", {"quadratic_drag": (0.95, "")}, ["quadratic-drag"], False),
        ("aliased-hum", "unknown", {}, [], True),
        ("amplifier-crossover", "named", {"backlash": (1.0, "added")}, [], True),
        ("amplifier-crossover", "named", {"coulomb_friction": (1.0, "added")}, ["coulomb-friction"], False),
        ("two-laws-as-one", "named", {"coulomb_friction": (1, "added"), "quadratic_drag": (1, "added")}, [], True),
        ("two-laws-as-one", "named", {"viscous_damping": (1.0, "added")}, ["viscous-damping"], False),
        # Controls: besides, their answer must be there, and nothing else in the model.
        ("control-nothing", "no gap", {"cubic_stiffness": (0.02, "")}, [], True),
        ("control-nothing", "unknown", {}, [], False),
        ("control-nothing", "no gap", {"cubic_stiffness": (0.95, "")}, ["cubic-stiffness"], False),
        ("control-nothing", "named", {"cubic_stiffness": (1.0, "added")}, ["cubic-stiffness"], False),
        ("control-cubic", "named", {"cubic_stiffness": (1.0, "added")}, [], True),
        ("control-cubic", "unknown", {"cubic_stiffness": (0.5, "")}, [], False),
        ("control-cubic", "no gap", {}, [], False),
        ("control-cubic", "one of", {"cubic_stiffness": (0.8, "added"), "dead_zone": (0.5, "added")}, [], False),
        ("control-coulomb", "one of", {"coulomb_friction": (0.5, "added"), "stribeck_friction": (0.5, "")}, [], True),
        ("control-coulomb", "named", {"smooth_friction": (1.0, "added")}, [], True),
        ("control-coulomb", "named", {"stribeck_friction": (1.0, "added")}, [], False),
        ("control-literal", "recalibrate", {}, [], True),
        ("control-literal", "named", {"linear_stiffness": (1.0, "added")}, [], True),
        ("control-literal", "no gap", {}, [], False),
    ],
)
def test_names_are_judged(name, verdict, effects, wrong, right):
    assert judged(TRAPS[name], verdict, weighed(**effects)) == {"wrong": wrong, "right": right}


def test_scores_have_a_row_a_trap_and_counts_keep_controls_apart():
    refused = {"trap": "b", "control": False, "refused": "No path.", "wrong": [], "right": True}
    tempted = {"trap": "a", "control": False, "verdict": "named", "likeliest": "x", "probability": 0.99}
    tempted |= {"wrong": ["x", "y"], "right": False, "ring": False, "seconds": 3.0}
    silent = {**tempted, "trap": "c", "control": True, "verdict": "unknown", "wrong": [], "ring": True}
    tables = score([tempted, refused, silent])
    table = tables["traps"]
    assert table.loc["a"].to_dict() == {
        "control": False,
        "verdict": "named",
        "likeliest": "x",
        "probability": 0.99,
        "wrong": "x, y",
        "right": False,
        "ring": False,
        "seconds": 3.0,
    }
    assert table.loc["b", "verdict"] == "refused" and np.isnan(table.loc["b", "seconds"])
    assert tables["counts"].to_dict("index") == {
        "traps": {"cases": 2, "right": 1, "wrong": 1, "refused": 1, "ring": 0},
        "controls": {"cases": 1, "right": 0, "wrong": 0, "refused": 0, "ring": 1},
    }
    assert score([tempted])["counts"]["cases"].to_dict() == {"traps": 1, "controls": 0}


@pytest.mark.parametrize("name", ["control-coulomb", "two-point-float"])
def test_a_study_is_given_the_samples_and_not_their_noise(monkeypatch, name):
    trap, calls = TRAPS[name], []
    effects = weighed(quadratic_drag=(0.95, "added"), cubic_input=(0.02, "")).set_index("slug")
    instrument = pd.DataFrame({"suspect": ["delay", "gain"], "status": ["in the model", ""]})

    def find(model, train, **settings):
        calls.append((model, train, settings))
        return SimpleNamespace(verdict="partly named", against=("worse",), effects=effects, instrument=instrument)

    monkeypatch.setattr("bayes_greybox.missing_effects.find_missing_effects", find)
    row = study(name, 5)
    ((model, train, settings),) = calls
    assert dict(model.simulation) == trap.simulation and model.rows.follows_path
    assert {state: tuple(terms) for state, terms in model.dictionary.items()} == {trap.equation: trap.learned}
    for data, seed in ((train, 5), (settings["test"], 1005)):
        for state, x in trap.data(seed).states.items():
            np.testing.assert_array_equal(data.states[state], x)
    held, domain = ("zoh", "mechanical") if name == "control-coulomb" else (None, "fluid")
    assert model.rows.interpolation == held and settings["catalogue"] == domain
    assert settings["free_runs"] and not settings["settle"] and not settings["progress"]
    assert row.pop("seconds") >= 0 and json.loads(json.dumps(row)) == row
    assert row == {
        "verdict": "partly named",
        "likeliest": "quadratic-drag",
        "probability": 0.95,
        "wrong": ["quadratic-drag"],
        "right": False,
        "against": ["worse"],
        "ring": True,
        "instrument": ["delay"],
    }


def test_a_run_goes_on_where_it_was(tmp_path):
    names, asked = ["aliased-hum", "control-nothing", "control-cubic"], []

    def stopped(name, seed):
        if len(asked) == 2:
            raise RuntimeError("Stopped.")
        asked.append((name, seed))
        return named(name, seed)

    with pytest.raises(RuntimeError, match="Stopped"):
        run(stopped, tmp_path, names, 7)
    assert asked == [("aliased-hum", 7), ("control-nothing", 7)]
    asked.clear()
    table = run(stopped, tmp_path, names, 7)
    assert asked == [("control-cubic", 7)] and table["right"].tolist() == [False, False, True]
    again = run(stopped, tmp_path, names, 7)
    assert len(asked) == 1 and again.equals(table)
    assert len((tmp_path / "results.jsonl").read_text().splitlines()) == 3
    assert pd.read_csv(tmp_path / "traps.csv")["trap"].tolist() == names
    saved = json.loads((tmp_path / "summary.json").read_text())
    assert saved["seed"] == 7
    assert saved["counts"][0] == {
        "kind": "traps",
        "cases": 1,
        "right": 0,
        "wrong": 1,
        "refused": 0,
        "ring": 0,
    }
    run(stopped, tmp_path, names[:1], 8)
    assert asked[1:] == [("aliased-hum", 8)]


def test_a_study_that_is_refused_escapes_a_trap_and_fails_a_control(tmp_path):
    def refused(name, seed):
        raise InputError("No path.")

    table = run(refused, tmp_path, ["aliased-hum", "control-nothing"])
    assert table["verdict"].tolist() == ["refused", "refused"] and table["right"].tolist() == [True, False]
    assert (table["wrong"] == "").all() and "No path." in (tmp_path / "results.jsonl").read_text()


def test_a_folder_that_cannot_be_written_to_and_an_unknown_trap_are_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="Cannot write to the folder"):
        run(named, tmp_path / "file", None)
    with pytest.raises(InputError, match="There is no trap 'mouse'; there are truncating-adc"):
        run(named, tmp_path, ["mouse"])


def test_the_command_runs_some_cases_and_has_no_replicates(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(BENCHMARKS, "sampled-traps", replace(SAMPLED_TRAPS, run=named))
    words = ["sampled-traps", "--cases", "2", "--seed", "3", "-o", str(tmp_path), "--no-progress"]
    assert main(words) == 0
    out = capsys.readouterr().out
    first, second, *others = TRAPS
    assert f"\n{first}  " in out and f"\n{second}  " in out and others[0] not in out
    assert "cubic stiffness" in out and "…" not in out
    keys = [json.loads(line)["key"] for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert keys == [f"{first}/3", f"{second}/3"]
    sentence = refuse(capsys, "sampled-traps", "--replicates", "2", "-o", str(tmp_path / "more"), main=main)
    assert (
        sentence
        == "--replicates does not apply to sampled-traps; leave it out. It has --cases, --only, --workers, --seed."
    )
    assert "There is no trap 'trap'" in refuse(
        capsys, *words[:1], "--only", "trap", "-o", str(tmp_path / "more"), main=main
    )
    assert not (tmp_path / "more").exists()
    own = ["-o", str(tmp_path / "own"), "--no-progress", "--only", others[0]]
    assert main([*words[:1], *own]) == 0
    out = capsys.readouterr().out
    assert f"\n{others[0]}  " in out and f"\n{first}  " not in out
