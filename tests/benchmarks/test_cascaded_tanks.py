"""Cascaded tanks from the lower level alone: the error of free runs over the record that was kept aside.

BAYES_GREYBOX_DATA=folder python -m pytest -n 0 -m slow tests/benchmarks/test_cascaded_tanks.py -s
"""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

import bayes_greybox as bg
from bayes_greybox.config.file import load_config

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif("BAYES_GREYBOX_DATA" not in os.environ, reason="BAYES_GREYBOX_DATA names no folder of data"),
]

CONFIG = Path(__file__).parents[2] / "configs" / "cascaded_tanks.toml"

SENSOR = 10.0
"""Volts at which the sensor ends: a level beyond is shown as that."""

SKIPPED = 5
"""Samples at the start of a record that the benchmark does not count."""

STEPS = 4
"""Runge-Kutta steps between two samples, of the equations written by hand."""

WITHOUT_SECOND_BRIM = 0.32
"""The same error where only the upper tank spills, and a volt of the pump is given, V."""


def test_a_free_run_over_the_validation_record(capsys):
    config = load_config(CONFIG)
    train, test = config.read_data()
    fit = config.build_model().fit(train, seed=0, progress=False)
    errors = {}
    for part, data in (("estimation", train), ("validation", test)):
        level = fit.simulate(data).states["y"].mean
        errors[part] = float(np.sqrt(np.mean((np.minimum(level, SENSOR) - data.states["y"])[SKIPPED:] ** 2)))
    with capsys.disabled():
        print(f"\n{fit.verdict}\n{fit.inclusion()}\nRMS error of free runs, V: {errors}")
    assert fit.verdict.ok
    assert errors["validation"] < WITHOUT_SECOND_BRIM
    spilling = fit.inclusion().loc[("y", "log(1+exp(5*(h-10)))/5")]
    assert spilling["lower"] > -0.2, "what spills over reaches the lower tank"


@pytest.mark.parametrize("spills", [False, True], ids=["the upper tank spills", "both tanks spill"])
def test_least_squares_of_the_equations_by_hand(spills, capsys):
    """What roots and lines of the levels can do, by code that shares nothing with the package's: SciPy and NumPy."""
    train, test = (bg.load_dataset("cascaded_tanks")[part] for part in ("train", "test"))
    start = np.array([0.05, 0.0, 0.045, 0.05, 0.0, 0.05, 0.0, 0.3, 0.15, 5.0, 0.1])
    free = np.ones(len(start), bool)
    free[-1] = spills

    def errors_of(many: np.ndarray, data: bg.Trajectories) -> np.ndarray:
        every = np.where(free, many, 0.0)
        return np.minimum(levels(every, data.inputs["u"], data.states["y"][0]), SENSOR) - data.states["y"]

    def slopes(one: np.ndarray) -> np.ndarray:
        step = 1e-6 * np.maximum(np.abs(one), 1e-3)
        found = errors_of(np.vstack([one, one + np.diag(step)]), train)
        return ((found[1:] - found[0]) / step[:, None]).T

    found = least_squares(lambda one: errors_of(one[None], train)[0], start, slopes, x_scale="jac", max_nfev=200)
    errors = {
        part: float(np.sqrt(np.mean(errors_of(found.x[None], data)[0, SKIPPED:] ** 2)))
        for part, data in (("estimation", train), ("validation", test))
    }
    with capsys.disabled():
        print(f"\nleast squares, {'both tanks spill' if spills else 'the upper tank spills'}, V: {errors}")
    assert errors["validation"] < WITHOUT_SECOND_BRIM


def levels(many: np.ndarray, pump: np.ndarray, first: float) -> np.ndarray:
    """Lower levels [n_set, n] of many sets of coefficients at once, the pump held between samples."""
    k1, l1, k4, k2, l2, k3, l3, over, into, upper, lower = many.T

    def rate(h: np.ndarray, y: np.ndarray, u: float) -> tuple[np.ndarray, np.ndarray]:
        # Softplus for the brims: their edge would stop the search.
        brim, second = (np.logaddexp(0.0, 5 * (level - 10)) / 5 for level in (h, y))
        root, own = np.sqrt(np.maximum(h, 1e-9)), np.sqrt(np.maximum(y, 1e-9))
        return k4 * u - k1 * root - l1 * h - over * brim, (
            k2 * root + l2 * h - k3 * own - l3 * y + into * brim - lower * second
        )

    h, y, found, dt = upper.copy(), np.full(len(many), first), [], 4.0 / STEPS
    for u in pump:
        found.append(y)
        for _ in range(STEPS):
            h1, y1 = rate(h, y, u)
            h2, y2 = rate(h + dt / 2 * h1, y + dt / 2 * y1, u)
            h3, y3 = rate(h + dt / 2 * h2, y + dt / 2 * y2, u)
            h4, y4 = rate(h + dt * h3, y + dt * y3, u)
            h, y = h + dt / 6 * (h1 + 2 * h2 + 2 * h3 + h4), y + dt / 6 * (y1 + 2 * y2 + 2 * y3 + y4)
    return np.array(found).T
