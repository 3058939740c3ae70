"""Samples of a sensor as rows: what they say of a model, against integration of the whole equation."""

from dataclasses import replace

import numpy as np
import pytest
from sampled_oscillator import SIMULATION, force, sampled
from scipy.integrate import odeint, solve_ivp
from scipy.optimize import least_squares

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.estimate import near as near_module
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.noise.asked import Noise
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

CUBIC = {"hidden": lambda y, v: -0.3 * y**3}


def program(terms=("y**3",), rows=None, **changes):
    return Program(
        {"v": list(terms)}, simulation=SIMULATION, rows=rows or TrajectoryRows(), **{"discrepancy": None} | changes
    )


def estimate(model, data):
    """Least squares on the whitened rows, with standard deviations."""
    equation = model.assemble(data)["v"]
    Phi, y = np.asarray(equation.design.Phi), np.asarray(equation.design.y)
    theta, unit = np.linalg.lstsq(Phi, y, rcond=None)[0], equation.frame.coefficient_scale
    sigma = np.sqrt(np.sum((y - Phi @ theta) ** 2) / (equation.rows.n_white - len(theta)))
    return theta * unit, sigma * np.sqrt(np.diag(np.linalg.inv(Phi.T @ Phi))) * unit


def by_integration(data):
    """Least squares of the whole equation: coefficient of y³ and its standard deviation."""
    t, y = data.time, data.states["y"]

    def residual(p):
        def rate(time, x):
            return [x[1], force(time) - 2 * x[0] - 0.15 * x[1] + p[0] * x[0] ** 3]

        return odeint(rate, p[1:] - 1, t, tfirst=True, rtol=1e-9, atol=1e-9)[:, 0] - y

    # Its slopes by steps far above what the integration is off by, or they are of its rounding; steps are relative, so
    # that what may be nothing is counted from one.
    found = least_squares(residual, [-0.2, y[0] + 1, 1.0], "3-point", x_scale=[0.1, 0.1, 0.1], diff_step=1e-4)
    sigma = np.sqrt(np.sum(found.fun**2) / (len(t) - 3))
    return found.x[0], sigma * np.sqrt(np.linalg.inv(found.jac.T @ found.jac)[0, 0])


def test_near_its_estimate_the_rows_have_the_estimate_of_the_whole_equation():
    data = sampled(**CUBIC)
    model, _ = program().near(data)
    (theta,), (sd,) = estimate(model, data)
    truth, truth_sd = by_integration(data)
    assert theta == pytest.approx(truth, abs=0.02 * truth_sd) and sd == pytest.approx(truth_sd, rel=0.02)
    assert abs(theta + 0.3) < 4 * sd


def test_far_from_it_they_are_near_already():
    data = sampled(**CUBIC)
    (theta,), (sd,) = estimate(program(), data)
    assert abs(theta + 0.3) < 5 * sd


def test_states_without_a_sensor_are_followed():
    model, data = program(), sampled(**CUBIC, noise=0.003)
    assert model.states(data) == ("y", "v")
    whole = model.complete(data)
    truth = sampled(**CUBIC, noise=0.0)
    assert np.std(whole.states["y"] - truth.states["y"]) < 0.003 * np.std(truth.states["y"])
    v = np.gradient(truth.states["y"], truth.time)
    assert np.std((whole.states["v"] - v)[5:-5]) < 0.05 * np.std(v)
    assert whole.samples is data and model.complete(whole).samples is data
    # The missing force is in the rate of the path.
    known = force(data.time) - 2 * whole.states["y"] - 0.15 * whole.states["v"]
    lacking = whole.derivatives["v"] - known
    assert np.corrcoef(lacking, -0.3 * truth.states["y"] ** 3)[0, 1] > 0.5


def test_a_hidden_level_is_followed_though_its_root_is_no_number_below_an_empty_tank():
    t = np.arange(200.0)

    def whole(time, h):
        upper, lower = np.sqrt(np.maximum(h, 0.0))
        return [0.1 + 0.06 * np.sin(0.03 * time) - 0.045 * upper, 0.045 * upper - 0.02 * h[1] - 0.022 * lower]

    level = solve_ivp(whole, (0, t[-1]), [4.0, 4.0], t_eval=t, rtol=1e-9, atol=1e-10).y
    shown = level[1] + 0.01 * np.std(level[1]) * np.random.default_rng(0).standard_normal(len(t))
    u = 1 + 0.6 * np.sin(0.03 * t)
    data = Trajectories.from_arrays(t, states={"h2": shown}, inputs={"u": u})
    tanks = {"h1": "0.1*u - 0.045*sqrt(h1)", "h2": "0.045*sqrt(h1) - 0.02*h2"}
    model = Program({"h2": ["sqrt(h2)"]}, simulation=tanks, rows=TrajectoryRows(), discrepancy=None)
    near, _ = model.near(data)
    equation = near.assemble(data)["h2"]
    theta = np.linalg.lstsq(np.asarray(equation.design.Phi), np.asarray(equation.design.y), rcond=None)[0]
    assert theta * equation.frame.coefficient_scale == pytest.approx([-0.022], rel=0.05)


def test_rows_are_forces_and_their_gain_leads_back_to_the_sensor():
    data = sampled()
    rows = program().equation_rows(data, "v")
    np.testing.assert_allclose(rows.measured * rows.gain, data.states["y"])
    assert rows.n_row == 400 and rows.n_sample > 400 and rows.operator.n_segment == 1
    assert np.std(rows.noise.without_starts(rows.target[:, None])) * rows.gain == pytest.approx(
        0.02 * np.std(data.states["y"]), rel=0.15
    )


def test_runs_of_unequal_length_uneven_steps_and_missing_samples():
    rng = np.random.default_rng(0)
    whole = sampled(**CUBIC, n=500)
    kept = np.sort(rng.choice(500, 380, replace=False))
    thin = sampled(**CUBIC, n=500, keep=kept)
    (theta,), (sd,) = estimate(program().near(thin)[0], thin)
    assert abs(theta + 0.3) < 4 * sd and sd < 1.6 * estimate(program().near(whole)[0], whole)[1][0]
    both = sampled(**CUBIC, n=250, runs=2)
    rows = np.ones(500, bool)
    rows[150:250] = False
    unequal = both.keep(rows)
    (theta,), (sd,) = estimate(program().near(unequal)[0], unequal)
    assert unequal.run_lengths == (150, 250) and abs(theta + 0.3) < 4 * sd


def test_two_sensors_share_the_coefficient_and_each_has_its_own_noise():
    one = sampled(**CUBIC, noise=0.05)
    whole = program().complete(sampled(**CUBIC, noise=0.0))
    v = whole.states["v"] + 0.1 * np.std(whole.states["v"]) * np.random.default_rng(3).standard_normal(400)
    two = Trajectories.from_arrays(
        one.time, states={"y": one.states["y"], "v": v}, inputs={"F": one.inputs["F"]}, units=dict(one.units)
    )
    model = program().near(two)[0]
    rows = model.equation_rows(two, "v")
    s = rows.operator.sensor_sd
    assert rows.n_row == 800
    assert s == pytest.approx([0.05 * np.std(one.states["y"]), 0.1 * np.std(v)], rel=0.15)
    (theta,), (sd,) = estimate(model, two)
    assert abs(theta + 0.3) < 4 * sd < 4 * estimate(program().near(one)[0], one)[1][0]


def test_rows_of_a_part_are_those_of_its_samples():
    data = sampled(**CUBIC, runs=2)
    whole = program().complete(data)
    part = whole.take(1)
    np.testing.assert_array_equal(part.samples.states["y"], data.take(1).states["y"])
    assert program().equation_rows(part, "v").n_row == 400


def test_the_model_that_rows_are_near_survives_as_text():
    rows = TrajectoryRows().around([(Term("max(0, y)*abs(v)"), 0.1 + 0.2)])
    assert rows.added == (("abs(v)*max(0,y)", 0.1 + 0.2),)
    assert TrajectoryRows(added=(("abs(v)*max(0,y)", 0.1 + 0.2),)) == rows


def test_a_hidden_state_at_rest_is_followed_from_near_rest():
    """A lag behind the force: the path starts it near zero, where another hidden state could start anywhere."""
    tau, t = 0.7, 0.1 * np.arange(400)

    def rate(s, x):
        return [x[1], x[2] - 2 * x[0] - 0.15 * x[1], (force(s) - x[2]) / tau]

    x = solve_ivp(rate, (0, t[-1]), [0.3, 0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-10).y
    y = x[0] + 0.01 * np.std(x[0]) * np.random.default_rng(0).standard_normal(400)
    data = Trajectories.from_arrays(t, states={"y": y}, inputs={"F": force(t)}, units={"t": "s", "y": "m"})
    before = Program({"v": []}, simulation=SIMULATION, rows=TrajectoryRows())
    model = before.remembering([HiddenState("z", f"(F - z)/{tau!r}", "F")], data)
    assert model.simulation == {**SIMULATION, "z": f"(F - z)/{tau!r}"} and model.rows.at_rest == (("z", "F"),)
    assert model.discrepancy is not None and model.discrepancy.variables == ("y", "v", "F")
    assert before.remembering([], data) is before
    near = replace(model, rows=model.rows.around([(Term("z - F"), 1.0)]))
    path = near.rows.path(data, ("v",), near.simulator(data))
    assert path.start_sd[2] == pytest.approx(np.sqrt(np.mean(force(t) ** 2)))
    whole = near.rows.complete(data, "v", near.simulator(data))
    assert np.sqrt(np.mean((whole.states["z"] - x[2]) ** 2)) < 0.02 * np.std(x[2])


def test_the_rate_of_a_position_has_its_unit_over_that_of_time():
    data = sampled(n=60)
    model = Program({"v": ["y**3"]}, simulation=SIMULATION, rows=TrajectoryRows())
    whole = model.complete(data)
    assert (whole.unit("y"), whole.unit("v"), whole.unit("F")) == ("m", "m/s", None)
    # As samples they are what they were.
    assert whole.samples.units == data.units == {"t": "s", "y": "m"}
    assert model.complete(replace(data, units={"y": "m"})).unit("v") is None


@pytest.mark.slow
def test_an_unstable_system_is_cut_into_segments():
    t = 0.05 * np.arange(400)

    def rate(time, x):
        return [10 * (x[1] - x[0]), x[0] * (28 - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]]

    x = odeint(rate, [1.0, 2.0, 20.0], t, tfirst=True, rtol=1e-10, atol=1e-10).T
    noisy = x + 0.1 * np.random.default_rng(0).standard_normal(x.shape)
    data = Trajectories.from_arrays(t, states=dict(zip("abc", noisy, strict=True)))
    simulation = {"a": "10*(b - a)", "b": "a*(28 - c) - b", "c": "a*b"}
    model = Program({"c": ["c"]}, simulation=simulation, rows=TrajectoryRows(), discrepancy=None).near(data)[0]
    rows = model.equation_rows(data, "c")
    assert rows.operator.n_segment >= 3
    equation = model.assemble(data)["c"]
    Phi, y = np.asarray(equation.design.Phi), np.asarray(equation.design.y)
    theta = float(np.linalg.lstsq(Phi, y, rcond=None)[0][0] * equation.frame.coefficient_scale[0])
    assert theta == pytest.approx(-8 / 3, rel=0.01)


@pytest.mark.parametrize(("every", "substeps"), [(1, 1), (7, 3), (7, None)])
def test_inputs_that_are_held_act_from_their_sample_to_the_next(every, substeps):
    """Without noise nothing is left of samples but what steps lose, which was a sixth of each jump's step."""
    t, rng = 0.1 * np.arange(150), np.random.default_rng(2)
    levels = np.repeat(rng.standard_normal(150), every)[: len(t)]
    y, x = [0.3], np.array([0.3, 0.0])
    for a, b, level in zip(t[:-1], t[1:], levels[:-1], strict=True):
        oscillator = solve_ivp(
            lambda s, x, u=level: [x[1], u - 2 * x[0] - 0.15 * x[1]], (a, b), x, rtol=1e-11, atol=1e-12
        )
        x = oscillator.y[:, -1]
        y.append(x[0])
    noisy = np.array(y) + 1e-4 * rng.standard_normal(len(t))
    data = Trajectories.from_arrays(t, states={"y": noisy}, inputs={"F": levels})
    left = {}
    for interpolation in ("zoh", "linear"):
        rows = TrajectoryRows(substeps=substeps, interpolation=interpolation)
        found = program(rows=rows).equation_rows(data, "v")
        rest = found.gain * found.noise.without_starts(found.target[:, None])[:, 0]
        left[interpolation] = float(np.sqrt(np.mean(rest**2)))
    assert left["zoh"] == pytest.approx(1e-4, rel=0.2)
    assert left["linear"] > 10 * left["zoh"]


def test_each_input_goes_its_own_way_between_samples():
    """x' = -x + heater + weather: the heater stays from a sample to the next, the weather goes on."""
    t, rng = 0.2 * np.arange(120), np.random.default_rng(5)
    heater, x = np.repeat(rng.standard_normal(30), 4), [0.0]
    for a, b, level in zip(t[:-1], t[1:], heater[:-1], strict=True):
        step = solve_ivp(lambda s, x, u=level: -x + u + np.sin(2 * s), (a, b), x[-1:], rtol=1e-11, atol=1e-12)
        x.append(step.y[0, -1])
    inputs = {"heater": heater, "weather": np.sin(2 * t)}
    data = Trajectories.from_arrays(t, states={"x": np.array(x) + 1e-4 * rng.standard_normal(len(t))}, inputs=inputs)
    left = {}
    for interpolation in (("zoh", "cubic"), "zoh", "cubic"):
        rows = TrajectoryRows(interpolation=interpolation)
        model = Program({"x": ["x"]}, simulation={"x": "-x + heater + weather"}, discrepancy=None, rows=rows)
        found = model.equation_rows(data, "x")
        rest = found.gain * found.noise.without_starts(found.target[:, None])[:, 0]
        left[interpolation] = float(np.sqrt(np.mean(rest**2)))
    assert left["zoh", "cubic"] == pytest.approx(1e-4, rel=0.2)
    assert min(left["zoh"], left["cubic"]) > 10 * left["zoh", "cubic"]
    with pytest.raises(InputError, match="or one of these for each input"):
        TrajectoryRows(interpolation=("zoh", "spline"))
    with pytest.raises(InputError, match="3 interpolations for 2 inputs"):
        replace(model, rows=TrajectoryRows(interpolation=("zoh",) * 3)).equation_rows(data, "x")


def test_a_path_does_not_leap_with_its_input():
    """x' = -x + z, z' = -0.3 z + sqrt(u), u held; the first path is a filter's, which is pulled at samples."""
    t, rng = 0.1 * np.arange(60), np.random.default_rng(0)
    u = np.where((t > 2) & (t < 4), 1.0, 0.0)

    def rate(time, x):
        return [x[1] - x[0], np.sqrt(u[min(int(time / 0.1 + 1e-9), 59)]) - 0.3 * x[1]]

    x = solve_ivp(rate, (0, t[-1]), [0.5, 0.0], t_eval=t, rtol=1e-9, atol=1e-9, max_step=0.02).y[0]
    data = Trajectories.from_arrays(t, states={"x": x + 0.05 * rng.standard_normal(60)}, inputs={"u": u})
    rows = TrajectoryRows(interpolation="zoh")
    model = Program({"z": ["z"]}, simulation={"x": "z - x", "z": "sqrt(u)"}, rows=rows, discrepancy=None)
    nodes = model.rows.nodes(data, "z", model.simulator(data))
    twice = np.flatnonzero(np.diff(nodes.time) == 0)
    assert len(twice) == 4
    for name in ("x", "z"):
        np.testing.assert_allclose(np.diff(nodes.column(name))[twice], 0.0, atol=1e-9)
    design = model.near(data)[0].assemble(data)["z"].design
    assert np.all(np.isfinite(np.asarray(design.Phi))) and np.all(np.isfinite(np.asarray(design.y)))


@pytest.mark.parametrize(
    "growth",
    ["300*v**3", "40*v", *(pytest.param(each, marks=pytest.mark.slow) for each in ("30*v**3", "5*y**3*v**2"))],
)
@pytest.mark.parametrize("process_noise", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_where_equations_grow_beyond_bounds_rows_are_finite_or_refused(growth, process_noise):
    simulation = {"y": "v", "v": f"F - 2*y + {growth}"}
    rows = TrajectoryRows(process_noise=process_noise)
    model = Program({"v": ["y"]}, simulation=simulation, rows=rows, discrepancy=None)
    try:
        found = model.equation_rows(sampled(**CUBIC, noise=0.05, n=200), "v")
    except InputError as error:
        assert "No path through the samples" in str(error)
    else:
        whole = found.whiten(np.column_stack([found.target / found.scale, found.noise.starts]))
        assert np.all(np.isfinite(whole))


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: TrajectoryRows(substeps=0), "must be between 1 and 1000"),
        (
            lambda: Program({"v": ["y"]}, simulation={"v": "-y"}, rows=TrajectoryRows()).complete(sampled(n=50)),
            "path of 'y' cannot be followed",
        ),
        (lambda: program().complete(sampled(n=5)), "has 5 samples, too few for a path of 2 states, which needs 6"),
    ],
)
def test_what_cannot_be_used_is_refused(build, message):
    with pytest.raises(InputError, match=message):
        build()


def test_the_discrepancy_takes_what_no_term_does():
    data = sampled(hidden=lambda y, v: 0.5 * np.exp(-((y - 0.4) ** 2) / 0.05), noise=0.01)
    gp = OrthogonalGP(variables=("y",), features=20)
    model = program(terms=("v",), discrepancy=gp)
    equation = model.assemble(data)["v"]
    Psi, y = np.asarray(equation.design.Psi), np.asarray(equation.design.y)
    weight = np.linalg.solve(Psi.T @ Psi + 1e-4 * len(y) * np.eye(Psi.shape[1]), Psi.T @ y)
    at = np.linspace(-0.6, 0.9, 40)
    psi = equation.frame.rows({"y": at, "v": 0 * at, "F": 0 * at})[1]
    found = equation.frame.target_scale * np.asarray(psi) @ weight
    assert np.corrcoef(found, 0.5 * np.exp(-((at - 0.4) ** 2) / 0.05))[0, 1] > 0.95


def correlated(n, seed=5):
    e = np.random.default_rng(seed).standard_normal(n)
    for i in range(1, n):
        e[i] = 0.9 * e[i - 1] + np.sqrt(1 - 0.9**2) * e[i]
    return e


def test_noise_that_a_fit_asks_for_is_found_on_samples_and_held_in_the_data():
    data = sampled(**CUBIC, noise=0.0, bend=lambda t, y: y + 0.03 * np.std(y) * correlated(len(y)))
    near, whole = program(noise=Noise(correlation="fit")).near(data)
    found, held = near.with_noise_found(whole)
    # ρ = 0.9 at steps of 0.1 is a correlation time of 0.95
    assert found.noise.found["v"]["correlation_time"] == pytest.approx(0.95, rel=0.5)
    rows = found.equation_rows(held, "v")
    assert not rows.noise.error.independent and held.noise["v"].n_obs == 400
    (_,), (white,) = estimate(*program().near(data))
    (theta,), (sd,) = estimate(found, held)
    assert abs(theta + 0.3) < 4 * sd and sd > 1.5 * white


def test_noise_of_several_sensors_is_not_found_yet():
    one = program().complete(sampled(**CUBIC, noise=0.0))
    two = Trajectories.from_arrays(
        one.time, states={"y": one.states["y"], "v": one.states["v"]}, inputs={"F": one.inputs["F"]},
        units=dict(one.units),
    )  # fmt: skip
    with pytest.raises(InputError, match="Noise of several sensors at once"):
        program(noise=Noise(correlation="fit")).near(two)


def shaken(push=0.05, seed=0):
    """The oscillator with a cubic spring under random pushes, its displacement with 2 % noise."""
    rng, h, n = np.random.default_rng(seed), 0.01, 4000
    x, path = np.array([0.3, 0.0]), []
    for k in range(n):
        if k % 10 == 0:
            path.append(x[0])
        acceleration = force(k * h) - 2 * x[0] - 0.15 * x[1] - 0.3 * x[0] ** 3
        v = x[1] + h * acceleration + push * np.sqrt(h) * rng.standard_normal()
        x = np.array([x[0] + h * (x[1] + v) / 2, v])
    y, t = np.array(path), 0.1 * np.arange(n // 10)
    shown = y + 0.02 * np.std(y) * rng.standard_normal(len(y))
    return Trajectories.from_arrays(t, states={"y": shown}, inputs={"F": force(t)}, units={"t": "s", "y": "m"})


@pytest.mark.slow
def test_an_unknown_force_is_found_and_makes_coefficients_as_uncertain_as_it_does():
    inside = 0
    for seed in range(6):
        near, whole = program(noise=Noise(force="fit")).near(shaken(seed=seed))
        found, held = near.with_noise_found(whole)
        # Root of the pushes' variance in a unit of time, if the sensor is as noisy as it seemed.
        assert found.noise.found["v"]["force"] == pytest.approx(0.05, rel=0.5)
        assert 0.3 < found.noise.found["v"]["force_share"] < 1
        (theta,), (sd,) = estimate(found, held)
        (_,), (white,) = estimate(program(rows=near.rows), whole)
        inside += abs(theta + 0.3) < 1.645 * sd
        assert sd > 1.5 * white
    assert inside >= 4


def test_where_no_force_acts_none_is_found():
    near, whole = program(noise=Noise(force="fit")).near(sampled(**CUBIC, noise=0.02))
    found, held = near.with_noise_found(whole)
    assert found.rows.force == 0.0 and found.noise.found["v"] == {}
    np.testing.assert_allclose(estimate(found, held), estimate(near, whole))


def test_a_force_belongs_to_the_rows_and_changes_no_path():
    data = program().complete(sampled(**CUBIC))
    quiet, moved = (program(rows=TrajectoryRows(force=force)).equation_rows(data, "v") for force in (0.0, 1e-3))
    np.testing.assert_array_equal(moved.simulated, quiet.simulated)
    assert moved.noise.log_det > quiet.noise.log_det
    np.testing.assert_allclose(moved.noise.sensors.whiten(np.eye(400)), quiet.noise.error.whiten(np.eye(400)))


def test_rates_have_no_path_that_a_force_moves_and_one_sensor_not_two_noises():
    data = program().complete(sampled(**CUBIC))
    rates = Trajectories.from_arrays(
        data.time, states=dict(data.states), inputs=dict(data.inputs), derivatives=dict(data.derivatives)
    )
    model = Program({"v": ["y**3"]}, simulation=SIMULATION, discrepancy=None, noise=Noise(force="fit"))
    with pytest.raises(InputError, match="needs rows of samples"):
        model.assemble(rates)
    with pytest.raises(InputError, match="not told apart"):
        Noise(force="fit", correlation="fit")
    with pytest.raises(InputError, match="must be None or 'fit'"):
        Noise(force="strong")
    with pytest.raises(InputError, match="must be a number, 0 or above"):
        TrajectoryRows(force=-1.0)


def test_where_all_of_an_equation_is_learned_turns_go_on_till_it_settles():
    data = sampled(hidden=lambda y, v: -0.5 * y**3, noise=0.01, n=2000)
    model = Program({"v": ["y", "v", "F", "y**3"]}, simulation={"y": "v"}, discrepancy=None, rows=TrajectoryRows())
    near, completed = model.near(data)
    truth = {"y": -2.0, "v": -0.15, "F": 1.0, "y**3": -0.5}
    assert dict(near.rows.added) == pytest.approx(truth, abs=0.02)
    # One more turn leaves all coefficients where they are, to a tenth of what they are known to.
    (equation,) = near.assemble(completed).values()
    assert equation.moved([(Term(text), value) for text, value in near.rows.added]) < 0.1


def test_coefficients_that_do_not_settle_are_refused(monkeypatch):
    monkeypatch.setattr(near_module, "UNSETTLED_BEYOND", -1.0)
    with pytest.raises(InputError, match="do not settle"):
        program().near(sampled(noise=0.01, n=100))


def test_turns_that_lead_where_no_path_can_be_followed_leave_the_path_of_the_force(monkeypatch):
    """Far from the samples terms may look alike, or the equations leave their domain: nobody has asked for that."""

    def lost(*_):
        raise InputError("Collinear terms")

    data, model = sampled(noise=0.01, n=60), program()
    beside = replace(model, rows=model.rows.around([(Term("y**3"), 0.1)]))
    monkeypatch.setattr(near_module, "_turned", lost)
    monkeypatch.setattr(near_module, "_nearer", lambda *_: beside)
    assert model.near(data)[0].rows == beside.rows
    monkeypatch.setattr(near_module, "_nearer", lambda *_: model)
    with pytest.raises(InputError, match="of v do not settle: no path can be followed where they have gone. Leave"):
        model.near(data)
    # What is refused of the model itself is refused as ever.
    twice = program(("y**3", "2*y**3"))
    monkeypatch.setattr(near_module, "_nearer", lambda *_: twice)
    with pytest.raises(InputError, match="are the same up to a constant factor"):
        twice.near(data)


@pytest.mark.parametrize("process_noise", [True, False])
def test_a_small_jump_of_the_simulation_is_followed_as_one_of_a_term_is(process_noise):
    """Dry friction in a machine that is driven hard: 4 % of its acceleration, and all that rows are of."""
    t, rng = np.arange(0, 20, 0.025), np.random.default_rng(0)

    def force_of(s):
        return 20 * np.sin(2.8 * s) + 18 * np.sin(4.5 * s + 1) + 15 * np.sin(6 * s + 2)

    def rate(s, x):
        return [x[1], force_of(s) - 24 * x[0] - 0.46 * x[1] - 0.6 * np.tanh(x[1] / 1e-3)]

    y = odeint(rate, [0.1, 0.0], t, tfirst=True, rtol=1e-8, atol=1e-10, hmax=2e-3)[:, 0]
    data = Trajectories.from_arrays(t, states={"y": y + 1e-3 * rng.standard_normal(len(t))}, inputs={"F": force_of(t)})
    plain, left = "F - 24*y - 0.46*v", []
    for text, added in ((f"{plain} - 0.6*sign(v)", ()), (plain, (("sign(v)", -0.6),))):
        rows = TrajectoryRows(added=added, process_noise=process_noise, interpolation="cubic")
        model = Program({"v": ["sign(v)"]}, simulation={"y": "v", "v": text}, rows=rows, discrepancy=None)
        found = model.assemble(data)["v"].rows
        known = found.table(lambda c: np.sign(c["v"])[:, None])(np.arange(found.n_row))[:, 0]
        residual = found.target + (0.6 * known if added else 0.0)
        left.append(float(np.std(found.noise.without_starts(residual[:, None])) * found.gain))
    # What is left is the sensor's noise, known to 2.5 % from 800 samples: four of that.
    assert left == pytest.approx([1e-3, 1e-3], rel=0.1)


def test_a_record_at_rest_is_followed_and_one_of_nothing_is_refused():
    """A ring-down that has ended, of a sensor with an offset and of one without."""
    moving = sampled(n=100)
    nothing = np.zeros(moving.n_obs)
    rest = replace(moving, states={"y": nothing + 0.2}, inputs={"F": nothing + 0.4})
    near, _ = program().near(moving)
    assert np.max(np.abs(near.complete(rest).states["v"])) < 1e-6
    with pytest.raises(InputError, match="y is 0 at every sample: there is no motion to follow. Leave these rows out"):
        near.complete(replace(rest, states={"y": nothing}))
