"""Rough forces in time: on an output they are the noise of its sensor, on a rate they may act on the machine."""

import numpy as np
import pytest

import bayes_greybox as bg

N, STEP, PERIOD = 600, 0.05, 2 * np.pi / 3


def rough(n, step, tau, seed):
    """An Ornstein-Uhlenbeck process of standard deviation one."""
    rng, values = np.random.default_rng(seed), np.zeros(n)
    keep = np.exp(-step / tau)
    for i in range(1, n):
        values[i] = keep * values[i - 1] + np.sqrt(1 - keep**2) * rng.standard_normal()
    return values


@pytest.fixture(scope="module")
def machine():
    """States and rate of an oscillator that a rough force pushes besides."""
    fine = STEP / 10
    force = rough(10 * N, fine, 0.46 * PERIOD, 90)
    y, v, rows = 0.5, 0.0, []
    for i, w in enumerate(force):
        u = 2 * np.sin(1.3 * i * fine) + 1.5 * np.sin(4.1 * i * fine)
        a = u - 9 * y - 0.4 * v + w
        if i % 10 == 0:
            rows.append((i * fine, y, v, u, a))
        v += fine * a
        y += fine * v
    return np.array(rows).T


@pytest.mark.slow
def test_a_rough_force_on_a_machine_is_no_noise_of_its_sensor(machine):
    t, y, v, u, a = machine
    a = a + 0.05 * np.std(a) * np.random.default_rng(1).standard_normal(N)
    data = bg.Trajectories.from_arrays(t, states={"y": y, "v": v}, inputs={"u": u}, derivatives={"v": a})
    model = bg.GreyBox(simulation={"y": "v", "v": "u - 9*y - 0.4*v"}, dictionary={"v": []})
    study = bg.find_missing_effects(
        model, data, catalogue="mechanical", settle=False, free_runs=False, progress=False
    )  # fmt: skip
    assert study.verdict == "unknown"


def test_what_is_rough_in_an_output_is_its_sensor(machine):
    t, y, v, _, _ = machine
    force = 9 * y + 4 * v
    force = force + 0.1 * np.std(force) * rough(N, STEP, 0.7 * PERIOD, 2)
    data = bg.Trajectories.from_arrays(t, states={"y": y, "v": v}, outputs={"F": force}, units={"y": "m", "v": "m/s"})
    study = bg.find_missing_effects(
        bg.GreyBox(simulation={"F": "9*y + 4*v"}), data, catalogue="mechanical", settle=False, free_runs=False,
        progress=False,
    )  # fmt: skip
    assert study.verdict == "no gap" and "correlated noise" in set(study.instrument["suspect"])
