"""Several equations on the rows of the same samples, against integration of all of them."""

import numpy as np
import pytest
from predator_prey import by_integration, sampled

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.subject import studied_equations
from bayes_greybox.model.estimate import near
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows
from bayes_greybox.running.errors import InputError

BOTH = {"x": ["x", "x*y"], "y": ["x*y", "y"]}


def model_of(dictionary=BOTH, **changes):
    return Program(dictionary, **{"rows": TrajectoryRows(), "discrepancy": None} | changes)


def estimate(model, data):
    """Least squares on the whitened rows: coefficients by (state, term), their standard deviations, sensors' noise."""
    (equation,) = model.assemble(data).values()
    Phi, y = np.asarray(equation.design.Phi), np.asarray(equation.design.y)
    theta, unit = np.linalg.lstsq(Phi, y, rcond=None)[0], equation.frame.coefficient_scale
    freedom = equation.rows.n_white - len(theta) - len(model.states(data))
    sd = np.sqrt(np.sum((y - Phi @ theta) ** 2) / freedom * np.diag(np.linalg.inv(Phi.T @ Phi)))
    sensors = equation.rows.operator.sensor_sd
    return dict(zip(equation.frame.labels, theta * unit, strict=True)), sd * unit, sensors


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_near_their_estimate_the_rows_have_the_estimate_of_the_whole_equations(seed):
    data = sampled(seed)
    model, whole = model_of().near(data)
    theta, sd, sensors = estimate(model, data)
    truth, truth_sd = by_integration(data, sensors)
    assert list(theta) == [("x", "x"), ("x", "x*y"), ("y", "x*y"), ("y", "y")]
    np.testing.assert_allclose(list(theta.values()), truth, atol=0.05 * truth_sd.min())
    np.testing.assert_allclose(sd, truth_sd, rtol=0.02)
    assert set(whole.derivatives) == {"x", "y"}


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_one_species_alone_tells_of_both(seed):
    # What preys is counted in the unit in which it halves the prey: else no sensor tells its number.
    data = sampled(seed, noise=0.03, keep="x")
    model = model_of({"x": ["x"], "y": ["x*y", "y"]}, simulation={"x": "-x*y"})
    assert model.states(data) == ("x", "y")
    near, whole = model.near(data)
    theta, sd, sensors = estimate(near, data)
    truth, truth_sd = by_integration(data, sensors, free=(0, 2, 3))
    np.testing.assert_allclose(list(theta.values()), truth, atol=0.05 * truth_sd.min())
    np.testing.assert_allclose(sd, truth_sd, rtol=0.02)
    assert set(whole.states) == {"x", "y"}


def test_a_column_is_the_response_to_a_force_on_its_own_state():
    data = sampled()
    (equation,) = model_of().assemble(data).values()
    rows, frame = equation.rows, equation.frame
    table = equation.parts()[0] * frame.term_scale
    for (state, term), column in zip(frame.labels, table.T, strict=True):
        product = {"x": rows.columns["x"], "y": rows.columns["y"], "x*y": rows.columns["x"] * rows.columns["y"]}[term]
        np.testing.assert_allclose(column, rows.learned[state].operator(product[:, None])[:, 0], rtol=1e-6, atol=1e-9)


def test_the_order_of_the_equations_and_the_units_of_the_states_do_not_matter():
    data = sampled()
    one, sd, _ = estimate(model_of().near(data)[0], data)
    other, *_ = estimate(model_of(dict(reversed(BOTH.items()))).near(data)[0], data)
    np.testing.assert_allclose([other[label] for label in one], list(one.values()), atol=1e-3 * sd.min())
    small = Trajectories.from_arrays(data.time, states={"x": data.states["x"], "y": 1000 * data.states["y"]})
    scaled, *_ = estimate(model_of().near(small)[0], small)
    found = np.array(list(scaled.values())) * [1, 1000, 1, 1]
    np.testing.assert_allclose(found, list(one.values()), atol=1e-3 * sd.min())


def test_the_path_without_process_noise_is_one_of_the_equations():
    data = sampled(noise=0.3)
    rows = model_of().near(data)[0].rows
    path = rows.path(data, ("x", "y"), model_of().simulator(data))
    x, y = path.at_samples.T
    rate = {(name, text): value for (text, value), name in zip(rows.added, rows.added_to, strict=True)}
    dx = rate[("x", "x")] * x + rate[("x", "x*y")] * x * y
    assert np.sqrt(np.mean((path.rates[:, 0] - dx) ** 2)) < 1e-3 * np.std(dx)


def test_learned_states_that_nothing_measures_or_uses_are_refused():
    data = sampled(keep="x")
    with pytest.raises(InputError, match="'z', which is not a state"):
        model_of({"x": ["x"], "z": ["x", "z"]}).assemble(data)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Program(BOTH, rows=TrajectoryRows()), "for 2 equations cannot have a discrepancy"),
        (lambda: studied_equations(model_of(), sampled()), "looks at one equation, not at x, y together"),
        (lambda: model_of({"x": ["x", "x*y"], "y": []}).assemble(sampled()), "no terms"),
    ],
)
def test_what_cannot_be_used_is_refused(build, message):
    with pytest.raises(InputError, match=message):
        build()


def test_coefficients_that_do_not_settle_are_refused(monkeypatch):
    monkeypatch.setattr(near, "TRIES", (1,))
    monkeypatch.setattr(near, "UNFORCED_ITERATIONS", 1)
    with pytest.raises(InputError, match="of x, y do not settle"):
        model_of().near(sampled())
