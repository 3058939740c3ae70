"""Who solves the cases: the oracle, PySINDy, and what is recorded of a study."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hidden_cases import OBVIOUS, SILENT, effect, made, without_effect

from bayes_greybox.running.errors import InputError
from benchmarks.hidden_effects.cases import ratio_density
from benchmarks.hidden_effects.solvers import peers, study
from benchmarks.hidden_effects.solvers.oracle import (
    NONE,
    candidates,
    effect_values,
    inner_nodes,
    log_evidence,
    posterior,
)
from benchmarks.hidden_effects.systems.hidden import CATALOGUE

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


# The study


def test_overlap_of_regions():
    found, true = np.array([1, 1, 0, 0], bool), np.array([0, 1, 1, 0], bool)
    assert study.overlap(found, true)["iou"] == pytest.approx(1 / 3)
    assert study.overlap(found & False, true & False)["iou"] is None


def test_roles_leave_nothing_to_guess():
    roles = study.all_roles(made(OBVIOUS))
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
    finished = SimpleNamespace(
        verdict="named",
        effects=table,
        hypotheses=pd.DataFrame({"probability": [0.01, 0.02]}, index=index),
        ties=[{"equation": "ydot", "slugs": ("a", "b"), "advice": ""}],
        gap=gaps.set_index(["data", "metric", "variable"]),
        traces={"ydot": SimpleNamespace(probability=(np.abs(data.gap()) > data.sigma).astype(float))},
    )
    found = study.record(finished, data)
    json.dumps(found, allow_nan=False)
    assert [entry["slug"] for entry in found["effects"]] == ["cubic-stiffness"]
    assert found["closed"]["derivative NMSE"] == pytest.approx(0.9)
    assert found["overlap"]["iou"] == 1.0
    sampled = finished.gap.rename({"derivative NMSE": "sample NMSE"}, level="metric")
    found = study.record(SimpleNamespace(**{**vars(finished), "gap": sampled}), data)
    assert found["closed"] == {"sample NMSE": pytest.approx(0.9), "free-run NRMSE": None}
    assert found["ties"] == [["a", "b"]]
