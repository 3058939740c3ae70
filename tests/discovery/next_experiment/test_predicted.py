"""Predictions of candidates against closed forms, along paths with hidden states, and what they rank first."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bayes_greybox as bg
from bayes_greybox.discovery.answer.explained import Component, Explained
from bayes_greybox.discovery.next_experiment.predicted import Predictor, information
from bayes_greybox.discovery.next_experiment.ranked import Candidate
from bayes_greybox.physics.experiments.signals import Hold
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.simulation.reading import simulation_of
from bayes_greybox.physics.terms import Term


def predictor(*laws: tuple[Term, float, float], rates: bool = False) -> Predictor:
    """Of x' = −x + c term: a term, and the mean and standard deviation of c under each explanation."""
    t = np.linspace(0, 1, 11)
    data = bg.Trajectories.from_arrays(t, states={"x": np.sin(t)}, inputs={"u": np.cos(t)}, derivatives={"x": t})
    each = [
        Explained(str(m), 1 / len(laws), (), (Component(1.0, ("x",), (term,), np.array([mean]), np.array([[sd]])),))
        for m, (term, mean, sd) in enumerate(laws)
    ]
    return Predictor(each, simulation_of({"x": "-x"}, ("x",), ("u",), ()), data, rates, 64, 0)


def candidate(u: float = 1.0, x: float = 0.2, sd: float = 0.4) -> Candidate:
    return Candidate({"u": Hold(u)}, {"x": x}, 2.0, 9, {"x": sd})


def test_samples_of_a_linear_law_are_predicted_by_their_closed_form():
    """x = x₀ e⁻ᵗ + c u (1 − e⁻ᵗ): the posterior of c and the start's noise are the rows of A."""
    (found,) = predictor((Term("u"), 1.0, 0.3), (Term("u"), 1.3, 0.5)).predict([candidate(u=2.0)])
    decay = np.exp(-candidate().times)
    for (own, *_), mean, sd in ((found.predictions[0], 1.0, 0.3), (found.predictions[0][1:], 1.3, 0.5)):
        np.testing.assert_allclose(own.mean, (0.2 * decay + mean * 2 * (1 - decay)) / 0.4, atol=1e-4)
        np.testing.assert_allclose(own.load, [sd * 2 * (1 - decay) / 0.4], atol=1e-3)
        np.testing.assert_allclose(own.start, [decay], atol=1e-3)
    assert found.resolved


def test_rates_are_predicted_along_the_path_of_each():
    (found,) = predictor((Term("u"), 1.0, 0.3), (Term("x"), -0.5, 0.2), rates=True).predict([candidate()])
    for along, path in zip(found.predictions, ([1, 1.0], [-0.5, 0.0]), strict=True):
        x = (0.2 - 1) * np.exp(-candidate().times) + 1 if path[1] else 0.2 * np.exp(-1.5 * candidate().times)
        np.testing.assert_allclose(along[0].mean, (1.0 - x) / 0.4, atol=1e-3)
        np.testing.assert_allclose(along[1].mean, -1.5 * x / 0.4, atol=1e-3)
        np.testing.assert_allclose(along[1].load, [0.2 * x / 0.4], atol=1e-3)
        assert not np.any(along[1].start)


def test_paths_with_a_hidden_state_are_those_of_the_whole_system():
    lag = HiddenState("z", "(x - z)/0.5", "x", start="x")
    term = Term("z", states=(lag,))
    (found,) = predictor((term, -2.0, 0.0), (Term("u"), 0.5, 0.0), (term, -1.0, 0.0)).predict(
        [candidate(u=0.0, x=0.5, sd=1e-4)]
    )
    for place, c in ((0, -2.0), (2, -1.0)):

        def rate(s: float, w: np.ndarray, c: float = c) -> list[float]:
            return [-w[0] + c * w[1], (w[0] - w[1]) / 0.5]

        exact = solve_ivp(rate, (0, 2), [0.5, 0.5], t_eval=candidate().times, rtol=1e-10, atol=1e-10).y[0]
        np.testing.assert_allclose(found.predictions[0][place].mean * 1e-4, exact, atol=1e-3)
    assert found.fails == 0


@pytest.mark.parametrize("rates", [True, False])
def test_where_the_laws_agree_least_is_told(rates):
    """u and u³ are one for inputs of 0 and 1: only an input beyond tells them apart."""
    asked = predictor((Term("u"), 1.0, 0.1), (Term("u**3"), 1.0, 0.1), rates=rates)
    found = asked.predict([candidate(u) for u in (0.0, 1.0, 1.6)])
    bits = [information(each.predictions, asked.probability) for each in found]
    assert bits[0] == pytest.approx(0.0, abs=1e-9)
    assert bits[1] == pytest.approx(0.0, abs=1e-9)
    assert 0.2 < bits[2] <= 1.0


@pytest.mark.slow
def test_the_same_seed_gives_the_same(study):
    one, two, other = (study.next_experiment(seed=seed, rows=11) for seed in (0, 0, 1))
    assert one.sentence == two.sentence
    assert one.table.equals(two.table)
    # Draws are for bands and failures: the information is a closed form.
    assert dict(zip(one.table["candidate"], one.table["information"], strict=True)) == pytest.approx(
        dict(zip(other.table["candidate"], other.table["information"], strict=True))
    )
