"""What an effect without a name would show, against dense regression, and along paths."""

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tiny_equation import CUBE, tiny_evaluations

import bayes_greybox as bg
from bayes_greybox.discovery.next_experiment import explained as explained_module
from bayes_greybox.discovery.next_experiment import nameless as module
from bayes_greybox.discovery.next_experiment.candidates import Candidate
from bayes_greybox.discovery.next_experiment.explained import Component, Explained, _told, joined
from bayes_greybox.discovery.next_experiment.nameless import Features, nameless
from bayes_greybox.discovery.next_experiment.predicted import predict
from bayes_greybox.discovery.next_experiment.question import Question
from bayes_greybox.discovery.next_experiment.signals import Hold
from bayes_greybox.discovery.weighing.sets import LAWFUL, MEMORY, REST, Sets
from bayes_greybox.discovery.weighing.worlds import worlds
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.gp.kernels import KERNELS, log_spectral_density
from bayes_greybox.physics.simulation.reading import simulation_of
from bayes_greybox.physics.terms import Term


@pytest.mark.parametrize("dictionary", [None, {"x": ["sin(3*x)"]}], ids=["alone", "beside a term"])
def test_it_is_the_regression_on_columns_and_what_they_leave_of_the_features(dictionary, monkeypatch):
    monkeypatch.setattr(module, "LATENTS", 1000)
    monkeypatch.setattr(module, "VARIANCE", 1.0)
    monkeypatch.setattr(module, "SEEN", 0.0)
    given = {} if dictionary is None else {"dictionary": dictionary}
    known = tiny_evaluations([CUBE], lambda x: np.cos(2 * x), simulation=lambda t, x, u: [-x[0]], **given)
    statistics = known.statistics
    world = worlds(Sets(known, 1), {"x": statistics.rows.columns["x"]})[0]
    e = next(e for e in world.explanations if e.kind == REST and not e.columns)
    mode = known.integrated(()).mode
    monkeypatch.setattr(module, "_hyperparameters", lambda *_: (np.ones(1), mode[None]))
    (found,) = nameless(world, e)
    at = {"x": np.linspace(-1.2, 1.2, 7)}
    one = Component(1.0, ("x",) * len(found.terms), found.terms, found.mean, found.root, {"x": found.features})
    places, table = one.columns("x", at, (7,))
    assert places == list(range(len(found.mean)))

    hyper = statistics.prior.unpack(jnp.asarray(mode))
    S = np.exp(np.asarray(log_spectral_density(KERNELS[statistics.kernel], statistics.basis.frequency, *hyper[1:])))
    indices, sigma = known.indices(()), float(hyper.sigma)
    X, y = statistics.at_rows(indices), statistics.rows.target / statistics.target_scale
    psi = statistics.evaluate_features(statistics.rows.columns)
    B = np.linalg.lstsq(X, psi, rcond=None)[0]
    design = np.hstack([X, psi - X @ B])
    prior = np.concatenate([np.array([statistics.columns[i].sd for i in indices]) ** 2, S])
    covariance = np.linalg.inv(design.T @ design / sigma**2 + np.diag(1 / prior))
    there = statistics.evaluate(indices, at)
    new = np.hstack([there, statistics.evaluate_features(at) - there @ B]) * statistics.target_scale
    expected = new @ covariance @ design.T @ y / sigma**2
    np.testing.assert_allclose(table @ found.mean, expected, rtol=1e-6, atol=1e-6 * np.max(np.abs(expected)))
    variance = np.einsum("ij,jk,ik->i", new, covariance, new)
    np.testing.assert_allclose(np.sum((table @ found.root.T) ** 2, axis=1), variance, rtol=1e-6)
    assert np.isclose(found.sigma, sigma * statistics.target_scale)


def test_scales_stand_for_their_posterior(monkeypatch):
    monkeypatch.setattr(module, "DRAWN", 4000)
    monkeypatch.setattr(module, "SCALES", 4000)
    known = tiny_evaluations([CUBE], lambda x: np.cos(2 * x), simulation=lambda t, x, u: [-x[0]])
    world = worlds(Sets(known, 1), {"x": known.statistics.rows.columns["x"]})[0]
    e = next(e for e in world.explanations if e.kind == REST and not e.columns)
    weight, etas = module._hyperparameters(world, e)
    sides = [
        m + np.linspace(-5, 5, 21) * s
        for m, s in zip(known.integrated(()).mode, np.sqrt(np.diag(known.integrated(()).covariance)), strict=True)
    ]
    grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, len(sides))
    logs = known.evaluator.values(known.with_features(()), grid)
    density = np.exp(logs - np.max(logs))
    mean = density @ grid / np.sum(density)
    sd = np.sqrt(density @ (grid - mean) ** 2 / np.sum(density))
    # Half of 4000 draws count for a mean: four of its standard errors.
    np.testing.assert_allclose(weight @ etas, mean, atol=4 * np.max(sd) / np.sqrt(2000))
    np.testing.assert_allclose(np.sqrt(weight @ (etas - mean) ** 2), sd, rtol=0.15)


def resting(f: float, sd: float = 0.0) -> tuple[Features, Component]:
    """f of x alone: f cos(π (x + 2)/4), on [−2, 2]."""
    features = Features(("x",), np.zeros(1), np.ones(1), HilbertBasis(2.0, (3,)), np.array([1]))
    height = np.sqrt(2.0)
    return features, Component(1.0, (), (), np.array([f * height]), np.array([[sd * height]]), {"x": features})


def test_features_are_held_outside_their_domain_and_summed_as_they_are_evaluated():
    features = Features(
        ("x", "u"),
        np.array([0.3, -1.0]),
        np.array([2.0, 0.5]),
        HilbertBasis((2.0, 1.5), (4, 3)),
        np.array([0, 4, 7, 11]),
    )
    rng = np.random.default_rng(0)
    columns = {"x": 4 * rng.standard_normal((5, 2)), "u": rng.standard_normal((5, 2))}
    weights = rng.standard_normal((2, 4))
    psi = features.evaluate(columns)
    assert psi.shape == (5, 2, 4)
    summed = features.summed(columns, features.spread_out(weights))
    np.testing.assert_allclose(summed, np.einsum("cdf,df->cd", psi, weights), atol=1e-12)
    far = features.evaluate({"x": np.array([4.3, 99.0]), "u": np.array([-1.0, -1.0])})
    np.testing.assert_allclose(far[0], far[1])


def test_paths_and_densities_are_those_of_the_function():
    t = np.linspace(0, 1, 11)
    data = bg.Trajectories.from_arrays(t, states={"x": np.sin(t)}, inputs={"u": np.cos(t)}, derivatives={"x": t})
    named = Component(1.0, ("x",), (Term("u"),), np.array([1.0]), np.array([[0.2]]))
    each = [Explained("named", 0.5, (), (named,)), Explained("unknown", 0.5, (), (resting(0.8, 0.1)[1],))]
    asked = Question(simulation_of({"x": "-x"}, ("x",), ("u",), ()), data, each, True, 4000, 0)
    (found,) = predict(asked, [Candidate({"u": Hold(0.4)}, {"x": 0.5}, 2.0, 6, {"x": 0.3})])
    exact = solve_ivp(
        lambda s, x: -x + 0.8 * np.cos(np.pi * (x + 2) / 4), (0, 2), [0.5], t_eval=np.linspace(0, 2, 6), rtol=1e-9
    ).y[0]
    own = found.responses["x"][found.truth == 1]
    np.testing.assert_allclose(np.mean(own, axis=0), -exact + 0.8 * np.cos(np.pi * (exact + 2) / 4), atol=0.02)
    logs = np.stack([products.log_density() for products in found.products], axis=1)
    # E[p(y | other) / p(y | own)] = 1 along the paths of the wider one; a false failure: 6e-5.
    ratio = np.exp(logs[found.truth == 0, 1] - logs[found.truth == 0, 0])
    assert abs(np.mean(ratio) - 1) < 4 * np.std(ratio) / np.sqrt(len(ratio))


def test_what_is_left_out_of_it_is_small(monkeypatch):
    known = tiny_evaluations([CUBE], lambda x: np.cos(2 * x), simulation=lambda t, x, u: [-x[0]])
    world = worlds(Sets(known, 1), {"x": known.statistics.rows.columns["x"]})[0]
    e = next(e for e in world.explanations if e.kind == REST and not e.columns)
    at = {"x": np.linspace(-1.5, 1.5, 31)}

    def told():
        tables = [(one, one.features.evaluate(at)) for one in nameless(world, e)]
        return [(table @ one.mean, np.sum((table @ one.root.T) ** 2, axis=1)) for one, table in tables]

    short = told()
    for name, value in (("LATENTS", 1000), ("VARIANCE", 1.0), ("SEEN", 0.0)):
        monkeypatch.setattr(module, name, value)
    for (mean, variance), (whole, every) in zip(short, told(), strict=True):
        # A hundredth of the variance is left out, and of each feature.
        assert np.sum(variance) > 0.97 * np.sum(every)
        assert np.max(np.abs(mean - whole)) < 0.05 * np.sqrt(np.max(whole**2 + every))


def test_what_remembers_beside_it_is_looked_at_where_it_is_known():
    known = tiny_evaluations([CUBE], lambda x: np.cos(2 * x), simulation=lambda t, x, u: [-x[0]])
    statistics = known.statistics
    world = worlds(Sets(known, 1), {"x": statistics.rows.columns["x"]})[0]
    e = next(e for e in world.explanations if e.kind == REST and e.effects)
    (i,) = e.effects
    values = statistics.at_rows([i])[:, 0]
    statistics.columns[i] = replace(statistics.columns[i], term=Term("hidden"), values=values)
    assert all(one.terms[0].text == "hidden" for one in nameless(world, e))


@pytest.mark.parametrize("kind, predicted", [(REST, True), (LAWFUL, True), (MEMORY, False)])
def test_what_most_likely_remembers_is_not_predicted_as_a_function(kind, predicted, monkeypatch):
    parts = {REST: 1.0, LAWFUL: 2.0}
    monkeypatch.setattr(
        explained_module, "_components",
        lambda weighed, world, e: ([Component(1.0, (), (), np.array([parts[e.kind]]), np.zeros((0, 1)))], 0.1),
    )  # fmt: skip
    columns = [SimpleNamespace(called="a law")]
    world = SimpleNamespace(evaluations=SimpleNamespace(statistics=SimpleNamespace(columns=columns, equation="x")))
    weighed = SimpleNamespace(kind=lambda world, e: "unknown")

    def variant(kind):
        return SimpleNamespace(kind=kind, effects=(), suspects=(), memory=(0,) if kind != REST else ())

    items = [(world, variant(kind), 0.6), (world, variant(REST), 0.2)]
    told = _told("unknown", 0.8, weighed, items)
    assert bool(told.components) == predicted
    if predicted:
        # Two of a kind that differ in a value alone are one.
        expected = {1.0: 1.0} if kind == REST else {2.0: 0.75, 1.0: 0.25}
        assert {c.mean[0]: c.weight for c in told.components} == pytest.approx(expected)
        assert told.sigma == {"x": pytest.approx(0.1)}


def test_variants_that_differ_in_a_value_alone_weigh_what_they_do_together(monkeypatch):
    """A gap that is weighed at four values, beside a late sensor at one: each value alone is less likely than that."""
    monkeypatch.setattr(
        explained_module, "_components",
        lambda weighed, world, e: ([Component(1.0, (), (), np.array([float(e.effects[0])]), np.zeros((0, 1)))], 0.1),
    )  # fmt: skip
    columns = [SimpleNamespace(called="y in a gap") for _ in range(4)]
    world = SimpleNamespace(evaluations=SimpleNamespace(statistics=SimpleNamespace(columns=columns, equation="x")))

    def variant(value, suspects=()):
        return SimpleNamespace(kind="plain", effects=(value,), suspects=suspects, memory=())

    world.evaluations.name = lambda i: "dead-zone"
    items = [
        (world, variant(3, (9,)), 0.3),
        *((world, variant(value), p) for value, p in zip(range(4), (0.25, 0.2, 0.15, 0.1), strict=True)),
    ]
    told = _told("dead-zone", 0.9, SimpleNamespace(), items)
    # The likeliest value stands for all of them.
    assert {c.mean[0]: c.weight for c in told.components} == pytest.approx({0.0: 0.7, 3.0: 0.3})


def test_equations_without_terms_have_features_of_their_own():
    t = np.linspace(0, 1, 11)
    states = {"x": np.sin(t), "y": np.cos(t)}
    data = bg.Trajectories.from_arrays(t, states=states, derivatives={"x": t, "y": t})
    ((_, one), (_, two)) = resting(0.8, 0.1), resting(-0.5, 0.2)
    second = {"y": replace(two.features["x"], variables=("y",), kept=np.array([1, 2]))}
    two = replace(two, mean=np.array([-0.5, 0.3]), root=0.1 * np.eye(2), features=second)
    none = Component(1.0, (), (), np.zeros(0), np.zeros((0, 0)))
    each = joined({
        "x": [Explained("unknown", 0.6, (), (one,)), Explained("no gap", 0.4, (), (none,))],
        "y": [Explained("unknown", 1.0, (), (two,))],
    })  # fmt: skip
    asked = Question(simulation_of({"x": "-x", "y": "-y"}, ("x", "y"), (), ()), data, each, True, 200, 0)
    candidate = Candidate({}, {"x": 0.5, "y": 0.4}, 2.0, 6, {"x": 0.3, "y": 0.3})
    (found,) = predict(asked, [candidate])
    # What y shows hangs on nothing that x has: two standard errors of a mean of 200, twice.
    first, last = (np.mean(found.responses["y"][found.truth == k], axis=0) for k in (0, 1))
    np.testing.assert_allclose(first, last, atol=0.06)
    assert all(np.all(np.isfinite(products.log_density())) for products in found.products)


def test_equations_together_keep_the_order_of_coefficients():
    features, rest = resting(0.8, 0.1)
    term = Component(1.0, ("y",), (Term("y"),), np.array([3.0]), np.array([[0.5]]))
    (both,) = joined({"x": [Explained("unknown", 1.0, (), (rest,))], "y": [Explained("y", 1.0, (), (term,))]})
    (one,) = both.components
    assert one.equations == ("y",)
    np.testing.assert_allclose(one.mean, [3.0, *rest.mean])
    np.testing.assert_allclose(one.root, [[0.0, *rest.root[0]], [0.5, 0.0]])
    assert one.places("x") == ([], slice(1, 2))
    assert one.places("y") == ([0], slice(2, 2))


def test_a_study_predicts_what_is_unknown(study):
    (own,) = study.explanations.values()
    unknown = next(e for e in own if e.name == "unknown")
    assert 1 < len(unknown.components) <= explained_module.COMPONENTS
    assert np.isclose(sum(c.weight for c in unknown.components), 1)
    assert "Nothing is predicted under unknown" not in study.next_experiment(outcomes=8).sentence
