"""The oracle and PySINDy's weak form on samples of a displacement."""

import numpy as np
import pytest

from benchmarks.hidden_effects.generate import generate
from benchmarks.hidden_effects.solvers import displacement_oracle, displacement_peers
from benchmarks.hidden_effects.solvers.displacement import displacement, displacement_cases
from benchmarks.hidden_effects.solvers.displacement_oracle import _nudged, _responses, seen
from benchmarks.hidden_effects.solvers.oracle import NONE, candidates, inner_nodes
from benchmarks.hidden_effects.systems.ode import Acting, HostODE, paths


def data_of(slug, host="free-oscillator", seed=0):
    effects = (slug,) if slug else ()
    return generate(next(c for c in displacement_cases(seed) if c.effects == effects and c.host == host))


@pytest.fixture(scope="module")
def cubic():
    return data_of("cubic-stiffness")


@pytest.fixture
def few(monkeypatch):
    """Some candidates for the oracle to choose from, of every kind, and few nodes; each costs it an integration."""
    names = {"cubic-stiffness", "quintic-stiffness", "dead-zone", "quadratic-drag", "coulomb-friction"}
    kept = lambda data: {slug: effect for slug, effect in candidates(data).items() if slug in names}  # noqa: E731
    monkeypatch.setattr(displacement_oracle, "candidates", kept)
    monkeypatch.setattr(displacement_oracle, "NODES", 4)


def position(data, acting):
    ode = HostODE(data.ode.host, data.ode.rates, acting)
    row = list(ode.rates).index(data.host.roles["position"])
    return paths(ode, data.excited["train"].starts, data.excited["train"].signal)[:, row].ravel()


def some(data, count=3):
    found = candidates(data)
    return [
        Acting(found[slug], 1e-3, float(inner_nodes(data, found[slug], 3)[0]))
        for slug in ("quadratic-drag", "dead-zone", "cubic-damping")[:count]
    ]


def test_copies_side_by_side_move_as_each_alone(cubic):
    nudges = some(cubic)
    together = _nudged(cubic, nudges)
    for k, nudge in enumerate(nudges):
        np.testing.assert_allclose(together[:, k], position(cubic, (*cubic.ode.acting, nudge)), rtol=0, atol=1e-6)


def test_a_response_is_the_change_of_the_position_by_a_coefficient(cubic):
    (act,) = cubic.ode.acting
    response = _responses(cubic, [act])[:, 0]
    h = 1e-5 * abs(act.coefficient)
    up, down = (position(cubic, (Acting(act.effect, act.coefficient + s * h, act.inner),)) for s in (1, -1))
    np.testing.assert_allclose(response, (up - down) / (2 * h), rtol=1e-3, atol=1e-4 * np.std(response))


def test_what_can_be_seen_is_the_coefficient_over_its_standard_error(cubic, few):
    noise = 0.05
    samples, place = displacement(cubic, noise)[0], cubic.host.roles["position"]
    sigma = noise * np.std(cubic.train.states[place])
    found = seen(cubic, samples.states[place], sigma)
    (act,) = cubic.ode.acting
    X = np.column_stack([_responses(cubic, [act]), displacement_oracle._to_starts(cubic)]) / sigma
    error = np.sqrt(np.linalg.inv(X.T @ X)[0, 0])
    assert found["visible"] == pytest.approx(abs(act.coefficient) / error, rel=1e-6)
    assert sum(found["oracle"].values()) == pytest.approx(1.0)


@pytest.mark.slow
def test_a_loud_effect_is_named_and_silence_kept(few):
    for slug in ("cubic-stiffness", None):
        kept = displacement_oracle.ask(data_of(slug), 0.01)
        assert next(iter(kept["oracle"])) == (slug or NONE)
        assert np.isnan(kept["visible"]) == (slug is None)


def test_weak_columns_are_those_of_the_rate():
    pytest.importorskip("pysindy")
    t = np.linspace(0, 20, 401)
    values, rates = displacement_peers.weak(np.column_stack([np.cos(t), np.sin(t)]), t, 0)
    np.testing.assert_allclose(rates[:, 1], values[:, 0], atol=1e-6 * np.std(values[:, 0]))


def test_the_weak_form_names_a_loud_effect_and_starts_from_samples_alone(cubic):
    pytest.importorskip("pysindy")
    smooth = displacement_peers.smoothed(cubic, 0.01)
    place, speed = cubic.host.roles["position"], cubic.equation
    for name, close in ((place, 0.02), (speed, 0.05)):
        error = smooth.states[name] - cubic.train.states[name]
        assert 0 < np.std(error) < close * np.std(cubic.train.states[name])
    found = displacement_peers.ask(data_of("bilinear-stiffness", "swept-oscillator", 1), 0.05)
    assert set(found) == {"stlsq", "ensemble"} and found["stlsq"]["names"] == ["bilinear-stiffness"]
