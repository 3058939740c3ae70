"""Filtered rates with filtered terms: friction of 0.3 % of the acceleration, and what the rows warn of."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.derivative_rows import DerivativeRows, row_warnings
from bayes_greybox.physics.terms import Dictionary, Term

STIFFNESS, COULOMB, QUADRATIC = 40.0, 0.052, 0.0045
SIMULATION = {"y": "v", "v": "-40*sin(y)"}


@pytest.fixture(scope="module")
def decay():
    """Angle of a free decay of 30 periods at 1 kHz, one half swing after the other: friction has a kink between."""
    t, angle, start, state = np.arange(0, 30, 1e-3), [], 0.0, np.array([0.9, 0.0])
    while start < t[-1]:
        sign = -np.sign(state[0])

        def rate(_, x, sign=sign):
            return [x[1], -STIFFNESS * np.sin(x[0]) - COULOMB * sign - QUADRATIC * x[1] * abs(x[1])]

        def turn(_, x, sign=sign):
            return x[1] * sign

        turn.terminal, turn.direction = True, -1
        swing = solve_ivp(rate, (start, start + 2), state, events=turn, dense_output=True, rtol=1e-10, atol=1e-12)
        angle.append(swing.sol(t[(t >= start) & (t < swing.t[-1])])[0])
        start, state = swing.t[-1], np.array([swing.y[0, -1], 0.0])
    return t, np.concatenate(angle)[: len(t)]


def noisy(decay, seed, share=1e-3):
    t, angle = decay
    noise = share * angle.std() * np.random.default_rng(seed).standard_normal(len(angle))
    return Trajectories.from_arrays(t, states={"y": angle + noise})


def least_squares(data, kind):
    """Generalised least squares of both frictions, in standard deviations from the truth."""
    model = Program({"v": ["sign(v)", "v*abs(v)"]}, simulation=SIMULATION, rows=kind)
    rows = model.equation_rows(data, "v")
    terms = Dictionary.of(("sign(v)", "v*abs(v)"), ("y", "v"))
    white = rows.whiten(np.column_stack([rows.operate(rows.at_samples(terms.evaluate)), rows.target]))
    Phi, y = white[:, :-1], white[:, -1]
    theta = np.linalg.lstsq(Phi, y)[0]
    sd = np.sqrt(np.diag(np.linalg.inv(Phi.T @ Phi)) * np.mean((y - Phi @ theta) ** 2))
    return (theta + [COULOMB, QUADRATIC]) / sd, sd


def test_friction_of_a_third_of_a_per_cent_is_found_with_filtered_terms(decay):
    z = []
    for seed in range(12):
        data = noisy(decay, seed).differentiate(rates={"y": "v"}, window=233)
        z.append(least_squares(data, DerivativeRows())[0])
    # 24 standard normals, correlated in pairs: beyond 4, and an RMS beyond 1.6, once in a thousand.
    assert np.abs(z).max() < 4 and np.sqrt(np.mean(np.square(z))) < 1.6
    # Terms of filtered states are off by many standard deviations on the same data, and sure of it.
    assert np.abs(least_squares(data, DerivativeRows(filter_terms=False))[0]).max() > 20


def test_rows_warn_of_noise_truncation_and_sampling_and_are_quiet_without(decay):
    simulation, kind = Program({"v": ["v"]}, simulation=SIMULATION).simulator, DerivativeRows()
    good = noisy(decay, 0).differentiate(rates={"y": "v"}, window=151)
    assert row_warnings(kind, good, "v", simulation(good)) == []
    wide = noisy(decay, 0).differentiate(rates={"y": "v"}, window=701)
    assert any("Halve its window" in text for text in row_warnings(kind, wide, "v", simulation(wide)))
    rng, t = np.random.default_rng(1), np.arange(0, 20, 0.01)
    y, v, a = np.sin(6 * t), 6 * np.cos(6 * t), -36 * np.sin(6 * t)
    measured = Trajectories.from_arrays(
        t,
        states={"y": y + 0.02 * rng.standard_normal(len(t)), "v": v},
        derivatives={"v": a + 0.1 * rng.standard_normal(len(t))},
    )
    (noise,) = row_warnings(kind, measured, "v", simulation(measured))
    assert noise.startswith("Noise of 0.02 in y")
    t = np.arange(0, 20, 0.2)
    coarse = Trajectories.from_arrays(
        t, states={"y": np.sin(6 * t), "v": 6 * np.cos(6 * t)}, derivatives={"v": -36 * np.sin(6 * t)}
    )
    assert any(
        "samples a period, fewer than 10" in text for text in row_warnings(kind, coarse, "v", simulation(coarse))
    )


def test_friction_whose_coefficient_is_known_is_that_of_the_simulation(decay):
    data = noisy(decay, 0).differentiate(rates={"y": "v"}, window=151)
    given = Program({"v": ["v"]}, simulation={**SIMULATION, "v": "-40*sin(y) - 0.052*sign(v)"})
    known = Program({"v": ["v", Term("sign(v)", fixed=-COULOMB)]}, simulation=SIMULATION)
    one, other = (model.equation_rows(data, "v").simulated for model in (given, known))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    # At points both would be off where the angle turns round.
    point = Program({"v": ["v"]}, simulation=SIMULATION).equation_rows(data, "v").simulated
    rows = given.equation_rows(data, "v")
    at_points = point - COULOMB * rows.operate(np.sign(data.states["v"])[:, None])[:, 0]
    assert np.abs(one - at_points).max() > 1e-4
