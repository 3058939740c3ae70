"""FMUs in use: inputs that states feed, events, single points, rebuilt files, outputs as functions, exports, TOML."""

import pickle
import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fabricated import estimated, fabricate

import bayes_greybox as bg
from bayes_greybox.config.file import load_config
from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.physics.simulation.reading import simulation_of

sys.path.insert(0, str(Path(__file__).parent))
from pendulum import HELD, NAMES, build  # noqa: E402


def points(n=7):
    rng = np.random.default_rng(0)
    return np.linspace(0, 1, n), rng.normal(size=(n, 2)), np.zeros((n, 0))


def test_a_state_that_feeds_an_input_accuses_nobody(tmp_path):
    # The force is the position itself: along it, the FMU has two variables.
    given = bg.FMU(build(tmp_path), states=NAMES, inputs={"w": "F"})
    own = simulation_of(given, ("s", "v", "w"), ())
    t, x, u = points()
    x = np.column_stack([x, x[::-1, 0]])
    J = own.jacobian(t, x, u)
    assert own.warnings == () and given.derivatives.startswith("the FMU's directional")
    np.testing.assert_allclose(J[3], [[0, 1, 0], [-10, 0, 1], [0, 0, 0]], atol=1e-9)


def test_states_that_an_event_leaves_where_they_are_are_no_fault(tmp_path):
    t, x, u = points()
    rates = np.column_stack([x[:, 1], -10 * (x[:, 0] - 1.1)])
    # The FMU says that an event moves its states: once, at its start.
    first = build(
        tmp_path / "a", event="if (!z(c)[6]) { z(c)[6] = 1; z(c)[2] = 9; e->valuesOfContinuousStatesChanged = 1; }"
    )
    own = simulation_of(bg.FMU(first, states=NAMES, parameters=HELD), ("s", "v"), ())
    np.testing.assert_allclose(own.rates(t, x, u), rates, rtol=1e-12)
    # At every event, which says so and leaves them; and one that does not leave them.
    says = "e->valuesOfContinuousStatesChanged = 1; e->nextEventTimeDefined = 1"
    for k, (moves, fine) in enumerate(((says, True), (f"{says}; z(c)[3] = -z(c)[3]", False))):
        own = simulation_of(
            bg.FMU(build(tmp_path / f"b{k}", event=moves), states=NAMES, parameters=HELD), ("s", "v"), ()
        )
        found = own.rates(t, x, u)
        assert np.isnan(found).all() != fine
        if fine:
            np.testing.assert_allclose(found, rates, rtol=1e-12)


def test_differences_at_a_single_point_have_a_floor_and_only_what_is_asked_for(plant):
    own = simulation_of(bg.FMU(plant, states=NAMES), ("s", "v"), ("F",))
    tiny = np.array([1e-13, 1e-13])
    # Rounding of a rate of 11 over a step of 6e-9 is 3e-7; without a floor it would be 3000.
    found = jax.jacfwd(own.rate, 1)(jnp.zeros(()), jnp.asarray(tiny), jnp.zeros(1))
    np.testing.assert_allclose(found, [[0, 1], [-10, 0]], atol=1e-5)
    t, x, u = np.zeros(1), tiny[None], np.zeros((1, 1))
    whole, part = own.differences(t, x, u), own.differences(t, x, u, slice(1, 3))
    assert whole.shape == (1, 2, 4) and part.shape == (1, 2, 2)
    np.testing.assert_array_equal(part, whole[..., 1:3])


def test_a_file_that_is_built_again_changes_nothing_that_is_there(tmp_path):
    t, x, u = points()
    made = build(tmp_path / "here")
    given = bg.FMU(made, states=NAMES, parameters=HELD)
    before = simulation_of(given, ("s", "v"), ()).rates(t, x, u)
    build(tmp_path / "other", hidden="0", memory="z(c)[4] += 100").replace(made)
    np.testing.assert_array_equal(simulation_of(given, ("s", "v"), ()).rates(t, x, u), before)
    after = simulation_of(bg.FMU(made, states=NAMES, parameters=HELD), ("s", "v"), ()).rates(t, x, u)
    np.testing.assert_allclose(after[:, 1], before[:, 1] + 100)
    assert given != bg.FMU(made, states=NAMES, parameters=HELD)
    with pytest.raises(bg.InputError, match="has been changed since it was read"):
        pickle.loads(pickle.dumps(given))
    made.unlink()
    np.testing.assert_array_equal(simulation_of(given, ("s", "v"), ()).rates(t, x, u), before)


def test_another_process_reads_the_file_again(plant):
    given = bg.FMU(plant, states=NAMES, parameters=HELD)
    assert pickle.loads(pickle.dumps(given)) == given


@pytest.fixture(scope="module")
def fits(plant):
    """One of an output of the FMU, one of a state."""
    rng = np.random.default_rng(2)
    t, (s, v) = np.arange(0, 40, 0.2), rng.normal(size=(2, 200))
    a = -10 * (s - 1.1) - 0.4 * v
    data = bg.Trajectories.from_arrays(
        t,
        states={"s": s, "v": v},
        derivatives={"s": v, "v": a + 0.01 * rng.standard_normal(200)},
        outputs={"a": a + 0.01 * rng.standard_normal(200)},
    )
    given = bg.FMU(plant, parameters=HELD, states=NAMES)
    output = bg.GreyBox({"a": ["v"]}, simulation=replace(given, outputs={"a": "der(mass.v)"}), discrepancy=None)
    made = fabricate(bg.GreyBox({"v": ["v"]}, simulation=given, discrepancy=None), data)
    return {
        "a": estimated(output, data),
        "v": bg.Fit(made.model, made.data, made.sampling, made.idata),
    }


@pytest.mark.slow
def test_outputs_of_an_fmu_are_functions_too(fits):
    x = np.array([[0.5, 1.0], [1.0, -2.0]])
    expected = -10 * (x[:, 0] - 1.1) - 0.4 * x[:, 1]
    for backend in ("numpy", "jax"):
        rates = fits["a"].to_callable(backend)
        found = np.asarray(rates(0.0, x))[..., rates.equations.index("a")]
        np.testing.assert_allclose(found, expected, atol=0.02)
    slope = jax.jacfwd(lambda x: rates(0.0, x)[rates.equations.index("a")])(jnp.asarray(x[0]))
    np.testing.assert_allclose(slope, [-10, -0.4], atol=0.02)


@pytest.mark.slow
def test_nothing_missing_beside_code_is_no_gap(plant):
    """Where no term can be corrected, the likeliest explanation has no column at all."""
    t = np.arange(0, 6, 0.1)
    s = 1.1 - 0.6 * np.cos(np.sqrt(10) * t) + 0.002 * np.random.default_rng(4).standard_normal(len(t))
    data = bg.Trajectories.from_arrays(t, states={"s": s}, units={"s": "m"})
    small = bg.OrthogonalGP(variables=("s",), features=4)
    model = bg.GreyBox(simulation=bg.FMU(plant, parameters=HELD, states=NAMES), discrepancy=small)
    few = [e for e in load_catalogue("mechanical") if e.slug in ("viscous-damping", "cubic-stiffness")]
    study = bg.find_missing_effects(model, data, catalogue=few, settle=False, free_runs=False, progress=False)
    assert study.verdict == "no gap"


def test_an_exported_program_says_which_fmu_it_wants(fits, tmp_path):
    fits["v"].export(tmp_path / "m.py")
    text = (tmp_path / "m.py").read_text()
    assert "simulation(t, x, u) -> dx/dt, of one point: the FMU Pendulum (plant.fmu, GUID {p})" in text
    assert "your function" not in text
    with pytest.raises(bg.InputError, match=r"is the FMU Pendulum \(plant.fmu.*cannot be written in C"):
        fits["v"].export(tmp_path / "m.c")


def test_a_toml_file_names_an_fmu(tmp_path):
    build(tmp_path)
    t = np.arange(0, 1, 0.1)
    np.savetxt(tmp_path / "run.csv", np.column_stack([t, np.sin(t)]), delimiter=",", header="t,s", comments="")
    text = """
        [data]
        path = "run.csv"
        time = "t"
        states = ["s"]
        [simulation]
        fmu = "plant.fmu"
        parameters = { F = 0, "spring.c" = 9.5 }
        states = { s = "mass.s", v = "mass.v" }
    """
    (tmp_path / "c.toml").write_text(text)
    model = load_config(tmp_path / "c.toml").build_studied_model()
    assert model.simulation == bg.FMU(tmp_path / "plant.fmu", parameters={"F": 0.0, "spring.c": 9.5}, states=NAMES)
    for wrong, said in (
        (
            text.replace("parameters", "parametres"),
            r"\[simulation\] unknown key 'parametres'; did you mean 'parameters'",
        ),
        (
            text.replace("= 9.5", '= "9"'),
            r"\[simulation.parameters\] spring.c = '9' cannot be used; it must be a number",
        ),
    ):
        (tmp_path / "c.toml").write_text(wrong)
        with pytest.raises(bg.InputError, match=said):
            load_config(tmp_path / "c.toml")
    (tmp_path / "c.toml").write_text(text.replace("plant.fmu", "other.fmu"))
    with pytest.raises(bg.InputError, match="There is no FMU .*other.fmu"):
        load_config(tmp_path / "c.toml").build_studied_model()
