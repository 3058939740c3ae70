"""Host systems and hidden effects, written a second time, and their paths."""

import numpy as np
import pytest

from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.physics.formula.expressions import evaluate, parse_expression
from benchmarks.hidden_effects.systems.hidden import ADDED, CATALOGUE
from benchmarks.hidden_effects.systems.hosts import HOSTS, formula, term_value
from benchmarks.hidden_effects.systems.ode import Acting, HostODE, LostError, paths


def columns_of(names, seed=0):
    rng = np.random.default_rng(seed)
    return {name: rng.uniform(0.1, 2.0, 50) * rng.choice([-1, 1], 50) for name in names}


@pytest.mark.parametrize("domain", CATALOGUE)
def test_effects_and_priors_are_those_of_the_catalogue(domain):
    # Rows of rates weigh no memory: those effects have a benchmark of their own.
    entries = {effect.slug: effect for effect in load_catalogue(domain) if not effect.hidden}
    twins = {**CATALOGUE[domain], **ADDED[domain]}
    assert set(twins) == set(entries) and len(twins) == len(CATALOGUE[domain]) + len(ADDED[domain])
    for slug, hidden in twins.items():
        entry = entries[slug]
        assert sorted(hidden.roles) == list(entry.roles)
        roles = columns_of(entry.roles)
        inner = {parameter.name: 0.7 for parameter in entry.inner}
        value = entry.bind({role: role for role in entry.roles}).term(inner).evaluate({**roles, "unused": np.ones(50)})
        ours = np.broadcast_to(hidden.value(roles, 0.7), 50)
        np.testing.assert_allclose(ours, np.broadcast_to(value, 50), rtol=1e-12, err_msg=slug)
        priors = [(parameter.of, parameter.low, parameter.high) for parameter in entry.inner]
        assert priors == ([] if hidden.inner is None else [(hidden.inner.role, hidden.inner.low, hidden.inner.high)])


@pytest.mark.parametrize("name", HOSTS)
def test_simulations_read_back_as_what_is_integrated(name):
    host = HOSTS[name]
    columns = {key: np.abs(value) for key, value in columns_of((*host.states, *host.inputs)).items()}
    for state, terms in host.rates.items():
        text = formula({term: value * np.pi for term, value in terms.items()})
        value = evaluate(parse_expression(text), columns)
        known = sum(np.pi * value * term_value(term, columns) for term, value in terms.items())
        np.testing.assert_allclose(np.broadcast_to(value, 50), np.broadcast_to(known, 50), rtol=1e-12)
        assert state in host.states


def test_a_position_is_recognisable_by_its_equation():
    assert formula(HOSTS["free-chain"].rates["y1"]) == "v1"
    assert formula({"F": 1.0, "y": -4.0}) == "F - 4.0*y"
    assert formula({"y": -0.5}) == "-0.5*y"


def test_rest_on_a_jump_is_refused_and_crossed_jumps_are_exact():
    host = HOSTS["free-oscillator"]
    friction = CATALOGUE["mechanical"]["coulomb-friction"]

    def path(coefficient):
        rates = {"y": {"ydot": 1.0}, "ydot": {"y": -4.0}}
        return paths(HostODE(host, rates, (Acting(friction, coefficient),)), np.array([[1.0, 0.0]]), None)

    # Without damping each half swing loses 2 c / k of its height.
    swing = path(-0.1)[0, 0]
    period = 2 * np.pi / 2.0
    after = np.interp(2 * period, host.times, swing)
    assert after == pytest.approx(1.0 - 4 * 2 * 0.1 / 4.0, abs=5e-3)
    with pytest.raises(LostError, match="sticks"):
        path(-1.0)
