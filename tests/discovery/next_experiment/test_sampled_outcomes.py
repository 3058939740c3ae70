"""Predictions of samples: densities that are exact where paths are linear, and paths with hidden states."""

import numpy as np
from scipy.integrate import solve_ivp

import bayes_greybox as bg
from bayes_greybox.discovery.next_experiment.candidates import Candidate
from bayes_greybox.discovery.next_experiment.explained import Component, Explained
from bayes_greybox.discovery.next_experiment.predicted import predict
from bayes_greybox.discovery.next_experiment.question import Question
from bayes_greybox.discovery.next_experiment.signals import Hold
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.simulation.reading import simulation_of
from bayes_greybox.physics.terms import Term


def question(term: Term, laws: list[tuple[float, float]], outcomes: int, rates: bool = False) -> Question:
    """Of x' = −x + c term, and what is thought of c: mean and standard deviation under each explanation."""
    t = np.linspace(0, 1, 11)
    data = bg.Trajectories.from_arrays(t, states={"x": np.sin(t)}, inputs={"u": np.cos(t)}, derivatives={"x": t})
    each = [
        Explained(str(m), 0.5, (), (Component(1.0, ("x",), (term,), np.array([m]), np.array([[sd]])),))
        for m, sd in laws
    ]
    return Question(simulation_of({"x": "-x"}, ("x",), ("u",), ()), data, each, rates, outcomes, 0)


def test_density_ratios_of_simulated_outcomes_are_one_on_average():
    for rates in (True, False):
        asked = question(Term("u"), [(1.0, 0.3), (1.3, 0.5)], 4000, rates)
        # A response that is linear in c and in the start has exactly the density that is used.
        (found,) = predict(asked, [Candidate({"u": Hold(1.0)}, {"x": 0.2}, 2.0, 9, {"x": 0.4})])
        logs = np.stack([products.log_density() for products in found.products], axis=1)
        # E[p(y | other) / p(y | own)] = 1 under the explanation with the wider density; a false failure: 6e-5.
        ratio = np.exp(logs[found.truth == 1, 0] - logs[found.truth == 1, 1])
        assert abs(np.mean(ratio) - 1) < 4 * np.std(ratio) / np.sqrt(len(ratio))
        assert np.std(ratio) > 0.1


def test_paths_with_a_hidden_state_are_those_of_the_whole_system():
    lag = HiddenState("z", "(x - z)/0.5", "x", start="x")
    asked = question(Term("z", states=(lag,)), [(-2.0, 0.0), (-1.0, 0.0)], 2)
    candidate = Candidate({"u": Hold(0.0)}, {"x": 0.5}, 3.0, 31, {"x": 1e-9})
    (found,) = predict(asked, [candidate])
    for outcome, c in ((0, -2.0), (2, -1.0)):

        def rate(s: float, w: np.ndarray, c: float = c) -> list[float]:
            return [-w[0] + c * w[1], (w[0] - w[1]) / 0.5]

        exact = solve_ivp(rate, (0, 3), [0.5, 0.5], t_eval=candidate.times, rtol=1e-10, atol=1e-10).y[0]
        assert np.allclose(found.responses["x"][outcome], exact, atol=1e-4)
    assert found.resolved
    assert np.all(found.failed == 0)
