"""Small inputs of kinds that once failed, with the right answers."""

import numpy as np
import pytest

import bayes_greybox as bg


def multisine(seed, t):
    rng = np.random.default_rng(seed)
    frequencies, phases = rng.uniform(0.5, 6.0, 12), rng.uniform(0, 2 * np.pi, 12)
    return np.sin(np.outer(t, frequencies) + phases).sum(axis=1)


def host_with_absorber(seed):
    """601 rows over 60 s: exact states, 2 % noise on the rate of v; a second mass hangs on the body."""
    t, steps = np.linspace(0, 60, 601), 40
    fine = np.linspace(0, 60, 600 * steps + 1)
    F, h = multisine(seed, fine), fine[1]

    def rates(x, u):
        y, v, q, p = x
        a = 0.1 * (16 * (q - y) + 0.4 * (p - v))
        return np.array([v, u - 12 * y - 0.6 * v + a, p, -a / 0.1])

    x, states = np.zeros(4), [np.zeros(4)]
    for k in range(len(fine) - 1):
        first = rates(x, F[k])
        second = rates(x + h * first, F[k + 1])
        x = x + h / 2 * (first + second)
        states.append(x)
    states, F = np.array(states)[::steps], F[::steps]
    acceleration = np.array([rates(x, u)[1] for x, u in zip(states, F, strict=True)])
    noise = 0.02 * np.std(acceleration) * np.random.default_rng(seed).standard_normal(len(t))
    return bg.Trajectories.from_arrays(
        t, states={"y": states[:, 0], "v": states[:, 1]}, derivatives={"v": acceleration + noise}, inputs={"F": F}
    )


@pytest.mark.parametrize("seed", [5, 6])
def test_an_attached_absorber_is_no_name_of_the_catalogue(seed):
    data = host_with_absorber(seed)
    model = bg.GreyBox(simulation={"y": "v", "v": "F - 12*y - 0.6*v"}, dictionary={"v": []})
    study = bg.find_missing_effects(model, data, settle=False, progress=False)
    # It remembers, which rows of rates cannot name.
    assert study.verdict == "unknown"
    assert study.effects["probability"].max() < 0.9


def test_a_force_of_time_that_nobody_measured_has_no_name():
    rng, h = np.random.default_rng(3), 0.001

    def force(t):
        p = (t - 1) % 8
        return 0.0 if t < 1 else 3 * np.clip(min(p / 2, (6 - p) / 2), 0, 1)

    x, v, rows = 0.5, 0.0, []
    for i in range(20001):
        if i % 20 == 0:
            rows.append((i * h, x + rng.normal(0, 0.005)))
        v += h * (-10 * x - 0.5 * v + force(i * h))
        x += h * v
    t, x = np.array(rows).T
    model = bg.GreyBox(simulation={"x": "v", "v": "-10*x - 0.5*v"}, rows=bg.TrajectoryRows())
    study = bg.find_missing_effects(
        model, bg.Trajectories.from_arrays(t, states={"x": x}), catalogue="mechanical", settle=False, free_runs=False,
        progress=False,
    )  # fmt: skip
    assert study.verdict == "unknown"
    assert study.effects["probability"].max() < 0.3
    assert study.memory.loc[("v", "something in time"), "probability"] > 0.9
