"""FMUs for Co-Simulation: rates at points, and what is refused."""

import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.inference.kept.model_record import describe, rebuild
from bayes_greybox.physics.simulation.reading import simulation_of

sys.path.insert(0, str(Path(__file__).parent))
from pendulum import NAMES, STEPPED, build  # noqa: E402

GIVEN = {"interface": "CoSimulation"}


def points(n=9):
    rng = np.random.default_rng(3)
    return np.linspace(0, 1, n), rng.normal(size=(n, 2)), rng.normal(size=(n, 1))


def expected(x, u, c=10.0):
    return np.column_stack([x[:, 1], u[:, 0] - c * (x[:, 0] - 1.1)])


# The FMU takes a step of Euler's method in each of its h = 0.001 s. By one length alone rates would be off by h/2 times
# their own rates, some 5e-3; by two they are off by h²c/6 = 1.7e-6 of themselves, which are 33 at most.
@pytest.mark.parametrize(("described", "error"), [(GIVEN, 1e-12), (STEPPED, 1e-4)])
def test_rates_are_those_of_the_equations(tmp_path, described, error):
    t, x, u = points()
    given = bg.FMU(build(tmp_path, **described), states=NAMES, outputs={"a": "der(mass.v)"})
    own = simulation_of(given, ("s", "v"), ("F",), ("a",))
    np.testing.assert_allclose(own.rates(t, x, u), expected(x, u), rtol=0, atol=error)
    np.testing.assert_allclose(jax.jit(jax.vmap(own.rate))(t, x, u), expected(x, u), rtol=0, atol=error)
    np.testing.assert_allclose(own.jacobian(t, x, u)[3], [[0, 1], [-10, 0]], rtol=0, atol=max(error, 1e-6))
    np.testing.assert_allclose(own.output("a", t, x, u), expected(x, u)[:, 1], rtol=1e-12)
    # A point does not know of those before it, and other parameters are set.
    np.testing.assert_array_equal(own.rates(t[:1], x[:1], u[:1]), own.rates(t, x, u)[:1])
    soft = bg.FMU(given.path, states=NAMES, parameters={"spring.c": 2.0})
    found = simulation_of(soft, ("s", "v"), ("F",)).rates(t, x, u)
    np.testing.assert_allclose(found, expected(x, u, 2.0), rtol=0, atol=error)
    assert ("variables of the FMU" in str(given)) == (described is GIVEN)
    assert ("over steps of 0.001 s" in str(given)) == (described is STEPPED)
    assert "central differences: a Co-Simulation" in str(given)


def test_a_parameter_may_set_the_start_of_a_state(tmp_path):
    t, x, u = points()
    made = build(tmp_path, start="z(c)[2] = z(c)[7]", **{**GIVEN, "s": "calculated"})
    with pytest.raises(
        bg.InputError, match=r"'mass.s' .* cannot be set .* starts=\{'s': 'parameter'\}.*Model Exchange"
    ):
        bg.FMU(made, states=NAMES)
    given = bg.FMU(made, states=NAMES, starts={"s": "s.start"})
    np.testing.assert_allclose(simulation_of(given, ("s", "v"), ("F",)).rates(t, x, u), expected(x, u), rtol=1e-12)
    data = bg.Trajectories.from_arrays(np.arange(4.0), states={"s": [0.0, 1, 3, 2], "v": [1.0, 2, 0, 1]})
    held = bg.FMU(made, states=NAMES, starts={"s": "s.start"}, parameters={"F": 0.0}, step=0.01)
    assert rebuild(describe(bg.GreyBox({"v": ["v"]}, simulation=held), data)).simulation == held


def test_a_state_that_starts_elsewhere_is_refused(tmp_path):
    made = build(tmp_path, start="z(c)[2] = 0.5", **GIVEN)
    own = simulation_of(bg.FMU(made, states=NAMES), ("s", "v"), ("F",))
    with pytest.raises(bg.InputError, match=r"'mass.s' .* is 0.5 where its start was set to .*starts=.*Model Exchange"):
        own.rates(*points())


@pytest.mark.parametrize("described", [GIVEN, STEPPED])
def test_states_that_are_not_named_are_found_out(tmp_path, described):
    own = simulation_of(bg.FMU(build(tmp_path, hidden="5", **described), states=NAMES), ("s", "v"), ("F",))
    if described is GIVEN:
        own = simulation_of(bg.FMU(own.given.path, states=NAMES, step=0.01), ("s", "v"), ("F",))
    with pytest.raises(bg.InputError, match="has more states than it was given.*name all of them"):
        own.rates(*points())


def test_steps_that_are_too_long_are_refused(tmp_path):
    given = bg.FMU(build(tmp_path, **{**STEPPED, "experiment": ""}), states=NAMES, step=0.2)
    with pytest.raises(bg.InputError, match="Steps of 0.2 s .* are too long or too rough.*step="):
        simulation_of(given, ("s", "v"), ("F",)).rates(*points())


# By differences the rate is 40 ε s0 / 6h at most, which is rounding, and by half as long steps it is another one.
@pytest.mark.parametrize("s0", [0.7, 30.1])
def test_a_state_that_stands_still_has_its_rates(tmp_path, s0):
    given = bg.FMU(build(tmp_path, **STEPPED), states=NAMES, parameters={"fixed.s0": s0, "F": 0.0})
    rest = np.tile([s0, 0.0], (9, 1))
    own = simulation_of(given, ("s", "v"), ())
    np.testing.assert_allclose(own.rates(np.linspace(0, 1, 9), rest, np.zeros((9, 0))), 0, atol=1e-11 * s0)


# Of its own steps of Euler's method, d = 0.001 s, the rates lack d/2 of their own rates, whatever the length h
# of those it is told to take, while h > d. With h = d it is one step in each, and only that of h²c/6 is left.
def test_steps_within_the_steps_are_not_extrapolated_away(tmp_path):
    t, x, u = points()
    rates, made = expected(x, u), build(tmp_path, inner="0.001", **{**STEPPED, "experiment": ""})
    second = expected(rates, np.zeros_like(u)) - [0.0, 11.0]

    def found(step):
        return simulation_of(bg.FMU(made, states=NAMES, step=step), ("s", "v"), ("F",)).rates(t, x, u)

    np.testing.assert_allclose(found(0.004) - rates, -0.0005 * second, rtol=0.01, atol=1e-4)
    np.testing.assert_allclose(found(0.001), rates, rtol=0, atol=1e-4)


def test_mistakes_are_named(tmp_path):
    stepped = build(tmp_path / "a", **STEPPED)
    with pytest.raises(bg.InputError, match="does not declare its states: name all of them"):
        bg.FMU(stepped)
    with pytest.raises(bg.InputError, match="did you mean 'mass.s'"):
        bg.FMU(stepped, states={"s": "mas.s"})
    with pytest.raises(bg.InputError, match="declares no rate of 'mass.s'.*step=0.001"):
        bg.FMU(build(tmp_path / "b", **{**STEPPED, "experiment": ""}), states=NAMES)
    with pytest.raises(bg.InputError, match="step=0.2 s .* is longer than the 0.001 s"):
        bg.FMU(stepped, states=NAMES, step=0.2)
    with pytest.raises(bg.InputError, match="step=-1.0 .* seconds above 0"):
        bg.FMU(stepped, states=NAMES, step=-1.0)
    with pytest.raises(bg.InputError, match="names 'x', which is no state: s, v"):
        bg.FMU(stepped, states=NAMES, starts={"x": "s.start"})
    with pytest.raises(bg.InputError, match="'s.start' .* is a parameter and the start of 's'"):
        bg.FMU(stepped, states=NAMES, starts={"s": "s.start"}, parameters={"s.start": 1.0})
    with pytest.raises(bg.InputError, match="run by Model Exchange: starts and step"):
        bg.FMU(build(tmp_path / "c"), states=NAMES, step=0.1)


def test_a_point_that_is_refused_is_nan_and_the_next_one_is_not(tmp_path):
    own = simulation_of(bg.FMU(build(tmp_path, **GIVEN), states=NAMES, parameters={"F": 0.0}), ("s", "v"), ())
    found = own.rates(np.zeros(3), np.array([[1.0, 0], [99.0, 0], [1.0, 0]]), np.zeros((3, 0)))
    np.testing.assert_array_equal(np.isnan(found).any(axis=1), [False, True, False])
