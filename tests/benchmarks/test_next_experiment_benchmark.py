"""The benchmark of next experiments: its cases, what a machine does in an experiment, and how the ways are scored."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayes_greybox.discovery.answer.explained import Component, Explained
from bayes_greybox.discovery.next_experiment.ranked import Candidate
from bayes_greybox.physics.experiments.signals import Hold
from bayes_greybox.physics.terms import Term
from benchmarks.hidden_effects.generate import generate
from benchmarks.hidden_effects.systems.hidden import CATALOGUE
from benchmarks.next_experiment import run as module
from benchmarks.next_experiment.machines import (
    RATIOS,
    SMALL_GAP_NOISES,
    Driven,
    again,
    exact,
    joined,
    noise_of,
    record_of,
    small_gaps,
)
from benchmarks.next_experiment.optimal import encompassing, log_determinants
from benchmarks.next_experiment.run import NEXT_EXPERIMENT, measure
from benchmarks.next_experiment.scores import differences, ways
from benchmarks.runner import Asked, Case, perform


def case_of(host, effect, seed=0):
    return replace(small_gaps(seed)[0], host=host, effects=(effect,), ratios=(2.0,))


@pytest.fixture(scope="module")
def driven():
    """A forced oscillator with a cubic spring."""
    return generate(case_of("forced-oscillator", "cubic-stiffness"))


def test_every_effect_is_hidden_in_small_gaps_at_each_level_and_every_seed_has_its_own():
    cases = small_gaps(0)
    places = [(c.system.domain, c.effects, c.host) for c in cases]
    counts = {(c.noise, places.count(place)) for c, place in zip(cases, places, strict=True)}
    assert counts == {(noise, 2) for noise in SMALL_GAP_NOISES}
    assert {effect for domain, (effect,), _ in places if domain == "fluid"} == set(CATALOGUE["fluid"])
    assert all(RATIOS[0] <= c.ratios[0] <= RATIOS[1] for c in cases)
    assert small_gaps(0) == cases
    assert not {c.seed for c in small_gaps(1)} & {c.seed for c in cases}
    assert len({c.key for c in cases}) == len(cases)


@pytest.mark.parametrize("host, effect", [("free-oscillator", "coulomb-friction"), ("prey", "logistic-crowding")])
def test_the_same_again_is_the_record_without_its_noise(host, effect):
    data = generate(case_of(host, effect))
    found, n = exact(data, again(data)), data.host.samples
    for name, column in found.columns.items():
        np.testing.assert_allclose(column, data.exact["train"].columns[name][:n], rtol=1e-7, atol=1e-7)


def test_a_machine_does_in_an_experiment_what_its_equation_says(driven):
    signal, start = Hold(2.0), {"y": 0.5, "ydot": 0.0}
    found = exact(driven, Driven(start, {"F": signal.value}, 3.0, 31))
    (cubic,) = driven.effects
    own = driven.true_rates["ydot"]

    def rate(t, x):
        terms = own["F"] * 2.0 + own["y"] * x[0] + own["ydot"] * x[1] + cubic.coefficient * x[0] ** 3
        return [x[1], terms]

    path = solve_ivp(rate, (0, 3), [0.5, 0.0], t_eval=np.linspace(0, 3, 31), rtol=1e-10, atol=1e-10).y
    np.testing.assert_allclose(found.columns["y"], path[0], atol=1e-7)
    assert exact(driven, Driven({"y": 1e6, "ydot": 0.0}, {"F": Hold(1e9).value}, 3.0, 31)) is None


def test_a_further_run_comes_after_the_record_with_the_noise_of_the_level(driven):
    runs = exact(driven, again(driven))
    noise = noise_of(driven, 20_000)
    # The standard deviation's own is 0.5 %.
    assert np.std(noise["ydot"]) == pytest.approx(driven.sigma, rel=0.02)
    own = noise_of(driven, len(runs.known))
    data, record = joined(driven, [runs], {name: [e] for name, e in own.items()}), record_of(driven)
    assert data.n_run == 2
    np.testing.assert_array_equal(data.take(0).derivatives["ydot"], record.derivatives["ydot"])
    left = data.take(1).derivatives["ydot"] - runs.rates["ydot"]
    np.testing.assert_allclose(left, own["ydot"], atol=1e-12)


def law(name, p, **terms):
    n = len(terms)
    texts = [t.replace("_", "**") for t in terms]
    component = Component(1.0, ("ydot",) * n, tuple(map(Term, texts)), np.array([*terms.values()]), np.eye(n))
    return Explained(name, p, (name,), (component,), {"ydot": 0.1})


def test_the_model_of_all_explanations_has_each_term_once_at_its_mean():
    found = encompassing([law("one", 0.6, y=-1.0, y_3=-2.0), law("two", 0.2, y=-3.0), Explained("unknown", 0.2)])
    assert [str(term.expression) for term in found.terms] == ["y", "y**3"]
    np.testing.assert_allclose(found.mean, [0.75 * -1.0 + 0.25 * -3.0, 0.75 * -2.0])


def test_determinants_are_those_of_the_information_along_the_path_of_the_mean(driven):
    known = [law("one", 0.5, y=-0.4), law("two", 0.5, y_3=-0.2)]
    record, own = record_of(driven), driven.given_rates["ydot"]
    candidates = [
        Candidate({"F": Hold(u)}, {"y": y, "ydot": 0.0}, 4.0, 41, {"ydot": 0.1}) for u, y in ((0.0, 0.1), (3.0, 1.5))
    ]

    def expected(candidate):
        u = candidate.inputs["F"].level

        def rate(t, x):
            return [x[1], own["F"] * u + own["y"] * x[0] + own["ydot"] * x[1] - 0.2 * x[0] - 0.1 * x[0] ** 3]

        start = list(candidate.start.values())
        y = solve_ivp(rate, (0, 4), start, t_eval=candidate.times, rtol=1e-9, atol=1e-9).y[0]
        every = np.concatenate([record.states["y"], y])
        Phi = np.stack([every, every**3], axis=-1)
        return np.linalg.slogdet(Phi.T @ Phi)[1]

    found = log_determinants(driven, record, known, candidates)
    assert found[1] - found[0] == pytest.approx(expected(candidates[1]) - expected(candidates[0]), abs=1e-4)
    # A term that another one gives already changes nothing.
    twice = [*known, law("three", 1e-9, **{"2*y": 0.0})]
    again_ = log_determinants(driven, record, twice, candidates)
    assert again_[1] - again_[0] == pytest.approx(found[1] - found[0], abs=1e-4)


def answer(right, p, wrong=()):
    return {"right": right, "probability": p, "log": float(np.log(p)), "wrong": list(wrong)}


def tied(ours, other):
    return {"before": answer(False, 0.3), "ways": {"information": ours, "random": other}}


ROWS = [
    *(tied(answer(True, 0.95), answer(False, 0.5)) for _ in range(4)),
    tied(answer(True, 0.95), answer(True, 0.95)),
    tied(answer(False, 0.1, ["x"]), answer(True, 0.92)),
    {"before": answer(True, 0.99), "ways": {}},
]


def test_ways_are_scored_by_ties_alone():
    table = ways(ROWS)
    assert table["ties"].tolist() == [6, 6, 6]
    assert table["right"].tolist() == pytest.approx([0, 5 / 6, 2 / 6])
    assert table["wrong"].tolist() == [0, 1, 0]


def test_differences_are_of_the_same_ties_with_an_exact_test():
    table = differences(ROWS).loc["random"]
    right = table.loc["right"]
    assert right["difference"] == pytest.approx(0.5)
    assert (right["ours alone"], right["other alone"]) == (4, 1)
    # Of five, one or fewer or four or more: 12 of 32.
    assert right["p"] == pytest.approx(12 / 32)
    # The bootstrap's mean of six has the standard deviation 0.764 / √6.
    assert right["upper"] - right["lower"] == pytest.approx(2 * 1.96 * 0.764 / np.sqrt(6), rel=0.2)
    assert differences([]).empty


@pytest.mark.slow
def test_a_tie_is_told_apart_in_every_way_and_the_run_goes_on(tmp_path, monkeypatch):
    studied = []

    def only_some(study, data):
        return possible(study, data)[4:7]

    def counted(case):
        studied.append(case.key)
        return measure(case)

    possible = module.possible
    tank = next(c for c in small_gaps(0) if (c.host, c.noise) == ("draining-seeping-tank", 0.2))
    monkeypatch.setattr(module, "possible", only_some)

    def run():
        cases = [Case(tank.key, (tank,))]
        return perform(replace(NEXT_EXPERIMENT, run=counted), cases, Asked(tmp_path, progress=False)).values()

    table, against = run()
    assert list(table.index) == ["before", "information", "random", "D-optimal", "the same again"]
    assert table["ties"].tolist() == [1] * 5
    assert np.all(table["probability"] >= 0)
    assert len(against) == 9
    assert len(studied) == 1
    again_, _ = run()
    assert len(studied) == 1
    assert again_.equals(table)
