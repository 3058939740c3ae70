"""Dry friction behind rates that a filter computed from positions: the jump is named, and not a rounded one."""

import numpy as np
import pytest

import bayes_greybox as bg

STIFFNESS, VISCOUS, COULOMB, STEP, FINER = 40.0, 0.4, 0.55, 0.01, 200


def sticking(seed, duration):
    """Position and force of a driven mass that sticks where its force is less than the friction, in plain steps."""
    rng, n = np.random.default_rng(seed), round(duration / STEP)
    omega, phase, size = rng.uniform(2, 9, 4), rng.uniform(0, 2 * np.pi, 4), rng.uniform(0.6, 1.4, 4)
    t, h = np.arange(n * FINER) * STEP / FINER, STEP / FINER
    force = 1.2 * np.sum(size[:, None] * np.sin(omega[:, None] * t + phase[:, None]), axis=0)
    x, v, path = 0.02, 0.0, np.empty(n * FINER)
    for i, push in enumerate(force.tolist()):
        path[i] = x
        pull = push - STIFFNESS * x - VISCOUS * v
        if v == 0.0:
            v = 0.0 if abs(pull) <= COULOMB else h * (pull - np.copysign(COULOMB, pull))
        else:
            after = v + h * (pull - np.copysign(COULOMB, v))
            v = after if after * v > 0 else 0.0
        x += h * v
    return t[::FINER], path[::FINER], force[::FINER], rng


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.003, 0.02])
def test_a_filter_does_not_make_a_jump_a_rounded_one(noise):
    t, x, u, rng = sticking(5, 20.0)
    measured = x + noise * np.sqrt(np.mean(x**2)) * rng.standard_normal(len(x))
    data = bg.Trajectories.from_arrays(t, states={"x": measured}, inputs={"u": u}).differentiate(rates={"x": "v"})
    study = bg.find_missing_effects(
        bg.GreyBox(simulation={"x": "v", "v": "u - 0.4*v - 40*x"}, dictionary={"v": []}),
        data,
        catalogue="mechanical",
        roles={"position": "x", "velocity": "v"},
        free_runs=False,
        settle=False,
        progress=False,
    )
    told = study.hypotheses.loc["v"]["probability"]
    assert told.idxmax() == "coulomb-friction", study.sentence
    # Whether it jumps or bends is beyond what a filter leaves of it.
    assert study.verdict in ("partly named", "one of")
    assert any("rates that a filter computed do not show how Coulomb friction is" in text for text in study.against)
    assert sum(p for name, p in told.items() if "smooth-friction" in str(name)) < 0.3, study.sentence
