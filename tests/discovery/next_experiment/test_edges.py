"""What to measure next at its edges: nothing to tell, nothing that predicts, and candidates that do not fit."""

from dataclasses import replace

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.discovery.answer.explained import Component, Explained, joined
from bayes_greybox.discovery.next_experiment.ranked import Candidate, usual_candidates
from bayes_greybox.missing_effects import Study
from bayes_greybox.physics.experiments.signals import Hold, Multisine, Noise
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError


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
    unsure = told(study, replace(NOTHING, probability=0.8)).next_experiment()
    assert "One explanation is left" not in unsure.sentence and "no gap (probability 0.80)" in unsure.sentence
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


def test_many_equations_keep_the_likeliest_explanations_of_all_together():
    tied = [law(name, 1 / 3, f"y**{k}", 1.0) for k, name in enumerate("abc", 1)]
    assert len(joined(dict.fromkeys("uvwxz", tied))) == 32
    sure = [law("a", 0.94, "y", 1.0), law("b", 0.06, "y**2", 1.0)]
    found = joined(dict.fromkeys("uvwx", sure))
    assert found[0].probability == pytest.approx(0.94**4)
    assert sum(e.probability for e in found) > 0.97


def test_what_fails_in_one_run_of_fifty_is_not_chosen_whichever_outcomes_show_it(study):
    """The first 64 outcomes of each explanation may show no failure at all."""
    root = np.array([[2.4]])
    wild = Explained(
        "wild", 0.5, ("wild",), (Component(1.0, ("v",), (Term("y**3"),), np.array([-0.8]), root),), {"v": 0.02}
    )
    unsafe = replace(FAR, start={"y": 1.0, "v": 0.0}, duration=6.0, rows=61, name="unsafe")
    for seed in range(2):
        found = told(study, NOTHING, wild).next_experiment([unsafe, FAR], outcomes=64, seed=seed)
        assert found.chosen == (FAR,)
        assert found.table.set_index("candidate")["fails"]["unsafe"] > 0.01


def test_an_input_that_never_moved_has_no_range(study):
    still = replace(told(study, NOTHING, law("cubic", 0.5, "y**3", -0.8)), train=_without_motion(study.train))
    found = still.next_experiment([FAR], outcomes=8)
    assert found.table["reach"][0] == np.inf
    assert "F is elsewhere than in the data, where it never moved: extrapolation" in found.sentence


def _without_motion(data):
    return replace(data, inputs={name: 0.0 * u for name, u in data.inputs.items()})


def test_a_term_that_stands_twice_in_an_explanation_counts_twice(study):
    twice = Component(1.0, ("v", "v"), (Term("y"), Term("y")), np.array([-1.0, -2.0]), np.zeros((1, 2)))
    once = Component(1.0, ("v",), (Term("y"),), np.array([-3.0]), np.zeros((1, 1)))
    every = [Explained(name, 0.5, (name,), (c,), {"v": 0.02}) for name, c in (("twice", twice), ("once", once))]
    assert abs(told(study, *every).next_experiment([FAR], outcomes=8).information.bits) < 1e-9


@pytest.mark.parametrize("wrong", [{"duration": 0.0}, {"duration": float("nan")}, {"amplitudes": 1.0}])
def test_settings_of_default_candidates_are_refused_in_a_sentence(study, wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        usual_candidates(study.train, {"v": 0.02}, **wrong)


def test_rows_that_come_in_bursts_give_no_more_rows_than_the_data_have(study):
    time = np.concatenate([start + 1e-4 * np.arange(5) for start in np.linspace(0, 8, 20)])
    kinds = (study.train.states, study.train.inputs)
    states, inputs = ({name: np.resize(x, 100) for name, x in kind.items()} for kind in kinds)
    burst = bg.Trajectories.from_arrays(time, states=states, inputs=inputs)
    assert all(each.rows <= 101 for each in usual_candidates(burst, {"v": 0.02}))


@pytest.mark.parametrize("signal", [Noise(2.0, 5.0, seed=2), Multisine(2.0, 0.11, 1.0)])
def test_an_amplitude_is_never_exceeded(signal):
    u = signal.value(np.linspace(0, 2000, 200_001))
    assert 1.9 < np.max(np.abs(u)) <= 2.0


def test_a_threshold_that_nothing_reaches_is_named(study):
    found = told(study, NOTHING, law("cubic", 0.5, "y**3", -0.8)).next_experiment([FAR], outcomes=16, threshold=1.5)
    assert not found.chosen
    assert found.sentence.startswith("No candidate is worth the threshold of 1.5 bits")


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
