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


@pytest.mark.slow
@pytest.mark.parametrize("seed", [5, 6])
def test_an_attached_absorber_is_no_name_of_the_catalogue(seed):
    data = host_with_absorber(seed)
    model = bg.GreyBox(simulation={"y": "v", "v": "F - 12*y - 0.6*v"}, dictionary={"v": []})
    study = bg.find_missing_effects(model, data, settle=False, progress=False)
    # It remembers, which rows of rates cannot name.
    assert study.verdict == "unknown"
    assert study.effects["probability"].max() < 0.9


@pytest.mark.slow
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


def held_brake(limit, slope):
    """A vehicle whose brake gives no more than its limit, commanded far beyond it; inputs are held."""
    rng, h, v, rows = np.random.default_rng(5), 0.001, 18.0, []
    for i in range(13000):
        if i % 40 == 0:
            t = i * h
            throttle = 0.3 + 0.5 * ((t % 7) < 4)
            u = 20000.0 * max(0.0, np.sin(2 * np.pi * t / 3.3)) ** 2 * ((t % 11) > 6)
            rows.append((t, v + rng.normal(0, 0.01), throttle, u))
        v += h * (-0.1 * v + 5.5 * throttle - slope * min(u, limit))
    return np.array(rows).T


@pytest.mark.parametrize(("limit", "slope"), [(1400, 0.0053), pytest.param(8000, 0.0007, marks=pytest.mark.slow)])
def test_a_brake_that_saturates_has_its_own_sign_and_its_own_coefficient(limit, slope):
    t, v, throttle, u = held_brake(limit, slope)
    model = bg.GreyBox(
        simulation={"v": f"-0.1*v + 5.5*throttle - {slope}*u"}, rows=bg.TrajectoryRows(interpolation="zoh")
    )
    data = bg.Trajectories.from_arrays(t, states={"v": v}, inputs={"throttle": throttle, "u": u})
    study = bg.find_missing_effects(
        model, data, roles={"velocity": "v", "input": "u"}, settle=False, free_runs=False, progress=False
    )
    first = study.effects.iloc[0]
    assert first["slug"] == "input-saturation" and first["reverse"] == "" and first["probability"] > 0.9
    assert study.corrections.loc[("v", "u"), "probability"] < 0.5


def relaxing(pulses):
    """An output that relaxes with two time constants after steps of an input; the simulation acts at once."""
    rng, h = np.random.default_rng(2), 0.0125 * pulses
    t = np.arange(0, 9 * pulses, h)
    current = np.where((t % 9) < 3, -4.2, 0.0)
    fast = slow = 0.0
    shown = []
    for i in current:
        shown.append(3.83 + 0.0215 * i + fast + slow + rng.normal(0, 5e-5))
        fast += h * (-fast / 0.4 + i * 0.0015 / 0.4)
        slow += h * (-slow / 3.0 + i * 0.003 / 3.0)
    return bg.Trajectories.from_arrays(t, states={}, inputs={"I": current}, outputs={"V": np.array(shown)})


def test_an_output_that_relaxes_after_its_input_remembers_it():
    study = bg.find_missing_effects(
        bg.GreyBox(simulation={"V": "3.83 + 0.0215*I"}), relaxing(4), catalogue="electrical", settle=False,
        free_runs=False, progress=False,
    )  # fmt: skip
    assert study.verdict == "unknown"
    assert study.memory.loc[("V", "relaxation of I"), "probability"] > 0.9
    # No coefficient is off for it.
    assert study.corrections.loc[("V", "I"), "probability"] < 0.5


@pytest.mark.slow
def test_a_temperature_is_told_of_no_friction():
    rng, T, S, rows = np.random.default_rng(1), 22.3, 22.3, []
    for i in range(600):
        rows.append((i, round((S + rng.normal(0, 0.08)) / 0.32) * 0.32))
        for _ in range(10):
            T += 0.1 * (42 - (T - 22.3)) / 150
            S += 0.1 * (T - S) / 12
    t, shown = np.array(rows, float).T
    study = bg.find_missing_effects(
        bg.GreyBox(simulation={"T": "(42 - (T - 22.3))/150"}, rows=bg.TrajectoryRows()),
        bg.Trajectories.from_arrays(t, states={"T": shown}, units={"t": "s", "T": "degC"}), settle=False,
        free_runs=False, progress=False,
    )  # fmt: skip
    assert study.verdict in ("unknown", "no gap") and not study.effects["slug"].str.contains("friction").any()


@pytest.mark.slow
def test_a_coefficient_that_is_off_is_said_beside_a_force_that_nobody_measured():
    rng, h, y, v, rows = np.random.default_rng(4), 0.01, 0.0, 0.0, []
    for i in range(8000):
        if i % 200 == 0:
            u = rng.uniform(-1, 1)
        if i % 10 == 0:
            rows.append((i * h, u, y + rng.normal(0, 0.005)))
        v += h * (-4 * y - 0.4 * v + 4.8 * u) + 0.03 * np.sqrt(h) * rng.normal()
        y += h * v
    t, u, y = np.array(rows).T
    study = bg.find_missing_effects(
        bg.GreyBox(
            simulation={"y": "v", "v": "-4*y - 0.4*v + 7*u"}, dictionary={"v": []},
            rows=bg.TrajectoryRows(interpolation="zoh"),
        ),
        bg.Trajectories.from_arrays(t, states={"y": y}, inputs={"u": u}), settle=False, free_runs=False, progress=False,
    )  # fmt: skip
    row = study.corrections.loc[("v", "u")]
    assert row["probability"] > 0.9 and abs(7 + row["mean"] - 4.8) < 4 * row["sd"]
    assert "u in d(v)/dt should have 4.8" in study.sentence
