"""Exact paths of draws against integration by SciPy."""

import numpy as np
import pytest
from sampled_oscillator import SIMULATION, force, sampled
from scipy.integrate import solve_ivp

from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows

RUNS = 2


@pytest.fixture(scope="module")
def equation():
    model = Program(
        {"v": ["y**3"]}, simulation=SIMULATION, rows=TrajectoryRows(added=(("y**3", -0.3),)), discrepancy=None
    )
    return model.assemble(sampled(lambda y, v: -0.3 * y**3, noise=0.01, n=80, runs=RUNS))["v"]


def cubic(theta):
    return lambda columns, draw: theta[draw] * np.asarray(columns["y"])[:, None] ** 3


def integrated(theta, start, run, n=80):
    def rate(t, x):
        return [x[1], force(t, run) - 2 * x[0] - 0.15 * x[1] + theta * x[0] ** 3]

    return solve_ivp(rate, (0, 0.1 * (n - 1)), start, t_eval=0.1 * np.arange(n), rtol=1e-10, atol=1e-10).y[0]


def test_paths_of_any_coefficient_and_start_are_those_of_the_whole_equation(equation):
    rows, theta = equation.rows, np.array([-0.3, -0.8, 0.1])
    path = rows.operator
    at_start = np.flatnonzero(path.segments.end[:, 1] == 0)
    starts = np.zeros((3, rows.noise.n_start))
    # A start is given in units of σ; one prior standard deviation of it moves rows by a column of B.
    change = np.array([[0.0, 0.0], [0.2, -0.1], [-0.1, 0.3]])
    for r in range(RUNS):
        starts[:, 2 * r : 2 * r + 2] = change / path.start_sd
    typical = float(np.sqrt(np.mean(path.sensor_sd**2)))
    found = rows.exact(cubic(theta), starts * typical / path.gain) * path.gain
    for k in range(3):
        truth = [integrated(theta[k], path.at_samples[at_start[r]] + change[k], r) for r in range(RUNS)]
        # Steps of a tenth of the fastest time scale: far within the sensor's noise.
        np.testing.assert_allclose(found[k], np.concatenate(truth), atol=0.1 * typical)


def test_starts_are_those_of_the_rows_noise(equation):
    rows, noise = equation.rows, equation.rows.noise
    # So near the reference that nothing bends, exact rows are the linear ones.
    typical = float(np.sqrt(np.mean(rows.operator.sensor_sd**2)))
    b = 3e-4 * typical / rows.gain * np.random.default_rng(0).standard_normal((2, noise.n_start))
    theta = np.full(2, -0.3)
    linear = rows.simulated + rows.operate(cubic(theta)(rows.columns, 0))[:, 0] + b @ noise.starts.T
    np.testing.assert_allclose(rows.exact(cubic(theta), b), linear, atol=0.1 * typical / rows.gain)
    assert np.max(np.abs(b @ noise.starts.T)) > 0.3 * typical / rows.gain


def test_a_path_that_leaves_the_domain_is_no_number_and_spoils_no_other(equation):
    rows, theta = equation.rows, np.array([-0.3, np.nan])
    found = rows.exact(cubic(theta), np.zeros((2, rows.noise.n_start)))
    assert np.all(np.isfinite(found[0])) and np.all(np.isnan(found[1, 5:80]))
