"""From a description and data to the design: what is refused, and how the simulation is read."""

import math
import os
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from numpyro.handlers import seed, trace

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.gp.discrepancy import EXACT_LIMIT, OrthogonalGP
from bayes_greybox.model.noise.asked import Noise, varies_with
from bayes_greybox.model.priors import CustomPrior, Laplace
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows
from bayes_greybox.running.errors import InputError


def _data(n=40, derivatives=("v",), **changes):
    rng = np.random.default_rng(0)
    y, v, F = rng.uniform(0.1, 1, (3, n))
    columns = {"y": y, "v": v} | {k: x for k, x in changes.items() if k in ("y", "v")}
    rates = {"v": F - columns["y"] - 0.1 * v + 0.05 * rng.standard_normal(n), "y": v}
    return Trajectories.from_arrays(
        np.arange(float(n)),
        states=columns,
        inputs={"F": changes.get("F", F)},
        derivatives={k: rates[k] for k in derivatives},
        constant="keep",
    )


@pytest.mark.parametrize(
    ("dictionary", "options", "data", "words"),
    [
        ({"w": ["y"]}, {}, {}, "equation for 'w', which is not a state.*states: y, v"),
        ({"vv": ["y"]}, {}, {}, "did you mean 'v'"),
        ({"a": ["y"]}, {}, {}, r"rate of y, or of another of them: data\.differentiate\(rates=\{'y': 'a'\}\)"),
        ({"v": ["y"]}, {"simulation": {"a": "y"}}, {}, r"data\.differentiate\(rates=\{'y': 'a'\}\)"),
        ({"y": ["v"]}, {}, {}, r"no derivative of 'y'.*differentiate"),
        ({"v": ["y", "z"]}, {}, {}, "unknown name 'z'"),
        ({"v": ["y", "v", "y**2", "y*v"]}, {}, {"n": 3}, "4 terms but only 3 rows"),
        ({"v": ["y", "v", "y + v"]}, {}, {}, "Collinear terms in equation 'v'.*'y'"),
        ({"v": ["log(y - 5)"]}, {}, {}, r"'log\(y-5\)' of equation 'v' is not finite"),
        ({"v": ["y", "F"]}, {"discrepancy": None}, {"F": np.zeros(40)}, "Term 'F' of equation 'v' is zero"),
        ({"v": ["y"]}, {}, {"F": np.zeros(40)}, "'F', which is constant on all the data.*variables"),
        (
            {"v": ["y"]},
            {"discrepancy": OrthogonalGP(path="exact")},
            {"n": EXACT_LIMIT + 1},
            "use path='hsgp'",
        ),
        (
            {"v": ["y"]},
            {"discrepancy": OrthogonalGP(variables=("q",))},
            {},
            "'q', which is neither a state nor",
        ),
        ({"v": ["y"]}, {"discrepancy": OrthogonalGP(features=(4, 4))}, {}, "one for each of the 3 variables"),
        ({"v": ["y"]}, {"simulation": {"w": "y"}}, {}, "simulation has an equation for 'w'"),
        ({"v": ["y"]}, {"simulation": {"v": "log(y - 5)"}}, {}, "simulation of 'v' is not finite"),
        ({"v": ["y"]}, {"simulation": lambda t, x, u: jnp.stack([x[1]])}, {}, "rates for 2 states"),
        ({"v": ["y"]}, {"simulation": lambda t, x, u: jnp.zeros(3)}, {}, "rates for 2 states"),
    ],
)
def test_bad_input_is_named(dictionary, options, data, words):
    program = Program(dictionary, **options)
    with pytest.raises(InputError, match=words):
        program.assemble(_data(**data))


def _map(n=40):
    """A damper's force over its speed, and the same force once more."""
    rng = np.random.default_rng(0)
    v = rng.uniform(-1, 1, n)
    force = 3 * v + 0.5 * v**3 + 0.05 * rng.standard_normal(n)
    return Trajectories.from_arrays(np.arange(float(n)), states={"v": v}, outputs={"R": force, "S": 2 * force})


def test_an_output_is_learned_from_rows_without_a_derivative():
    program = Program({"R": ["v**3"]}, simulation={"R": "3*v"}, discrepancy=None)
    data = _map()
    (equation,) = program.assemble(data).values()
    rows = equation.rows
    np.testing.assert_allclose(rows.target, data.rate("R") - 3 * data.states["v"])
    assert rows.output and rows.label == "R" and "simulated R" in varies_with(rows)
    # Data that are to be predicted need not hold it.
    bare = Trajectories.from_arrays(data.time, states=dict(data.states))
    assert program.complete(bare) is bare and program.simulator(bare, lacking=True).equations == ("R",)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Program({"Q": ["v"]}), "'Q', which is neither a state nor an output .*; states: v; outputs: R, S"),
        (lambda: Program({"S": ["R"]}), "unknown name 'R'"),
        (lambda: Program({"R": ["v"]}, simulation={"Q": "v"}), "simulation has an equation for 'Q', which is neither"),
        (lambda: Program({"R": ["v"]}, simulation=lambda t, x, u: x), "not the output 'R': give formulas"),
        (lambda: Program({"R": ["v"]}, rows=TrajectoryRows()), "those of states, and 'R' is an output: leave it out"),
        (lambda: Program({"R": ["v"]}, simulation={"R": "v"}, noise=Noise(force="fit")), "an output: leave it out"),
    ],
)
def test_what_cannot_be_said_of_an_output_is_refused(make, words):
    with pytest.raises(InputError, match=words):
        make().assemble(_map())


def test_an_output_that_is_known_exactly_leaves_nothing_to_learn():
    data = _map()
    exact = replace(data, derivatives={"R": 3 * data.states["v"]})
    with pytest.raises(InputError, match="equals the measured R exactly: there is nothing to learn"):
        Program({"R": ["v**3"]}, simulation={"R": "3*v"}).assemble(exact)


def test_term_that_is_infinite_only_between_the_data_is_refused_for_the_box():
    x = np.concatenate([np.linspace(-1, -0.1, 20), np.linspace(0.1, 1, 20)])
    data = Trajectories.from_arrays(np.arange(40.0), states={"x": x}, derivatives={"x": 1 / x})
    gp = OrthogonalGP(measure="box", features=5)
    with pytest.raises(InputError, match="'sqrt.*' is not finite on the whole box.*measure='empirical'"):
        Program({"x": ["x", "sqrt(x**2 - 0.005)"]}, discrepancy=gp).assemble(data)
    empirical = OrthogonalGP(features=5)
    assert Program({"x": ["x", "sqrt(x**2 - 0.005)"]}, discrepancy=empirical).assemble(data)


def test_a_model_without_a_dictionary_has_nothing_to_fit_and_says_where_to_look():
    with pytest.raises(InputError, match="no dictionary.*find_missing_effects"):
        Program({}).assemble(_data())


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Program({"v": ["y"]}, noise_floor=0.0), "noise_floor=0"),
        (
            lambda: Program({"v": ["y"]}, noise_floor=5e-7),
            "between 1e-06 and 1: below that range, rounding decides which terms",
        ),
        (lambda: Program({"v": ["y"]}, noise=-1.0), "noise=-1"),
        (lambda: OrthogonalGP(kernel="periodic"), "kernel='periodic'"),
        (lambda: OrthogonalGP(boundary=1.0), r"boundary=1.0\) must exceed 1, the edge of the data\."),
        (lambda: OrthogonalGP(boundary=(2.0, 0.5)), r"boundary=\(2.0, 0.5\)\) must exceed 1, the edge of the data\."),
        (lambda: OrthogonalGP(boundary=float("nan")), r"boundary=nan\) must exceed 1, the edge of the data\."),
        (lambda: OrthogonalGP(seed=-1), r"seed=-1\) must be at least 0"),
        (lambda: OrthogonalGP(features=10**30), "of at most 10,000"),
        (lambda: OrthogonalGP(features=(4, 0)), r"features=\(4, 0\)\) should be a positive whole number, or a list"),
        (lambda: OrthogonalGP(variant="printed", path="exact", monte_carlo=0), r"monte_carlo=0\) must be at least 1"),
        (lambda: Program({"v": ["y"]}, prior=Laplace), "is not a prior: give one such as bg.Laplace"),
        (lambda: OrthogonalGP(variables=()), r"variables=\(\)\) must name one variable or more"),
        (lambda: OrthogonalGP(length_scale=0.0), "length_scale=0.0"),
        (lambda: OrthogonalGP(variant="printed"), "not a covariance: give path='exact'"),
    ],
)
def test_bad_settings_are_named(make, words):
    with pytest.raises(InputError, match=words):
        make()


@pytest.mark.parametrize(
    ("settings", "field", "value", "words"),
    [
        (Program({"v": ["y"]}), "prior", "laplace", "prior='laplace'.* is not a prior: give one such as bg.Laplace"),
        (Program({"v": ["y"]}), "discrepancy", "none", "discrepancy='none'.* must be bg.OrthogonalGP"),
        (OrthogonalGP(), "variables", "ydot", r"variables='ydot'\) must name one variable or more"),
        (OrthogonalGP(), "features", 8.0, "features=8.0.* must be whole numbers"),
    ],
)
def test_settings_of_a_wrong_kind_are_named(settings, field, value, words):
    # Around the type checks that these tests run with and users do without.
    object.__setattr__(settings, field, value)
    with pytest.raises(InputError, match=words):
        settings.__post_init__()


def _plain_numpy(t, x, u):
    y, v = x
    return np.array([v, u[0] - y - 0.1 * v]) if y > 0 else np.array([v, 0.0])


def _plain_math(t, x, u):
    return [x[1], u[0] - math.sqrt(x[0] ** 2) - 0.1 * x[1]]


def _in_place(t, x, u):
    out = np.zeros(2)
    out[0] = x[1]
    out[1] = u[0] - x[0] - 0.1 * x[1]
    return out


@pytest.mark.parametrize(
    "simulation",
    [
        {"y": "v", "v": "F - y - 0.1*v"},
        lambda t, x, u: jnp.stack([x[1], u[0] - x[0] - 0.1 * x[1]]),
        lambda t, x, u: [x[1], u[0] - x[0] - 0.1 * x[1]],
        _plain_numpy,
        _plain_math,
        _in_place,
    ],
    ids=["expressions", "jax", "list", "numpy", "math", "in-place"],
)
def test_simulation_is_taken_off_the_rate(simulation):
    data = _data()
    equation = Program({"v": ["y**2"]}, simulation=simulation, discrepancy=None).assemble(data)["v"]
    y, v, F = (data.columns[name] for name in ("y", "v", "F"))
    left = data.derivatives["v"] - (F - y - 0.1 * v)
    assert equation.frame.target_scale == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-12)


def test_a_simulation_that_fails_is_quoted():
    def broken(t, x, u):
        return {"v": 1.0}["w"]

    with pytest.raises(InputError, match=r"simulation failed on the data with KeyError: 'w'.*\(t, x, u\)"):
        Program({"v": ["y"]}, simulation=broken).assemble(_data())


def test_noise_floor_knows_rounded_values_from_others():
    rng = np.random.default_rng(1)
    x = rng.uniform(-1, 1, 60)

    def floor(rate):
        data = Trajectories.from_arrays(np.arange(60.0), states={"x": x}, derivatives={"x": rate})
        equation = Program({"x": ["x"]}, discrepancy=None).assemble(data)["x"]
        return float(equation.design.noise_floor) * equation.frame.target_scale

    rate = 3 * x + 1
    rms = np.sqrt(np.mean(rate**2))
    assert floor(rate) == pytest.approx(1e-4 * rms, rel=1e-9)
    assert floor(np.linspace(-1, 1, 60)) == pytest.approx(1e-4 * np.std(np.linspace(-1, 1, 60)), rel=1e-9)
    rounded = np.round(rate / 0.2) * 0.2
    expected = np.hypot(1e-4 * np.sqrt(np.mean(rounded**2)), 0.2 / np.sqrt(12))
    assert floor(rounded) == pytest.approx(expected, rel=1e-9)
    # A relay: two exact levels are no rounding.
    relay = np.where(x > 0, 2.0, -2.0)
    assert floor(relay) == pytest.approx(2e-4, rel=1e-9)
    # What was recorded is rounded, whatever a simulation takes off it.
    data = Trajectories.from_arrays(np.arange(60.0), states={"x": x}, derivatives={"x": rounded})
    equation = Program({"x": ["x"]}, simulation={"x": "sin(3*x)"}, discrepancy=None).assemble(data)["x"]
    scale = equation.frame.target_scale
    assert float(equation.design.noise_floor) * scale == pytest.approx(
        np.hypot(1e-4 * scale, 0.2 / np.sqrt(12)), rel=1e-9
    )


def test_simulation_equal_to_the_measurement_leaves_nothing_to_learn():
    data = _data(derivatives=("y",))
    with pytest.raises(InputError, match="nothing to learn"):
        Program({"y": ["v**2"]}, simulation={"y": "v"}).assemble(data)
    # As exact as rounding lets it be
    with pytest.raises(InputError, match="nothing to learn"):
        Program({"y": ["v**2"]}, simulation={"y": "v*0.3 + v*0.7"}).assemble(data)


def test_a_callable_may_return_one_rate_as_a_number():
    x = np.linspace(0, 1, 30)
    data = Trajectories.from_arrays(np.arange(30.0), states={"x": x}, derivatives={"x": x**2 + 1})
    program = Program({"x": ["x"]}, simulation=lambda t, x, u: -x, discrepancy=None)
    expected = np.sqrt(np.mean((x**2 + 1 + x) ** 2))
    assert program.assemble(data)["x"].frame.target_scale == pytest.approx(expected, rel=1e-12)


def test_two_equations_have_their_own_sites():
    program = Program({"y": ["v"], "v": ["y", "v"]}, discrepancy=OrthogonalGP(features=3))
    designs = program.designs(_data(derivatives=("y", "v")))
    sites = trace(seed(program.numpyro_model, 0)).get_trace(designs)
    for site in ("noise", "sigma", "amplitude", "length_scale", "pi", "tau", "y"):
        assert f"y_{site}" in sites and f"v_{site}" in sites
    assert sites["v_length_scale"]["value"].shape == (3,)


def test_discrepancy_can_be_left_out_or_limited_to_some_variables():
    data = _data()
    none = Program({"v": ["y"]}, discrepancy=None).designs(data)["v"]
    assert none.Psi.shape[1] == 0 and none.Phi.shape[1] == 1
    some = Program({"v": ["y"]}, discrepancy=OrthogonalGP(variables=("v",), features=5)).designs(data)["v"]
    assert some.Psi.shape[1] == 5 and some.frequency.shape == (5, 1)


def test_coefficients_return_to_the_users_units():
    data = _data()
    frame = Program({"v": ["y", "v**2"]}).assemble(data)["v"].frame
    theta = np.array([0.3, -2.0])
    Phi, Psi = frame.rows(data.columns)
    user = np.stack([data.columns["y"], data.columns["v"] ** 2], axis=1) @ (theta * frame.coefficient_scale)
    np.testing.assert_allclose(np.asarray(Phi @ theta) * frame.target_scale, user, rtol=1e-12)
    position = np.asarray(frame.position(data.columns))
    np.testing.assert_allclose(position.min(0), -1, atol=1e-12)
    np.testing.assert_allclose(position.max(0), 1, atol=1e-12)
    assert np.all(frame.inside(data.columns))
    assert not frame.inside({name: 10 * column for name, column in data.columns.items()}).all()


def test_terms_that_a_spectral_derivative_wipes_out_are_refused():
    t = np.arange(64) * (2 * np.pi / 64)
    data = Trajectories.from_arrays(t, states={"y": np.sin(t), "v": np.cos(2 * t)}).differentiate("spectral")
    for terms in (["y", "1"], ["y", "1", "v"]):
        with pytest.raises(InputError, match="Term '1' of equation 'v' leaves no trace.*method='savgol'"):
            Program({"v": terms}, discrepancy=None).assemble(data)
    with pytest.raises(InputError, match="Collinear terms"):
        Program({"v": ["y", "y + 1"]}, discrepancy=None).assemble(data)
    assert Program({"v": ["y", "v"]}, discrepancy=None).assemble(data)


@pytest.mark.parametrize("name", ["gamma", "theta", "weight", "f", "term", "variable", "basis"])
def test_sites_of_a_users_prior_cannot_take_names_of_the_results(name):
    prior = CustomPrior(lambda n: numpyro.sample(name, dist.HalfNormal(1.0).expand([n]).to_event(1)))
    program = Program({"v": ["y"]}, prior=prior, discrepancy=None)
    with pytest.raises(InputError, match=f"site called '{name}', which the results need"):
        program.gibbs_equations(program.designs(_data()))


@pytest.mark.skipif(
    os.environ.get("BAYES_GREYBOX_TYPECHECK", "0") == "1", reason="arguments of other types are what is tried here"
)
@pytest.mark.parametrize("noise", [np.inf, np.nan, 0.0, -1.0, None, True, "1"])
def test_a_scale_of_the_noise_that_is_no_positive_number_is_refused(noise):
    with pytest.raises(InputError, match=r"GreyBox\(noise=.*\) must be a positive number, or bg.Noise"):
        Program({"v": ["y"]}, noise=noise)


@pytest.mark.parametrize("name", ["draws", "tune", "chains", "seed"])
def test_a_number_of_the_sampler_is_no_truth_value(name):
    with pytest.raises(InputError, match=f"{name}=True must be a whole number"):
        Sampling(**{name: True})
