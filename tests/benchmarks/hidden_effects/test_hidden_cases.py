"""Which cases there are, and the data that they give."""

from collections import Counter

import numpy as np
import pandas as pd
import pytest
from hidden_cases import OBVIOUS, SILENT, made, without_effect

from bayes_greybox.running.errors import InputError
from benchmarks.hidden_effects.cases import (
    HIDDEN_FAMILIES,
    NOISE,
    RATIO_EDGES,
    HiddenCase,
    all_cases,
    ratio_density,
    subset,
)
from benchmarks.hidden_effects.generate import generate
from benchmarks.hidden_effects.solvers.oracle import candidates, nearest
from benchmarks.hidden_effects.systems.hidden import CATALOGUE, OFF_CATALOGUE
from benchmarks.hidden_effects.systems.hosts import HOSTS


def test_cases_follow_from_the_seed_alone():
    cases = all_cases()
    assert cases == all_cases()
    assert len({case.key for case in cases}) == len(cases) == 396
    counts = Counter(case.family for case in cases)
    assert set(counts) == set(HIDDEN_FAMILIES)
    assert min(counts["null"], counts["mis-calibrated"], counts["off-catalogue"]) >= 40
    assert counts["two effects"] >= 30
    other = all_cases(seed=1)
    assert not {case.seed for case in cases} & {case.seed for case in other}


@pytest.mark.parametrize("crossed", [False, True])
def test_every_effect_meets_two_hosts_and_all_noise_levels(crossed):
    cases = all_cases(crossed=crossed)
    for domain, effects in CATALOGUE.items():
        for slug in effects:
            own = [
                c for c in cases
                if c.family == "catalogue" and c.effects == (slug,) and HOSTS[c.host].domain == domain
            ]  # fmt: skip
            assert len({case.host for case in own}) == 2
            assert {case.noise for case in own} == set(NOISE)
            assert len(own) == (6 if crossed else 4)
            assert len({(case.host, case.noise) for case in own}) == len(own)


def test_hosts_can_show_what_is_hidden_in_them():
    for case in all_cases():
        domain = HOSTS[case.host].domain
        for slug in case.effects:
            known = OFF_CATALOGUE if case.family == "off-catalogue" else CATALOGUE
            assert known[domain][slug].fits(HOSTS[case.host]), case.key


@pytest.mark.slow
def test_no_host_has_its_hidden_effect_in_the_simulation():
    for case in all_cases():
        if case.family in ("catalogue", "two effects"):
            assert set(case.effects) <= set(candidates(without_effect(case.host))), case.key


def test_ratios_are_log_uniform_over_all_and_by_noise_level_as_stated():
    single = [case for case in all_cases() if case.family == "catalogue"]
    logs = np.sort([np.log(case.ratios[0] / RATIO_EDGES[0]) for case in single]) / np.log(100)
    # Largest distance from the uniform law; independent draws would exceed 0.1 once in fifty.
    assert np.max(np.abs(logs - (np.arange(len(logs)) + 0.5) / len(logs))) < 0.05
    points = np.linspace(*np.log([0.3, 30.0]), 200_001)
    for noise in NOISE:
        assert np.trapezoid(ratio_density(noise, points), points) == pytest.approx(1.0, abs=1e-4)
        assert max(case.ratios[0] * noise for case in single if case.noise == noise) <= 0.8 + 1e-12


def test_a_subset_keeps_the_mix():
    few = subset(all_cases(), 30)
    assert 28 <= len(few) <= 32
    assert {case.family for case in few} == set(HIDDEN_FAMILIES)
    assert {case.noise for case in few} == set(NOISE)
    assert {HOSTS[case.host].domain for case in few} == set(CATALOGUE)
    assert few == subset(all_cases(), 30)


def test_cases_of_ones_own_are_checked():
    with pytest.raises(InputError, match="no host 'moon'"):
        HiddenCase("null", "moon", (), (), 0.05, 0)
    with pytest.raises(InputError, match="no family"):
        HiddenCase("nil", "tank", (), (), 0.05, 0)
    with pytest.raises(InputError, match="needs roles"):
        generate(HiddenCase("catalogue", "tank", ("linear-inflow",), (3.0,), 0.05, 0))


def test_the_same_case_gives_the_same_data():
    first, second = generate(OBVIOUS), generate(OBVIOUS)
    pd.testing.assert_frame_equal(first.train.to_frame(), second.train.to_frame())
    pd.testing.assert_frame_equal(first.test.to_frame(), second.test.to_frame())
    # By their text: an effect without a nonlinear parameter has nan there, unlike itself in Python 3.13.
    assert repr(first.effects) == repr(second.effects)
    assert 300 <= first.train.n_obs <= 600


@pytest.mark.parametrize(
    ("host", "effects", "ratios", "noise"),
    [
        ("forced-oscillator", ("dead-zone",), (12.0,), 0.05),
        ("series-rlc", ("brush-drop",), (1.0,), 0.05),
        ("prey", ("holling-ii",), (3.0,), 0.2),
        ("free-oscillator", ("cubic-stiffness", "quadratic-drag"), (8.0, 3.0), 0.05),
    ],
)
def test_effects_come_out_at_the_wanted_size(host, effects, ratios, noise):
    family = "catalogue" if len(effects) == 1 else "two effects"
    data = generate(HiddenCase(family, host, effects, ratios, noise, 3))
    exact = data.exact["train"]
    rate = exact.rates[data.equation]
    assert data.sigma == pytest.approx(noise * np.sqrt(np.mean(rate**2)))
    for truth, value, ratio in zip(data.effects, exact.values, ratios, strict=True):
        assert np.sqrt(np.mean((truth.coefficient * value) ** 2)) / data.sigma == pytest.approx(ratio, rel=0.02)
    noise_found = data.train.derivatives[data.equation] - rate
    assert np.std(noise_found) == pytest.approx(data.sigma, rel=0.2)


def test_states_solve_the_equations_with_the_hidden_effect():
    data = made(OBVIOUS)
    n = data.host.samples
    for state in data.host.states:
        step = data.host.times[1]
        path, rate = data.exact["train"].columns[state][:n], data.exact["train"].rates[state][:n]
        # Fourth-order central differences.
        slope = (path[:-4] - 8 * path[1:-3] + 8 * path[3:-1] - path[4:]) / (12 * step)
        np.testing.assert_allclose(slope, rate[2:-2], atol=2e-3 * np.abs(rate).max())


def test_a_mis_calibrated_simulation_is_ten_per_cent_off_in_one_coefficient():
    data = generate(HiddenCase("mis-calibrated", "forced-oscillator", (), (), 0.05, 4))
    term, ratio = data.off
    given, true = data.given_rates["ydot"], data.true_rates["ydot"]
    assert {name: given[name] / true[name] for name in true if given[name] != true[name]} == {
        term: pytest.approx(1.0 + np.sign(given[term] / true[term] - 1.0) * 0.1)
    }
    assert np.sqrt(np.mean(data.gap() ** 2)) / data.sigma == pytest.approx(ratio)
    assert data.simulation["y"] == "ydot"


def test_the_closable_share_is_what_the_true_model_leaves():
    data = made(OBVIOUS)
    assert 0.98 < data.closable < 1.0
    assert made(SILENT).closable == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(data.gap(), data.effects[0].coefficient * data.train.states["y"] ** 3, atol=1e-12)


def test_off_catalogue_shapes_resemble_no_entry():
    data = generate(HiddenCase("off-catalogue", "free-oscillator", ("hysteresis",), (8.0,), 0.05, 5))
    assert nearest(data)[1] < 0.9
    assert nearest(made(OBVIOUS)) == ("cubic-stiffness", pytest.approx(1.0))
