"""Machines with a memory: their data, and what a replicate records."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.running.errors import InputError
from benchmarks.memory_effects import machines as making
from benchmarks.memory_effects.machines import POSITION_NOISES, SAMPLES, hidden, machines, measured
from benchmarks.memory_effects.run import MEMORY_EFFECTS, cases, score, study
from benchmarks.runner import Asked, perform

ENTRIES = {effect.slug: effect for effect in load_catalogue("mechanical")}


def test_what_the_catalogue_has_is_hidden_within_its_ranges():
    known = {each.name: each for each in hidden() if each.known}
    assert set(known) == {slug for slug, effect in ENTRIES.items() if effect.hidden}
    for slug, each in known.items():
        ranges = [(low, high) for _, low, high in each.inner]
        assert ranges == [(inner.low, inner.high) for inner in ENTRIES[slug].inner]
        assert each.sign == (ENTRIES[slug].sign or 1)
        assert each.states == len(ENTRIES[slug].hidden)
    assert not {each.name for each in hidden() if not each.known} & set(ENTRIES)


@pytest.mark.parametrize("noise", POSITION_NOISES)
def test_half_of_the_cases_hide_nothing(noise):
    of_noise = [machine for machine in machines().values() if machine.noise == noise]
    known = [machine.weight for machine in of_noise if machine.hidden is not None and machine.hidden.known]
    assert sum(known) == sum(machine.weight for machine in of_noise if machine.hidden is None) == 6


@pytest.mark.parametrize(
    "name", ["bouc-wen-0.05", "lugre-friction-0.01", "absorber-0.05", "nothing-0.01", "two-branches-0.05"]
)
def test_a_replicate_is_of_a_position_and_a_force(name, monkeypatch):
    machine, samples = machines()[name], SAMPLES if name.startswith("nothing") else 300
    monkeypatch.setattr(making, "SAMPLES", samples)
    monkeypatch.setattr(making, "HELD_OUT_SAMPLES", 150)
    made, other = (measured(machine, k, seed=0) for k in (0, 1))
    for part in (made.train, made.test):
        assert part.state_names == ("y",) and part.input_names == ("F",) and not part.derivative_names
    assert made.train.n_obs == samples and "y**3" not in made.simulation["v"] and "y**3" in other.simulation["v"]
    assert set(made.truth) == ({machine.hidden.name} if machine.hidden and machine.hidden.known else set())
    assert (made.share > 0.01) == (machine.hidden is not None)


def test_the_noise_is_that_of_the_level_and_the_same_again():
    """Fourth differences of a path that is smooth at 30 samples a period are those of the noise."""
    made, again = (measured(machines()["nothing-0.05"], 0, seed=0).train.states["y"] for _ in range(2))
    np.testing.assert_array_equal(again, made)
    fourth = np.diff(made, 4) / np.sqrt(70)
    assert np.std(fourth) == pytest.approx(0.05 * np.std(made), rel=0.15)


def test_a_kind_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(InputError, match="There is no kind of machine 'clock'"):
        cases(Asked(tmp_path, only=["clock"]))


def row(**changed):
    found = {"kind": "a", "right": True, "tied": True, "unknown": False, "wrong": [], "memoryless": []}
    return found | {"covered": {"x": True}, "seconds": 2.0} | changed


def test_scores_count_names_wrong_names_and_coverage():
    wrong = row(right=False, tied=False, wrong=["q", "bouc-wen"], memoryless=["q"], covered={}, seconds=4.0)
    table = score([row(), row(covered={"x": False}), wrong])["machines"]
    assert table.loc["a"].to_dict() == {
        "cases": 3, "right": 2, "tied": 2, "unknown": 0, "wrong": 1, "memoryless": 1, "coverage": 0.5, "found": 2,
        "seconds": 2.0,
    }  # fmt: skip


def test_a_run_goes_on(tmp_path):
    studied = []

    def study(kind, replicate, seed):
        studied.append((kind, replicate, seed))
        return row(kind=kind)

    for replicates in (1, 2):
        kinds = ["bouc-wen-0.01", "bouc-wen-3-0.01"]
        asked = Asked(tmp_path, only=kinds, replicates=replicates, seed=3, progress=False)
        table = perform(replace(MEMORY_EFFECTS, run=study), cases(asked), asked)["machines"]
    assert sorted(studied) == [("bouc-wen-0.01", 0, 3), ("bouc-wen-0.01", 1, 3), ("bouc-wen-3-0.01", 0, 3)]
    assert table.loc["bouc-wen-0.01", "cases"] == 2 and (tmp_path / "machines.csv").exists()


@pytest.mark.slow
@pytest.mark.parametrize("slug", ["actuator-lag", "absorber", "lugre-friction"])
def test_a_replicate_is_studied(slug):
    found = study(f"{slug}-0.01", 0, 0)
    assert found["right"] and found["wrong"] == [] and set(found["covered"]) == {slug}


@pytest.mark.slow
def test_a_lag_under_noise_is_told_from_all_but_the_sensors():
    # Along a path that follows the noise, a memory of the velocity was 37 nats likelier (seed 60, the first replicate).
    found = study("actuator-lag-0.05", 0, 60)
    assert found["tied"] and found["wrong"] == [] and found["covered"] == {"actuator-lag": True}
