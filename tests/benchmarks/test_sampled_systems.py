"""Systems that a sensor of a position shows: the data, and what a replicate records."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_greybox.physics.catalogue.loading import catalogue
from bayes_greybox.running.errors import InputError
from benchmarks.runner import Asked, perform
from benchmarks.sampled_systems.coverage import SAMPLED_COVERAGE
from benchmarks.sampled_systems.run import SAMPLED_SYSTEMS, cases, score
from benchmarks.sampled_systems.samples import CORRELATION, sampled
from benchmarks.sampled_systems.systems import systems


def test_a_sensor_shows_the_position_alone_and_its_noise_is_the_replicates():
    system = systems()["oscillator-white"]
    train, test = sampled(system, 0, seed=0)
    assert train.state_names == ("y",) and train.input_names == ("F",) and not train.derivatives
    assert not np.allclose(train.inputs["F"], test.inputs["F"])
    again, other = sampled(system, 0, seed=0)[0], sampled(system, 1, seed=0)[0]
    np.testing.assert_array_equal(again.states["y"], train.states["y"])
    noise = (other.states["y"] - train.states["y"]) / np.sqrt(2)
    assert np.std(noise) == pytest.approx(0.03 * np.std(train.states["y"]), rel=0.15)


def test_what_is_hidden_is_in_the_catalogue():
    for system in systems().values():
        assert set(system.truth) <= set(catalogue(system.catalogue)["slug"])


@pytest.mark.parametrize("name", ["two-masses-0.05", "twin-tanks-0.05", "predator-prey-0.05"])
def test_of_systems_with_hidden_states_one_is_shown(name):
    system = systems()[name]
    train, test = sampled(system, 0, seed=0)
    assert train.state_names == (system.measured,) and set(system.simulation) > {system.measured}
    x = train.states[system.measured]
    # The simulation lacks something: with a start of its own it goes elsewhere, by far more than the noise.
    assert np.all(np.isfinite(x)) and np.std(x - test.states[system.measured]) > 0.1 * np.std(x)


@pytest.mark.slow
def test_correlated_noise_is_correlated_and_pushes_move_the_path():
    known = systems()
    apart = []
    for name in ("oscillator-correlated", "oscillator-shaken"):
        a, b = (sampled(known[name], k, seed=0)[0].states["y"] for k in (0, 1))
        difference = a - b
        apart.append(np.corrcoef(difference[1:], difference[:-1])[0, 1])
    assert apart[0] == pytest.approx(CORRELATION, abs=0.08)
    a, b = (sampled(known["oscillator-shaken"], k, seed=0)[0].states["y"] for k in (0, 1))
    assert np.std(a[200:] - b[200:]) > 2 * 0.03 * np.std(a)


def run(benchmark, tmp_path, **options):
    asked = Asked(tmp_path, progress=False, **options)
    return perform(benchmark, benchmark.cases(asked), asked)


def test_a_study_that_is_refused_is_a_result(tmp_path):
    def refused(name, replicate, seed):
        raise InputError("No path.")

    table = run(replace(SAMPLED_SYSTEMS, run=refused), tmp_path, only=["oscillator-white"], replicates=2)["systems"]
    assert table.loc["oscillator-white", ["replicates", "refused", "right"]].tolist() == [2, 2, 0.0]
    assert "No path." in (tmp_path / "results.jsonl").read_text()


def test_coverage_counts_intervals_by_noise_and_rows():
    row = {"noise": "white", "rows": "samples", "holds": {"y": True, "v": True, "y**3": False}, "seconds": 1.0}
    row |= {"error": {"y": 0.1, "v": 0.0, "y**3": 0.3}, "sd": {"y": 0.1, "v": 0.1, "y**3": 0.1}}
    other = {**row, "holds": {"y": True, "v": False, "y**3": False}, "sd": {"y": 0.1, "v": 0.1, "y**3": 0.2}}
    table = SAMPLED_COVERAGE.score([row, other, {"noise": "white", "rows": "rates", "refused": "No."}])["coverage"]
    samples, rates = table.loc[("white", "samples")], table.loc[("white", "rates")]
    assert samples[["repeats", "refused", "y", "v", "y**3", "seconds"]].tolist() == [2, 0, 1.0, 0.5, 0.0, 1.0]
    assert samples["bias"] == pytest.approx(2.0) and samples["sd"] == pytest.approx(0.15)
    assert rates["refused"] == 1 and np.isnan(rates["y"])


@pytest.mark.slow
def test_intervals_hold_under_every_noise(tmp_path):
    table = run(SAMPLED_COVERAGE, tmp_path, replicates=2)["coverage"]
    assert len(table) == 11 and (table["refused"] == 0).all()
    lines = (tmp_path / "results.jsonl").read_text()
    run(SAMPLED_COVERAGE, tmp_path, replicates=2)
    assert (tmp_path / "results.jsonl").read_text() == lines


def test_a_system_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(InputError, match="There is no system 'clock'"):
        cases(Asked(tmp_path, only=["clock"]))


def test_scores_count_names_and_coverage():
    row = {"system": "a", "right": True, "tied": True, "named": True, "wrong": [], "covered": {"x": True, "z": False}}
    row |= {"after": 2e-3, "noise_share": 1e-3, "seconds": 2.0}
    table = score([row, {**row, "right": False, "named": False, "wrong": ["q"], "covered": {}, "after": 4e-3}])[
        "systems"
    ]
    assert table.loc["a"].to_dict() == pytest.approx(
        {
            "replicates": 2,
            "right": 0.5,
            "tied": 1.0,
            "named": 0.5,
            "wrong": 0.5,
            "refused": 0,
            "coverage": 0.5,
            "found": 2,
            "left": 3.0,
            "seconds": 2.0,
        }  # fmt: skip
    )


@pytest.mark.slow
def test_a_replicate_is_studied_and_a_run_goes_on(tmp_path):
    table = run(SAMPLED_SYSTEMS, tmp_path, only=["oscillator-white"])["systems"]
    assert table.loc["oscillator-white", "right"] == 1.0
    lines = (tmp_path / "results.jsonl").read_text()
    run(SAMPLED_SYSTEMS, tmp_path, only=["oscillator-white"])
    assert (tmp_path / "results.jsonl").read_text() == lines and (tmp_path / "systems.csv").exists()
