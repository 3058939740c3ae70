import json
from collections import Counter
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from bayes_greybox.benchmarks.hidden_effects import case_scores, peers, solve
from bayes_greybox.benchmarks.hidden_effects.cases import (
    FAMILIES,
    NOISE,
    RATIO_EDGES,
    Case,
    all_cases,
    ratio_density,
    subset,
)
from bayes_greybox.benchmarks.hidden_effects.generate import generate
from bayes_greybox.benchmarks.hidden_effects.hidden import CATALOGUE, JOINED, OFF_CATALOGUE
from bayes_greybox.benchmarks.hidden_effects.host_systems import HOSTS, formula, term_value
from bayes_greybox.benchmarks.hidden_effects.ode import HostODE, LostError
from bayes_greybox.benchmarks.hidden_effects.oracle import (
    NONE,
    candidates,
    effect_values,
    inner_nodes,
    log_evidence,
    nearest,
    posterior,
)
from bayes_greybox.benchmarks.hidden_effects.run import RESULTS, run
from bayes_greybox.benchmarks.hidden_effects.score import score
from bayes_greybox.data.errors import InputError
from bayes_greybox.physics.catalogue.effects import load_catalogue
from bayes_greybox.physics.expressions import evaluate, parse_expression

OBVIOUS = Case("catalogue", "forced-oscillator", ("cubic-stiffness",), (10.0,), 0.01, 1)
SILENT = Case("null", "tank", (), (), 0.05, 2)


@cache
def made(case):
    return generate(case)


def without_effect(host):
    return made(Case("null", host, (), (), 0.05, 0))


def columns_of(names, seed=0):
    rng = np.random.default_rng(seed)
    return {name: rng.uniform(0.1, 2.0, 50) * rng.choice([-1, 1], 50) for name in names}


# Hosts and hidden effects


@pytest.mark.parametrize("domain", CATALOGUE)
def test_effects_and_priors_are_those_of_the_catalogue(domain):
    entries = {effect.slug: effect for effect in load_catalogue(domain)}
    ours_too = {**CATALOGUE[domain], **JOINED[domain]}
    # What has joined is hidden before the catalogue has it, and never the other way round.
    assert set(CATALOGUE[domain]) <= set(entries) <= set(ours_too)
    for slug, entry in entries.items():
        hidden = ours_too[slug]
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


# Cases


def test_cases_follow_from_the_seed_alone():
    cases = all_cases()
    assert cases == all_cases()
    assert len({case.key for case in cases}) == len(cases) == 388
    counts = Counter(case.family for case in cases)
    assert set(counts) == set(FAMILIES)
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
    assert {case.family for case in few} == set(FAMILIES)
    assert {case.noise for case in few} == set(NOISE)
    assert {HOSTS[case.host].domain for case in few} == set(CATALOGUE)
    assert few == subset(all_cases(), 30)


def test_cases_of_ones_own_are_checked():
    with pytest.raises(InputError, match="no host 'moon'"):
        Case("null", "moon", (), (), 0.05, 0)
    with pytest.raises(InputError, match="no family"):
        Case("nil", "tank", (), (), 0.05, 0)
    with pytest.raises(InputError, match="needs roles"):
        generate(Case("catalogue", "tank", ("linear-inflow",), (3.0,), 0.05, 0))


# Data


def test_the_same_case_gives_the_same_data():
    first, second = generate(OBVIOUS), generate(OBVIOUS)
    pd.testing.assert_frame_equal(first.train.to_frame(), second.train.to_frame())
    pd.testing.assert_frame_equal(first.test.to_frame(), second.test.to_frame())
    # By their text: an effect without an inner parameter has nan there, which Python 3.13 holds different from itself.
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
    data = generate(Case(family, host, effects, ratios, noise, 3))
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


def test_rest_on_a_jump_is_refused_and_crossed_jumps_are_exact():
    from bayes_greybox.benchmarks.hidden_effects.ode import Acting, paths

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


def test_a_mis_calibrated_simulation_is_ten_per_cent_off_in_one_coefficient():
    data = generate(Case("mis-calibrated", "forced-oscillator", (), (), 0.05, 4))
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
    data = generate(Case("off-catalogue", "free-oscillator", ("hysteresis",), (8.0,), 0.05, 5))
    assert nearest(data)[1] < 0.9
    assert nearest(made(OBVIOUS)) == ("cubic-stiffness", pytest.approx(1.0))


# Oracle


def with_residual(data, residual):
    train = replace(data.train, derivatives={data.equation: data.exact["train"].known + residual})
    return replace(data, train=train)


def test_the_oracle_is_right_on_the_obvious_and_silent_on_nothing():
    found = posterior(made(OBVIOUS))
    assert next(iter(found)) == "cubic-stiffness" and found["cubic-stiffness"] > 0.99
    assert sum(found.values()) == pytest.approx(1.0)
    # The simulation has these, so they are no hypotheses.
    assert not {"linear-stiffness", "viscous-damping", "input-gain"} & set(found)
    assert next(iter(posterior(made(SILENT)))) == NONE


def test_the_oracles_integrals_are_exact():
    data = without_effect("forced-oscillator")
    rng = np.random.default_rng(0)
    for slug in ("quadratic-drag", "dead-zone"):
        effect = CATALOGUE["mechanical"][slug]
        nodes = inner_nodes(data, effect, 1 if effect.inner is None else 400)
        values = effect_values(data, effect, nodes)
        shape = values / np.sqrt(np.mean(values**2, axis=1, keepdims=True))
        residual = data.sigma * (0.4 * shape[len(shape) // 2] + rng.standard_normal(shape.shape[1]))
        log_ratio = np.linspace(*np.log([0.3, 30.0]), 20_001)
        r, density = np.exp(log_ratio), ratio_density(0.05, log_ratio)
        totals = []
        for b in shape @ residual / data.sigma:
            likelihood = sum(np.exp(s * r * b - r**2 * shape.shape[1] / 2) for s in (-1, 1)) / 2
            totals.append(np.trapezoid(density * likelihood, log_ratio))
        # The nodes are even in the logarithm, and so is the prior.
        brute = totals[0] if len(totals) == 1 else np.trapezoid(totals, dx=1 / (len(totals) - 1))
        assert log_evidence(with_residual(data, residual), effect) == pytest.approx(np.log(brute), abs=2e-3)


def test_the_oracle_beats_the_best_fit():
    data = without_effect("rl")
    effects = {slug: e for slug, e in candidates(data).items() if e.inner is None}
    shapes = {slug: effect_values(data, e, np.array([np.nan]))[0] for slug, e in effects.items()}
    shapes = {slug: shape / np.sqrt(np.mean(shape**2)) for slug, shape in shapes.items()}
    rng = np.random.default_rng(1)
    right = {"oracle": 0, "best fit": 0}
    for _ in range(40):
        truth = str(rng.choice([*shapes, NONE]))
        size = 0.0 if truth == NONE else np.exp(rng.uniform(np.log(0.3), 0.0)) * rng.choice([-1, 1])
        noise = rng.standard_normal(data.train.n_obs)
        residual = data.sigma * (size * shapes.get(truth, 0.0) + noise)
        found = posterior(with_residual(data, residual))
        fits = {slug: abs(shape @ residual) for slug, shape in shapes.items()}
        right["oracle"] += next(iter(found)) == truth
        right["best fit"] += max(fits, key=fits.get) == truth
    assert right["oracle"] >= right["best fit"]
    assert right["oracle"] >= 30


# PySINDy


def thresholded(columns, target, threshold):
    """Hard-thresholded least squares, in two passes."""
    kept = np.ones(columns.shape[1], bool)
    coefficients = np.zeros(columns.shape[1])
    for _ in range(5):
        coefficients = np.zeros(columns.shape[1])
        if kept.any():
            coefficients[kept] = np.linalg.lstsq(columns[:, kept], target, rcond=None)[0]
        kept = np.abs(coefficients) >= threshold
    return coefficients * kept


def test_the_threshold_is_chosen_by_blocks_and_may_drop_all():
    rng = np.random.default_rng(2)
    columns = rng.standard_normal((300, 6))
    target = columns[:, 2] + 0.3 * rng.standard_normal(300)
    target = target / np.sqrt(np.mean(target**2))
    threshold = peers.choose_threshold(thresholded, columns, target)
    assert np.flatnonzero(thresholded(columns, target, threshold)).tolist() == [2]
    threshold = peers.choose_threshold(thresholded, columns, rng.standard_normal(300))
    assert not thresholded(columns, target, threshold).any()


def test_the_peers_get_the_same_terms():
    data = made(OBVIOUS)
    book = peers.candidate_terms(data)
    assert book.slugs[:3] == ("", "", "")
    assert set(book.slugs) - {""} == set(candidates(data))
    assert book.slugs.count("dead-zone") == peers.INNER_COLUMNS
    np.testing.assert_allclose(np.mean(book.columns**2, axis=0), 1.0)


def test_a_missing_pysindy_is_said_so(monkeypatch):
    def absent(name):
        raise ImportError(name)

    monkeypatch.setattr(peers.importlib, "import_module", absent)
    assert not peers.available()
    with pytest.raises(InputError, match="bayes-greybox\\[peers\\]"):
        peers.sindy(made(OBVIOUS))


@pytest.mark.skipif(not peers.available(), reason="PySINDy is not installed; it comes with the extra [peers]")
def test_pysindy_names_the_obvious_and_the_generator_stays_as_it_was():
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    assert peers.sindy(made(OBVIOUS))["names"][:1] == ["cubic-stiffness"]
    found = peers.sindy(made(OBVIOUS), ensemble=True)
    assert found == peers.sindy(made(OBVIOUS), ensemble=True)
    np.testing.assert_array_equal(before, np.random.get_state()[1])  # noqa: NPY002
    assert peers.sindy(made(SILENT))["verdict"] == "no gap"


# Scores


def effect(slug, probability=0.99, mean=1.0, sd=0.1, status="added", tied_with=()):
    interval = {"lower": mean - 1.645 * sd, "upper": mean + 1.645 * sd}
    own = {"slug": slug, "probability": probability, "mean": mean, "sd": sd, **interval}
    return {**own, "status": status, "tied_with": list(tied_with)}


def row(family="catalogue", truth=("a",), verdict="named", effects=(), oracle=None, ratio=5.0, **more):
    about = {"key": f"{family}{np.random.default_rng(len(more)).integers(99)}", "domain": "mechanical", "host": "tank"}
    hidden = [{"slug": s, "coefficient": 1.0, "inner": None, "ratio": ratio, "wanted": ratio} for s in truth]
    study = {"verdict": verdict, "effects": list(effects), "closed": {"derivative NMSE": 0.9}, "seconds": 2.0}
    about |= {"family": family, "noise": 0.05, "effects": list(truth), "ratios": [ratio] * len(truth), "truth": hidden}
    return {**about, "off": None, "closable": 0.9, "study": study, "oracle": oracle, **more}


@pytest.mark.parametrize(
    ("family", "truth", "verdict", "names", "right"),
    [
        ("catalogue", ("a",), "named", ["a"], True),
        ("catalogue", ("a",), "named", ["a", "b"], True),
        ("catalogue", ("a",), "named", ["b", "a"], False),
        ("catalogue", ("a",), "unknown", [], False),
        ("null", (), "no gap", [], True),
        ("null", (), "recalibrate", [], False),
        ("mis-calibrated", (), "recalibrate", [], True),
        ("off-catalogue", ("x",), "partly named", ["a"], True),
        ("off-catalogue", ("x",), "named", ["a"], False),
        ("off-catalogue", ("x",), "failed", [], False),
        ("two effects", ("a", "b"), "partly named", ["b", "c", "a"], True),
        ("two effects", ("a", "b"), "named", ["a"], False),
    ],
)
def test_what_counts_as_right(family, truth, verdict, names, right):
    assert case_scores.is_right(family, truth, verdict, names) is right


def test_scores_of_rows_made_by_hand():
    rows = [
        row(
            effects=[effect("a", mean=1.05)], oracle={"a": 0.99, "none": 0.01}, stlsq={"verdict": "named", "names": []}
        ),
        row(effects=[effect("b", 0.6, mean=1.5)], oracle={"b": 0.7, "a": 0.3}, ratio=0.5),
        row("null", (), "no gap", oracle={"none": 1.0}),
        row("two effects", ("a", "b"), effects=[effect("a", mean=1.3), effect("b", mean=1.17)]),
        row("off-catalogue", ("x",), "partly named", [effect("c", 0.5)]),
    ]
    scores = score(rows)
    assert scores.families.loc["catalogue", ["cases", "study", "oracle", "stlsq"]].tolist() == [2, 0.5, 0.5, 0.0]
    assert scores.families.loc["catalogue", ["exact", "stlsq exact"]].tolist() == [0.5, 0.0]
    assert scores.families.loc["off-catalogue", "exact"] == 1.0
    assert scores.families.loc["catalogue", "closed"] == pytest.approx(1.0)
    assert scores.families.loc["all", "study"] == pytest.approx(0.8)
    assert np.isnan(scores.families.loc["all", "oracle"])
    assert scores.ratios["cases"].tolist() == [1, 0, 1, 0]
    assert scores.verdicts.loc["off-catalogue", "partly named"] == 1.0
    # True coefficients are 1: of the three found, 1.05 ± 0.1 holds it, 1.3 ± 0.1 and 1.17 ± 0.1 do not.
    assert scores.coverage.loc["all"].tolist() == pytest.approx([3, 1 / 3, 1 / 3])
    assert scores.bars.loc["nulls kept silent", "holds"]
    assert scores.bars.loc["accuracy less the oracle's, all sizes", "holds"] is not None
    json.dumps(json.loads(scores.cases.to_json()))
    # No name was stated, so there is no error of their probabilities to judge.
    bars = score([row("null", (), "no gap", oracle={"none": 1.0})]).bars
    silent = bars.loc["expected calibration error of stated names"]
    assert np.isnan(silent["reached"]) and silent["holds"] is None


def test_calibration_error_by_hand():
    probability = np.array([0.95, 0.95, 0.95, 0.95, 0.65, 0.65])
    right = np.array([True, True, True, False, True, False])
    curve = case_scores.reliability_curve(probability, right)
    assert curve["ece"].sum() == pytest.approx(4 / 6 * abs(0.75 - 0.95) + 2 / 6 * abs(0.5 - 0.65))
    assert curve["cases"].sum() == 6
    assert case_scores.reliability_curve(np.array([]), np.array([], bool))["ece"].sum() == 0.0


@pytest.mark.parametrize(
    ("tied", "oracle", "excused"),
    [
        (("a",), {"b": 0.6, "a": 0.4}, True),
        (("a",), {"a": 0.99, "b": 0.01}, False),
        (("c", "d"), {"b": 0.6, "a": 0.4}, False),
        (("a", "c", "d"), {"b": 0.6, "a": 0.4}, False),
    ],
)
def test_a_tie_excuses_only_what_the_oracle_cannot_separate(tied, oracle, excused):
    found = case_scores.case_scores(row(effects=[effect("b", tied_with=tied)], oracle=oracle))
    assert found["study"] is False
    assert found["right or tied"] is excused


def test_overlap_of_regions():
    found, true = np.array([1, 1, 0, 0], bool), np.array([0, 1, 1, 0], bool)
    assert solve.overlap(found, true)["iou"] == pytest.approx(1 / 3)
    assert solve.overlap(found & False, true & False)["iou"] is None


def test_roles_leave_nothing_to_guess():
    roles = solve.all_roles(made(OBVIOUS))
    assert roles["position"] == "y" and roles["input"] == "F"
    assert roles["other_position"] == ()


def test_a_study_is_recorded_in_plain_values():
    data = made(OBVIOUS)
    table = pd.DataFrame(
        [{**effect("cubic-stiffness"), "equation": "ydot"}, {**effect("b", status=""), "equation": "z"}]
    )
    index = pd.MultiIndex.from_tuples([("ydot", "no gap"), ("ydot", "unknown")])
    gaps = pd.DataFrame(
        [("test", "derivative NMSE", "ydot", 1.0, 0.1), ("test", "free-run NRMSE", "y", np.nan, np.nan)],
        columns=["data", "metric", "variable", "before", "after"],
    )
    study = SimpleNamespace(
        verdict="named",
        effects=table,
        hypotheses=pd.DataFrame({"probability": [0.01, 0.02]}, index=index),
        ties=[{"equation": "ydot", "slugs": ("a", "b"), "advice": ""}],
        gap=gaps.set_index(["data", "metric", "variable"]),
        traces={"ydot": SimpleNamespace(probability=(np.abs(data.gap()) > data.sigma).astype(float))},
    )
    found = solve.record(study, data)
    json.dumps(found, allow_nan=False)
    assert [entry["slug"] for entry in found["effects"]] == ["cubic-stiffness"]
    assert found["closed"]["derivative NMSE"] == pytest.approx(0.9)
    assert found["overlap"]["iou"] == 1.0
    assert found["ties"] == [["a", "b"]]


# The runner


def knows_all(data):
    """A solver that peeks."""
    verdict = {"null": "no gap", "mis-calibrated": "recalibrate", "off-catalogue": "unknown"}.get(data.case.family)
    effects = [effect(t.slug, mean=t.coefficient, sd=abs(t.coefficient) / 100) for t in data.effects]
    return {"verdict": verdict or "named", "effects": [] if verdict else effects, "seconds": 0.1}


SIMPLE = Case("catalogue", "rl", ("cubic-resistor",), (2.0,), 0.05, 1)
FEW = (SIMPLE, SILENT, Case("mis-calibrated", "rc", (), (), 0.05, 4))


def test_a_stopped_run_goes_on(tmp_path):
    calls = []

    def fails_once(data):
        calls.append(data.case.key)
        if data.case == SILENT and calls.count(data.case.key) == 1:
            raise RuntimeError("no luck")
        return knows_all(data)

    def go():
        return run(tmp_path, FEW, solve=fails_once, workers=1, peers=False, progress=False)

    scores = go()
    assert len(calls) == 3
    assert scores.families.loc["null", "study"] == 0.0
    file = tmp_path / RESULTS
    assert "no luck" in json.loads(file.read_text().splitlines()[1])["error"]

    # Only what failed is run again, and a line that was cut off while it was written.
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:2], lines[2][:40]]))
    scores = go()
    assert Counter(calls) == {SIMPLE.key: 1, SILENT.key: 2, FEW[2].key: 2}
    assert scores.families.loc["all", "study"] == 1.0
    go()
    assert len(calls) == 5
    assert all(json.loads(line) for line in file.read_text().splitlines())

    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["cases"] == 3
    assert {entry["family"] for entry in summary["families"]} >= {"catalogue", "null", "all"}
    assert len(pd.read_csv(tmp_path / "cases.csv")) == 3


def test_results_of_another_version_are_not_mixed_in(tmp_path):
    run(tmp_path, FEW[1:2], solve=knows_all, workers=1, peers=False, progress=False)
    file = tmp_path / RESULTS
    file.write_text(json.dumps({**json.loads(file.read_text()), "version": "0.0.0"}) + "\n")
    calls = []
    run(tmp_path, FEW[1:2], solve=lambda d: calls.append(1) or knows_all(d), workers=1, peers=False, progress=False)
    assert calls == [1]


def test_two_workers(tmp_path):
    scores = run(tmp_path, FEW[:2], solve=knows_all, workers=2, peers=False, progress=False)
    assert scores.families.loc["all", "study"] == 1.0


def test_bad_settings_are_refused(tmp_path):
    with pytest.raises(InputError, match="at least one case"):
        run(tmp_path, (), solve=knows_all)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="Cannot write"):
        run(tmp_path / "file", FEW, solve=knows_all)
