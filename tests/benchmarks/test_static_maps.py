"""Static maps: the data, and what a replicate records."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_greybox.physics.catalogue.loading import catalogue
from bayes_greybox.running.errors import InputError
from benchmarks.runner import Asked, perform
from benchmarks.sampled_systems.samples import CORRELATION
from benchmarks.static_maps.maps import HIDDEN, NOISE_OF_OUTPUT, maps, measured
from benchmarks.static_maps.oracle import LAWS, posterior
from benchmarks.static_maps.run import STATIC_MAPS, cases, score, study


@pytest.mark.parametrize("name", maps())
def test_a_map_has_an_output_and_no_derivative(name):
    each = maps()[name]
    made = measured(each, 0, seed=0)
    for part in (made.train, made.test):
        assert part.output_names == (each.output,) and not part.derivative_names
    assert set(made.truth) == ({each.hidden} if each.hidden else set())
    assert set(made.truth) <= set(catalogue(each.catalogue)["slug"])
    again, other = (measured(each, k, seed=0).train for k in (0, 1))
    np.testing.assert_array_equal(again.rate(each.output), made.train.rate(each.output))
    assert not np.allclose(other.rate(each.output), made.train.rate(each.output))


def test_what_is_left_of_a_map_is_what_is_hidden_and_noise():
    each = maps()["drag-white"]
    made = measured(each, 0, seed=0)
    v, known = made.train.states["v"], 2000 * made.train.states["x"] + 50 * made.train.states["v"]
    hidden = made.truth["quadratic-drag"] * v * np.abs(v)
    assert HIDDEN[0] <= np.sqrt(np.mean(hidden**2) / np.mean(known**2)) <= HIDDEN[1]
    noise = made.train.rate("F") - known - hidden
    assert np.std(noise) == pytest.approx(made.noise, rel=0.1)
    assert made.noise == pytest.approx(NOISE_OF_OUTPUT * np.std(known + hidden))


def test_the_oracle_weighs_the_laws_of_the_catalogue():
    """Their formulas are held to the catalogue's by the tests of hidden effects."""
    assert len(LAWS["F"]) == 19 and {"smooth-friction", "quadratic-drag", "constant-force"} < set(LAWS["F"])
    assert set(LAWS["q"]) == {"linear-outflow", "torricelli-outflow", "overflow", "weir-overflow", "constant-inflow"}


@pytest.mark.parametrize("sensor", ["white", "correlated"])
def test_the_oracle_is_right_as_often_as_it_says(sensor):
    """Of names with probability P the share P is right: 60 replicates, four standard errors of their sum."""
    found = []
    for name in ("drag", "valve", "force-control", "flow-control"):
        each = maps()[f"{name}-{sensor}"]
        found += [(next(iter(p)) == (each.hidden or ""), max(p.values())) for p in _weighed(each, 15)]
    right, said = map(np.array, zip(*found, strict=True))
    assert abs(np.sum(right - said)) < 4 * np.sqrt(np.sum(said * (1 - said))) + 1


def _weighed(each, n):
    return [posterior(each, measured(each, k, seed=0)) for k in range(n)]


def test_correlated_noise_is_correlated_within_runs():
    known = maps()
    made = measured(known["force-control-correlated"], 0, seed=0).train
    noise = made.rate("F") - 2000 * made.states["x"] - 50 * made.states["v"]
    within = np.diff(made.run) == 0
    assert np.corrcoef(noise[1:][within], noise[:-1][within])[0, 1] == pytest.approx(CORRELATION, abs=0.1)


def test_a_map_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(InputError, match="There is no map 'clock'"):
        cases(Asked(tmp_path, only=["clock"]))


def test_scores_count_names_controls_and_coverage():
    row = {"map": "a", "right": True, "tied": True, "named": True, "wrong": [], "covered": {"x": True}}
    row |= {"correlated": False, "oracle": 0.95, "after": 2e-3, "noise_share": 1e-3, "seconds": 2.0}
    table = score(
        [row, {**row, "oracle": 0.8, "named": False, "wrong": ["q"], "covered": {"x": False}, "after": 4e-3}]
    )["maps"]
    assert table.loc["a"].to_dict() == {
        "replicates": 2, "right": 1.0, "tied": 1.0, "named": 0.5, "wrong": 0.5, "correlated": 0.0, "coverage": 0.5,
        "found": 2, "left": 3.0, "seconds": 2.0, "sure": 0.5,
    }  # fmt: skip


def test_a_run_goes_on(tmp_path):
    studied = []

    def study(name, replicate, seed):
        studied.append((name, replicate, seed))
        row = {"right": True, "tied": True, "named": True, "wrong": [], "covered": {}}
        return row | {"correlated": False, "oracle": 1.0, "after": 1e-3, "noise_share": 1e-3, "seconds": 1.0}

    for replicates in (1, 2):
        asked = Asked(tmp_path, only=["drag-white"], replicates=replicates, seed=3, progress=False)
        table = perform(replace(STATIC_MAPS, run=study), cases(asked), asked)["maps"]
    assert studied == [("drag-white", 0, 3), ("drag-white", 1, 3)]
    assert table.loc["drag-white", "replicates"] == 2 and (tmp_path / "maps.csv").exists()


def test_a_replicate_is_studied():
    row = study("valve-white", 1, 0)
    assert row["named"] and row["wrong"] == [] and set(row["covered"]) == {"torricelli-outflow"}
    assert row["oracle"] > 0.9
    assert 0.8 < row["after"] / row["noise_share"] < 1.2 < row["before"] / row["noise_share"]
