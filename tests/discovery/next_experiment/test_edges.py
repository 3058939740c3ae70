"""What to measure next at its edges: nothing to tell, nothing that predicts, and candidates that do not fit."""

from dataclasses import replace

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.data.errors import InputError
from bayes_greybox.discovery.next_experiment import predicted, ranked
from bayes_greybox.discovery.next_experiment.candidates import Candidate, usual_candidates
from bayes_greybox.discovery.next_experiment.explained import Component, Explained, joined
from bayes_greybox.discovery.next_experiment.information import Products
from bayes_greybox.discovery.next_experiment.signals import Hold
from bayes_greybox.missing_effects import Study
from bayes_greybox.physics.terms import Term


def law(name: str, p: float, expression: str, mean: float) -> Explained:
    """An explanation that is one term with a coefficient that is nearly known."""
    component = Component(1.0, ("v",), (Term(expression),), np.array([mean]), np.array([[0.01]]))
    return Explained(name, p, (name,), (component,), {"v": 0.02})


def told(study: Study, *explanations: Explained) -> Study:
    """The study, with explanations of a test's own."""
    return replace(study, explanations={"v": explanations})


NOTHING = Explained("no gap", 0.5, (), (Component(1.0, (), (), np.zeros(0), np.zeros((0, 0))),), {"v": 0.02})
FAR = Candidate({"F": Hold(0.5)}, {"y": 0.5, "v": 0.0}, 3.0, 31, {"v": 0.02}, "far")


def test_identical_predictions_are_worth_nothing_whatever_the_threshold(study):
    twins = told(study, law("one", 0.5, "y**3", -0.8), law("other", 0.5, "y*y*y", -0.8))
    found = twins.next_experiment([FAR], threshold=0.0, outcomes=8)
    assert abs(found.information.bits) < 1e-9
    assert not found.chosen
    assert found.sentence.startswith("No candidate would tell them apart")


def test_two_laws_that_are_far_apart_are_told_apart_entirely_and_one_may_have_no_terms(study):
    found = told(study, NOTHING, law("cubic", 0.5, "y**3", -0.8)).next_experiment([FAR], outcomes=16)
    assert np.isclose(found.information.bits, 1.0, atol=0.01)
    assert found.chosen == (FAR,)


@pytest.mark.parametrize("every", [(), (Explained("unknown", 1.0),), (NOTHING, Explained("unknown", 0.5))])
def test_fewer_than_two_that_predict_are_no_error(study, every):
    found = told(study, *every).next_experiment()
    assert found.sentence.startswith("One explanation is left (unknown)" if len(every) == 1 else "Fewer than two")
    assert len(found.explanations) == len(every)
    assert not found.chosen


def test_a_file_of_before_and_settings_without_effect_are_refused(study):
    with pytest.raises(InputError, match="holds no explanations"):
        replace(study, explanations={}).next_experiment()
    with pytest.raises(InputError, match="rows describes default candidates"):
        told(study, NOTHING, law("cubic", 0.5, "y**3", -0.8)).next_experiment([FAR], rows=10)
    with pytest.raises(InputError, match="threshold"):
        study.next_experiment(threshold=float("nan"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inputs": {}}, "inputs of candidate 'far': 'F' is missing"),
        ({"start": {"y": 0.5}}, "start of candidate 'far': 'v' is missing"),
        ({"inputs": {"F": Hold(0.0), "G": Hold(0.0)}}, "there is no 'G'"),
        ({"sensors": {"z": 1.0}}, "there is no state 'z'; there are y, v"),
    ],
)
def test_candidates_that_do_not_fit_the_model_are_refused(study, change, message):
    with pytest.raises(InputError, match=message):
        told(study, NOTHING, law("cubic", 0.5, "y**3", -0.8)).next_experiment([replace(FAR, **change)], outcomes=4)


def test_only_the_candidate_that_the_steps_do_not_follow_is_said_not_to_be_followed(study):
    stiff = replace(FAR, start={"y": 10.0, "v": 0.0}, duration=30.0, rows=7, name="stiff")
    calm = replace(FAR, start={"y": 0.0, "v": 0.0}, inputs={"F": Hold(0.0)}, duration=30.0, rows=7, name="calm")
    table = told(study, NOTHING, law("cubic", 0.5, "y**3", -0.8)).next_experiment([calm, stiff], outcomes=4).table
    said = dict(zip(table["candidate"], table["said"], strict=True))
    assert "the steps do not follow" in said["stiff"]
    assert "fail" not in said["stiff"]
    assert not said["calm"]


def test_density_survives_coefficients_that_a_response_could_hardly_be_more_sensitive_to():
    G = np.full((1, 2, 2), 1e30)
    assert np.isfinite(Products(np.ones(1), np.ones((1, 2)), G).log_density()).all()


def test_an_input_that_never_moved_is_held_and_the_states_start_elsewhere(study):
    data = study.train
    still = replace(data, inputs={"F": np.full(len(data.time), 2.0)})
    found = usual_candidates(still, {"v": 0.02})
    assert all(each.inputs == {"F": Hold(2.0)} for each in found)
    assert len({tuple(each.start.items()) for each in found}) == len(found) > 2


def test_signals_may_be_an_iterator(study):
    data = study.train
    by = [usual_candidates(data, {"v": 0.02}, signals=names) for names in (["sine"], iter(["sine"]))]
    assert by[0] == by[1]


def test_equations_are_joined_with_their_products_and_one_that_predicts_nothing_says_nothing():
    one = law("a", 0.6, "y", 1.0), Explained("unknown", 0.4)
    other = law("b", 0.7, "y**2", 1.0), law("c", 0.3, "y**3", 1.0)
    found = joined({"u": one, "v": other})
    assert np.isclose(sum(e.probability for e in found), 1.0)
    assert [bool(e.components) for e in found] == ["unknown" not in e.name for e in found]
    assert found[0].components[0].root.shape == (2, 2)


def test_means_that_are_stated_of_coefficients_are_simulated(study):
    """A spring that the dictionary states is the same as one in the simulation: coefficients are what is left."""
    laws = NOTHING, law("cubic", 0.5, "y**3", -0.8)
    stated = bg.GreyBox({"v": [bg.Term("y", prior=(-4.0, 0.1))]}, simulation={"y": "v", "v": "F - 0.5*v"})
    other = replace(told(study, *laws), base=stated.on(study.train))
    one, two = (each.next_experiment([FAR], outcomes=8) for each in (told(study, *laws), other))
    assert two.information.bits == pytest.approx(one.information.bits, abs=1e-6)
    assert two.table["reach"][0] == pytest.approx(one.table["reach"][0], rel=1e-6)


def test_a_state_without_an_equation_cannot_be_simulated(study):
    alone = bg.GreyBox({"v": []}, simulation={"v": "F - 4*y - 0.5*v"}).on(study.train)
    other = replace(told(study, NOTHING, law("cubic", 0.5, "y**3", -0.8)), base=alone)
    with pytest.raises(InputError, match="'y' has no equation to integrate"):
        other.next_experiment([FAR], outcomes=8)


def test_rows_go_in_pieces_where_a_record_is_long(study, monkeypatch):
    laws = told(study, law("cubic", 0.4, "y**3", -0.8), law("linear", 0.3, "y", -0.4), NOTHING)
    asked = ranked._question(laws, laws.explanations["v"], 6, 0)
    (whole,) = predicted.predict(asked, [FAR])
    monkeypatch.setattr(predicted, "AT_ONCE", 18 * 6 * 5)
    (pieces,) = predicted.predict(asked, [FAR])
    for own, again in zip(whole.products, pieces.products, strict=True):
        for one, other in zip(own, again, strict=True):
            np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(pieces.responses["v"], whole.responses["v"])


def test_the_best_of_few_outcomes_is_judged_by_more_before_it_is_chosen(study, monkeypatch):
    """Ten candidates of the same worth but for one that is worth more: first figures alone seldom find it."""
    laws = told(study, law("cubic", 0.5, "y**3", -0.8), law("linear", 0.5, "y", -0.35))
    far = replace(FAR, rows=11)
    same = [replace(far, sensors={"v": 0.072}, name=f"same {i}") for i in range(9)]
    better = replace(far, sensors={"v": 0.06}, name="better")
    chosen = {}
    for finer in (1, 32):
        monkeypatch.setattr(ranked, "FINER", finer)
        monkeypatch.setattr(ranked, "FINALISTS", 10)
        found = [laws.next_experiment([*same, better], outcomes=16, seed=s) for s in range(6)]
        chosen[finer] = sum(each.chosen[0].name == "better" for each in found)
        assert all(each.table["candidate"][0] == each.chosen[0].name for each in found)
    assert chosen[32] >= 5
    assert chosen[32] > chosen[1]
