"""Cascaded tanks from the lower level alone: the error of free runs over the record that was kept aside.

BAYES_GREYBOX_DATA=folder python -m pytest -n 0 -m slow tests/benchmarks/test_cascaded_tanks.py -s
"""

import os
from pathlib import Path

import numpy as np
import pytest

from bayes_greybox.config.file import load_config

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif("BAYES_GREYBOX_DATA" not in os.environ, reason="BAYES_GREYBOX_DATA names no folder of data"),
]

CONFIG = Path(__file__).parents[2] / "configs" / "cascaded_tanks.toml"

SENSOR = 10.0
"""Volts at which the sensor ends: a level beyond is shown as that."""

WITHOUT_LINES = 0.54
"""The same error without the terms h and y of the dictionary, V."""


def test_a_free_run_over_the_validation_record(capsys):
    config = load_config(CONFIG)
    train, test = config.read_data()
    fit = config.build_model().fit(train, seed=0, progress=False)
    errors = {}
    for part, data in (("estimation", train), ("validation", test)):
        level = fit.simulate(data).states["y"].mean
        errors[part] = float(np.sqrt(np.mean((np.minimum(level, SENSOR) - data.states["y"]) ** 2)))
    with capsys.disabled():
        print(f"\n{fit.verdict}\n{fit.inclusion()}\nRMS error of free runs, V: {errors}")
    assert fit.verdict.ok
    assert errors["validation"] < WITHOUT_LINES
    spilling = fit.inclusion().loc[("y", "max(h-10,0)")]
    assert spilling["lower"] > -0.2, "what spills over reaches the lower tank"
