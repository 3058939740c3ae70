"""A speed in other units than its position, beside an effect that the simulation lacks."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bayes_greybox as bg


def record(gain, seed=1, n=600, step=0.05):
    """A sprung mass with drag, pushed by a multisine; the speed's sensor shows `gain` times the speed."""
    rng, t = np.random.default_rng(seed), step * np.arange(n)
    frequency, phase = rng.uniform(0.1, 1.2, 12), rng.uniform(0, 2 * np.pi, 12)

    def push(at):
        return np.sum(np.sin(2 * np.pi * frequency * at + phase))

    def rates(at, x):
        return [x[1], push(at) - 10 * x[0] - 0.5 * x[1] - 0.8 * x[1] * abs(x[1])]

    path = solve_ivp(rates, (0, t[-1]), [0.2, 0.0], t_eval=t, rtol=1e-9, atol=1e-9).y
    slopes = np.array([rates(at, x)[1] for at, x in zip(t, path.T, strict=True)])
    noisy = path + 5e-4 * np.std(path, axis=1, keepdims=True) * rng.standard_normal(path.shape)
    return bg.Trajectories.from_arrays(
        t,
        states={"y": noisy[0], "v": gain * noisy[1]},
        inputs={"F": [push(at) for at in t]},
        derivatives={"v": slopes + 0.01 * np.std(slopes) * rng.standard_normal(n)},
    )


@pytest.mark.parametrize("gain", [3.6, 1 / 3.6])
def test_drag_is_named_with_its_coefficient_in_the_units_of_the_simulation(gain):
    train, test = record(gain).split(0.7)
    model = bg.GreyBox(simulation={"y": "v", "v": "F - 10*y - 0.5*v"})
    study = bg.find_missing_effects(model, train, test=test, settle=False, progress=False)
    assert study.verdict == "named"
    (drag,) = study.effects[study.effects["status"] == "added"].itertuples()
    assert drag.slug == "quadratic-drag" and abs(drag.mean + 0.8) < 4 * drag.sd < 0.1
    (row,) = study.instrument[study.instrument["suspect"] == "gain"].itertuples()
    assert row.channel == "v" and row.mean == pytest.approx(gain - 1, rel=0.03)
    assert row.text == f"v reads {1 + row.mean:.4g} times what it should (check its units)"
    free_run = study.gap.xs("free-run NRMSE", level="metric").loc["test"]
    assert (free_run["after"] < 0.02).all()
