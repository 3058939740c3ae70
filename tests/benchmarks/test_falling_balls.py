"""Falling balls, measured, with gravity as the whole simulation: which drag does the study name?

BAYES_GREYBOX_DATA=folder python -m pytest -n 0 -m slow tests/benchmarks/test_falling_balls.py -s
"""

import os

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import bayes_greybox as bg

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif("BAYES_GREYBOX_DATA" not in os.environ, reason="BAYES_GREYBOX_DATA names no folder of data"),
]

LIGHT = ("Yellow Whiffle Ball", "Tennis Ball", "Volleyball")
HEAVY = ("Baseball", "Bowling Ball")

IMPACT = 3
"""Frames at the end of each drop that are left out: the ball hits the ground there."""

RATE = 15.0
"""Frames a second; the recorded times stray from it, and a differentiator wants them even."""


def drops(ball: str) -> bg.Trajectories:
    data = bg.load_dataset("falling_balls").data
    runs = [data.take(i) for i, name in enumerate(data.run_names) if name.startswith(ball)]
    assert runs, data.run_names
    times, heights = [], []
    for run in runs:
        time, height = run.time[:-IMPACT], run.states["y"][:-IMPACT]
        even = time[0] + np.arange(int((time[-1] - time[0]) * RATE)) / RATE
        times.append(even)
        heights.append(CubicSpline(time, height)(even))
    data = bg.Trajectories.from_arrays(times, states={"y": heights}, units={"t": "s", "y": "m"})
    return data.differentiate("savgol", rates={"y": "v"})


def study(ball: str, capsys) -> bg.Study:
    model = bg.GreyBox(simulation={"y": "v", "v": "-9.81"}, discrepancy=bg.OrthogonalGP(variables=("v",)))
    # The height at which a ball is can play no part.
    found = bg.find_missing_effects(
        model, drops(ball), roles={"position": ()}, settle=False, free_runs=False, progress=False
    )
    likeliest = found.hypotheses["probability"].xs("v").nlargest(3)
    with capsys.disabled():
        print(f"\n| {ball} | {found.verdict} | " + ", ".join(f"{k} {p:.3f}" for k, p in likeliest.items()) + " |")
    return found


@pytest.mark.parametrize("ball", LIGHT)
def test_a_light_ball_shows_its_drag(ball, capsys):
    found = study(ball, capsys)
    added = list(found.effects["slug"][found.effects["status"] == "added"])
    if added != ["quadratic-drag"]:
        pytest.xfail(f"{ball}: {found.verdict}, {', '.join(added) or 'nothing'} added, not quadratic drag")


@pytest.mark.parametrize("ball", HEAVY)
def test_a_heavy_ball_gets_no_confident_name(ball, capsys):
    found = study(ball, capsys)
    assert found.verdict in ("no gap", "unknown", "recalibrate") or found.effects["probability"].max() < 0.9


def test_all_drops_at_once_from_their_heights(capsys):
    """One model of 22 drops, a coefficient for each ball, from the heights alone: the films' stamps as they are."""
    data = bg.load_dataset("falling_balls", by_ball=True).data

    def fit(shape: str, **noise: str) -> bg.Fit:
        model = bg.GreyBox(
            {"v": [f"{ball}*{shape}" for ball in data.input_names]},
            simulation={"y": "v", "v": "-9.81"},
            rows=bg.TrajectoryRows(),
            prior=bg.Normal(),
            discrepancy=None,
            noise=bg.Noise(**noise),
        )
        return model.fit(data, seed=1, progress=False)

    for shape in ("v", "v*abs(v)"):
        white, forced = fit(shape), fit(shape, force="fit")
        table = forced.summary().loc["v"]
        with capsys.disabled():
            sigma, p = float(white.summary().loc[("v", "sigma"), "mean"]), white.checks().whiteness["v"].p
            print(f"\n{shape}: residuals of {sigma:.2f} m without a force, p of whiteness {p:.2g}")
            print(table[["mean", "sd", "lower", "upper"]].round(4).to_string())
        assert not white.checks().table.loc[("v", "whiteness"), "ok"]
        assert forced.checks().table.loc[("v", "whiteness"), "ok"]
        # Wiffle balls are slowed down, heavy ones hardly.
        for ball in ("whiffle_ball_1", "yellow_whiffle_ball", "orange_whiffle_ball", "tennis_ball", "volleyball"):
            assert table.loc[f"{ball}*{shape}", "upper"] < 0
        for ball in ("bowling_ball", "golf_ball", "baseball"):
            assert table.loc[f"{ball}*{shape}", "upper"] > 0
