"""States that move as their rates say, and sensors that are bent, stick or forget."""

import numpy as np
import pytest
from scipy.stats import kstest
from tiny_equation import forced, soft, studied_motion

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.checks.adequacy import LEVEL
from bayes_greybox.discovery.answer.checks.motion import ModelledRate, check_motion
from bayes_greybox.discovery.suspects.late import AGREE, SAMPLES

STEP = 0.05


def moving(n=600, bend=lambda y: y, noise=0.0, seed=0, runs=1):
    """y = sin t + 0.4 cos 2.3 t as a sensor shows it, and its exact rate."""
    rng, times = np.random.default_rng(seed), [10 * k + STEP * np.arange(n) for k in range(runs)]
    y = [bend(np.sin(t) + 0.4 * np.cos(2.3 * t)) + noise * rng.standard_normal(n) for t in times]
    v = np.concatenate([np.cos(t) - 0.92 * np.sin(2.3 * t) for t in times])
    return Trajectories.from_arrays(times, states={"y": y}), v


def checked(data, v, noise=0.0, sd=0.0):
    (check,) = check_motion(data, {"y": ModelledRate(v, sd, "v")}, {"y": noise}, "s")
    return check


def test_sensors_that_agree_are_left_in_peace():
    check = checked(*moving(runs=3))
    assert check.ok and check.text == "" and check.name == "motion of y" and check.p > 0.99


def test_its_level_is_kept_under_noise_on_the_samples():
    noise = 0.2
    p = [checked(*moving(noise=noise, seed=seed), noise=noise).p for seed in range(200)]
    # Windows side by side share a sample, and sensors are allowed to differ: a little too quiet, never too loud.
    assert kstest(p, "uniform", alternative="greater").pvalue > 1e-3 and sum(q < LEVEL for q in p) <= 2


@pytest.mark.parametrize(
    "bend",
    [lambda y: y - 0.04 * y**3, lambda y: 1.05 * y, lambda y: np.round(y / 0.3) * 0.3],
    ids=["bent", "scaled", "coarse"],
)
def test_a_sensor_that_shows_something_else_is_found(bend):
    check = checked(*moving(bend=bend))
    assert not check.ok and check.p < 1e-9
    assert check.text.startswith("the samples of y do not move as v says: over 0.5 s they are ")


def test_a_force_for_a_moment_is_found():
    data, v = moving()
    v = v.copy()
    v[300 : 300 + SAMPLES] += 0.8
    assert not checked(data, v).ok


def test_what_is_uncertain_is_allowed_for():
    data, v = moving()
    assert not checked(data, v + 0.1).ok and checked(data, v + 0.1, sd=0.1).ok
    assert checked(data, v * (1 + AGREE / 2)).ok


@pytest.mark.slow
def test_what_coefficients_do_to_all_windows_at_once_is_one_error_and_not_many():
    """θ at two standard deviations from its mean, as it is once in twenty: no contradiction."""
    rng = np.random.default_rng(1)
    data, v = moving()
    draws = v * (1.1 + 0.05 * rng.standard_normal((400, 1)))
    uncertain = ModelledRate(draws.mean(axis=0), 0.0, "v", draws)
    (check,) = check_motion(data, {"y": uncertain}, {})
    assert check.ok and check.departure < 0.02 * check.span
    # A force that no coefficient is shows beside them as it is.
    pushed = v + 0.3 * (np.abs(data.time - 15) < 1)
    (check,) = check_motion(data, {"y": ModelledRate(pushed, 0.0, "v", pushed + draws - draws.mean(axis=0))}, {})
    assert not check.ok and check.p < 1e-9


@pytest.mark.slow
def test_the_level_is_kept_whatever_the_coefficients_turn_out_to_be():
    noise, p = 0.1, []
    for seed in range(200):
        data, v = moving(noise=noise, seed=seed)
        rng = np.random.default_rng(1000 + seed)
        # Coefficients that hold for the whole record, and a posterior that knows how well.
        off = 1.3 * rng.standard_normal() * v + 0.2 * rng.standard_normal() * np.cos(2.3 * data.time)
        apart = 1.3 * rng.standard_normal((400, 1)) * v + 0.2 * rng.standard_normal((400, 1)) * np.cos(2.3 * data.time)
        (check,) = check_motion(data, {"y": ModelledRate(v + off, 0.0, "v", v + off + apart)}, {"y": noise})
        p.append(check.p)
    assert kstest(p, "uniform", alternative="greater").pvalue > 1e-3 and sum(q < LEVEL for q in p) <= 2


def test_records_too_short_are_not_checked():
    data, v = moving(n=2 * SAMPLES + 1)
    assert check_motion(data, {"y": ModelledRate(v, 0.0, "v")}, {}) == []


@pytest.mark.slow
def test_a_study_whose_samples_contradict_each_other_names_nothing_outright():
    data = forced(soft, n=300)
    y = data.states["y"]
    bent = Trajectories.from_arrays(
        data.time, states={"y": y - 0.03 * y**3, "v": data.states["v"]}, inputs=dict(data.inputs),
        derivatives=dict(data.derivatives),
    )  # fmt: skip
    assert studied_motion(data).finding.verdict == "named"
    finding = studied_motion(bent).finding
    assert finding.verdict != "named" and any("do not move as v says" in text for text in finding.against)


def test_a_brake_for_a_moment_is_no_outlier():
    data = forced(n=400)
    # The rate shows it, and so does v; to the noise it is a few gross errors.
    extra = np.where((data.time > 15) & (data.time < 15.8), -1.0, 0.0)
    step = np.concatenate([[0.0], np.cumsum(extra[:-1]) * 0.1])
    braked = Trajectories.from_arrays(
        data.time, states={"y": data.states["y"], "v": data.states["v"] + step},
        inputs={"F": data.inputs["F"] + 0.15 * step}, derivatives={"v": data.derivatives["v"] + extra},
    )  # fmt: skip
    finding = studied_motion(braked).finding
    assert finding.verdict not in ("no gap", "instrument", "named")
