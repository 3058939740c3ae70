"""FMUs as simulations: rates, derivatives, names, units, files, and what is refused."""

import shutil
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from fabricated import estimated, fabricate

import bayes_greybox as bg
from bayes_greybox.inference.kept.model_record import describe, rebuild
from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.physics.simulation.reading import simulation_of

sys.path.insert(0, str(Path(__file__).parent))
from pendulum import HELD, NAMES, build  # noqa: E402

FEW = [
    replace(e, confusions=())
    for e in load_catalogue("mechanical")
    if e.slug in ("viscous-damping", "coulomb-friction", "cubic-stiffness")
]


def points(n=7):
    rng = np.random.default_rng(0)
    return np.linspace(0, 1, n), rng.normal(size=(n, 2)), rng.normal(size=(n, 1))


def test_rates_are_those_of_the_equations_on_rows_and_under_jax(plant):
    t, x, u = points()
    own = simulation_of(bg.FMU(plant, parameters={"fixed.s0": 1.0}, states=NAMES), ("v", "s"), ("F",))
    expected = np.column_stack([u[:, 0] - 10 * (x[:, 1] - 1.0), x[:, 0]])
    np.testing.assert_allclose(own.rates(t, x, u), expected, rtol=1e-12)
    np.testing.assert_allclose(jax.jit(jax.vmap(own.rate))(t, x, u), expected, rtol=1e-12)
    at = [jax.numpy.asarray(each[0]) for each in (t, x, u)]
    np.testing.assert_allclose(jax.jacfwd(own.rate, 1)(*at), [[0, -10], [1, 0]], atol=1e-7)
    np.testing.assert_allclose(jax.jacfwd(own.rate, 2)(*at), [[1], [0]], atol=1e-7)
    assert own.rate_name("s") == "v" and own.rate_name("v") is None and not own.differentiable
    # Another with the same file has its own parameters.
    other = simulation_of(bg.FMU(plant, parameters={"spring.c": 2.0}, states=NAMES), ("v", "s"), ("F",))
    np.testing.assert_allclose(other.rates(t, x, u)[:, 0], u[:, 0] - 2 * (x[:, 1] - 1.1))
    np.testing.assert_allclose(own.rates(t, x, u), expected, rtol=1e-12)
    assert own.key != other.key


@pytest.mark.parametrize(("slope", "right"), [("-1.0", True), ("+3.0", False)])
@pytest.mark.parametrize("c", [10.0, 1e-5])
def test_directional_derivatives_are_used_where_they_are_right(tmp_path, slope, right, c):
    t, x, u = points()
    given = bg.FMU(build(tmp_path, slope), states=NAMES, parameters={"spring.c": c})
    own = simulation_of(given, ("s", "v"), ("F",))
    assert own.warnings == () and "not looked at yet" in given.derivatives
    # A small entry beside a large one is looked at as closely.
    np.testing.assert_allclose(own.jacobian(t, x, 0 * u)[3], [[0, 1], [-c, 0]], rtol=1e-6, atol=1e-7 * c)
    assert given.derivatives.startswith("the FMU's directional" if right else "central differences")
    assert [("are not those of its rates" in text) for text in own.warnings] == ([] if right else [True])
    # With other parameters it is looked at again.
    assert "not looked at yet" in replace(given, parameters={"spring.c": 2 * c}).derivatives


def test_derivatives_that_are_not_declared_or_not_to_be_had_are_differences(tmp_path):
    t, x, u = points()
    plain = bg.FMU(build(tmp_path / "a", directional="false"), states=NAMES)
    assert "declares no directional derivatives" in plain.derivatives
    own = simulation_of(plain, ("s", "v"), ("F",))
    np.testing.assert_allclose(own.jacobian(t, x, u)[3], [[0, 1], [-10, 0]], atol=1e-7)
    # Where it refuses all points nothing is known of its derivatives.
    given = bg.FMU(build(tmp_path / "b"), states=NAMES)
    refused = simulation_of(given, ("s", "v"), ("F",))
    assert np.isnan(refused.jacobian(t, x + 99, u)[:, 1]).all() and "not looked at yet" in given.derivatives


def test_an_output_that_the_fmu_gives_is_known_and_what_it_lacks_is_found(plant):
    rng = np.random.default_rng(2)
    t, (s, v) = np.arange(0, 40, 0.2), rng.normal(size=(2, 200))
    known = -10 * (s - 1.1)
    data = bg.Trajectories.from_arrays(
        t,
        states={"s": s, "v": v},
        derivatives={"s": v, "v": known},
        outputs={"a": known - 0.4 * v + 0.01 * rng.standard_normal(200)},
    )
    given = bg.FMU(plant, parameters=HELD, states=NAMES, outputs={"a": "der(mass.v)"})
    model = bg.GreyBox({"a": ["v", "s"]}, simulation=given, discrepancy=None)
    np.testing.assert_allclose(model.simulator(data).on(data, "a"), known, rtol=1e-12)
    fit = estimated(model, data)
    assert fit.summary()["mean"].iloc[0] == pytest.approx(-0.4, abs=0.005)
    with pytest.raises(bg.InputError, match="names 'b', which is no output of the data"):
        bg.GreyBox({"a": ["v"]}, simulation=replace(given, outputs={"b": "der(mass.v)"})).simulator(data)


def test_a_point_that_is_refused_is_nan_and_the_next_one_is_not(plant):
    own = simulation_of(bg.FMU(plant, states=NAMES, parameters=HELD), ("s", "v"), ())
    found = own.rates(np.zeros(3), np.array([[1.0, 0], [99.0, 0], [1.0, 0]]), np.zeros((3, 0)))
    np.testing.assert_array_equal(np.isnan(found).any(axis=1), [False, True, False])


def test_an_fmu_that_cannot_be_reset_is_instantiated_anew(tmp_path):
    made, (t, x, u) = build(tmp_path, reset="fmi2Error"), points()
    for c in (1.0, 2.0):
        own = simulation_of(bg.FMU(made, parameters={"spring.c": c}, states=NAMES), ("v", "s"), ("F",))
        np.testing.assert_allclose(own.rates(t, x, u)[:, 0], u[:, 0] - c * (x[:, 1] - 1.1))


def test_an_fmu_that_remembers_is_refused(tmp_path):
    made = build(tmp_path, memory="static double told; z(c)[4] += told++")
    own = simulation_of(bg.FMU(made, states=NAMES, parameters=HELD), ("s", "v"), ())
    with pytest.raises(bg.InputError, match="Pendulum remembers"):
        own.rates(*points()[:2], np.zeros((7, 0)))


def test_mistakes_are_named(plant, tmp_path, monkeypatch):
    with pytest.raises(bg.InputError, match="There is no FMU"):
        bg.FMU("nowhere.fmu")
    (tmp_path / "text.fmu").write_text("no archive")
    with pytest.raises(bg.InputError, match="not a ZIP archive"):
        bg.FMU(tmp_path / "text.fmu")
    with pytest.raises(bg.InputError, match="FMI 1.0, and only 2.0 and 3.0"):
        bg.FMU(build(tmp_path / "a", version="1.0"))
    with pytest.raises(bg.InputError, match="neither Model Exchange nor Co-Simulation"):
        bg.FMU(build(tmp_path / "b", interface="Scheduled"))
    with pytest.raises(bg.InputError, match="libraries are for nowhere64"):
        bg.FMU(build(tmp_path / "c", library=False))
    with pytest.raises(bg.InputError, match="did you mean 'spring.c'"):
        bg.FMU(plant, parameters={"sprng.c": 1.0})
    with pytest.raises(bg.InputError, match="set to nan: give a finite number"):
        bg.FMU(plant, parameters={"spring.c": float("nan")})
    with pytest.raises(bg.InputError, match="column 's' twice"):
        bg.FMU(plant, states=NAMES, inputs={"s": "F"})
    with pytest.raises(bg.InputError, match="variable 'mass.s' twice"):
        bg.FMU(plant, states={"s": "mass.s", "y": "mass.s"})
    with pytest.raises(bg.InputError, match="'F' of the FMU Pendulum is held and fed"):
        bg.FMU(plant, parameters=HELD, inputs={"force": "F"})
    with pytest.raises(bg.InputError, match="'F' of the FMU Pendulum is of type Boolean"):
        bg.FMU(build(tmp_path / "d", kind="Boolean"))
    with pytest.raises(bg.InputError, match="no state 's'.*TrajectoryRows"):
        simulation_of(bg.FMU(plant, states=NAMES), ("v",), ("F",))
    with pytest.raises(bg.InputError, match=r"input 'F'.*parameters=\{'F': 0.0\}"):
        simulation_of(bg.FMU(plant, states=NAMES), ("s", "v"), ())
    with pytest.raises(bg.InputError, match="'mass.s' of the FMU Pendulum is in m, and the column 's' in mm"):
        simulation_of(bg.FMU(plant, states=NAMES), ("s", "v"), ("F",), units={"s": "mm", "v": "m/s", "t": "s"})
    simulation_of(bg.FMU(plant, states=NAMES), ("s", "v"), ("F",), units={"s": "m", "v": "m/s", "t": "s"})
    broken = simulation_of(bg.FMU(plant, states=NAMES, parameters={"spring.c": -1.0}), ("s", "v"), ("F",))
    with pytest.raises(bg.InputError, match="cannot be started"):
        broken.rates(*points())
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(bg.InputError, match=r"pip install \".\[fmu\]\""):
        bg.FMU(shutil.copy(plant, tmp_path / "other.fmu"))


def test_files_keep_which_fmu_it_was(tmp_path):
    made = build(tmp_path)
    data = bg.Trajectories.from_arrays(np.arange(4.0), states={"s": [0.0, 1, 3, 2], "v": [1.0, 2, 0, 1]})
    given = bg.FMU(made, parameters=HELD, states=NAMES)
    record = describe(bg.GreyBox({"v": ["v"]}, simulation=given), data)
    assert rebuild(record).simulation == given
    build(tmp_path / "again", guid="{q}").replace(made)
    with pytest.raises(bg.InputError, match=r"GUID \{p\}, and the one that is there now has \{q\}"):
        rebuild(record)
    made.unlink()
    with pytest.raises(bg.InputError, match=r"which is not there: give it again, bg\.load"):
        rebuild(record)
    assert rebuild(record, given).simulation is given


@pytest.mark.slow
def test_a_study_of_positions_names_what_the_fmu_lacks_and_refine_refuses(plant):
    t = np.arange(0, 8, 0.1)
    w, d = np.sqrt(10 - 0.04), 0.2
    s = 1.1 + np.exp(-d * t) * (0.6 * np.cos(w * t) + 0.6 * d / w * np.sin(w * t))
    rng = np.random.default_rng(1)
    data = bg.Trajectories.from_arrays(t, states={"s": s + 0.002 * rng.standard_normal(len(t))}, units={"s": "m"})
    small = bg.OrthogonalGP(variables=("s",), features=4)
    model = bg.GreyBox(simulation=bg.FMU(plant, parameters=HELD, states=NAMES), discrepancy=small)
    study = bg.find_missing_effects(model, data, catalogue=FEW, settle=False, progress=False)
    assert study.verdict == "named" and study.effects.slug[0] == "viscous-damping"
    assert study.effects["mean"][0] == pytest.approx(-0.4, abs=0.02)
    made = fabricate(replace(study.base, dictionary={"v": ["v"]}, discrepancy=None), study.train)
    fit = bg.Fit(made.model, made.data, made.sampling, made.idata)
    with pytest.raises(bg.InputError, match="an FMU cannot be differentiated"):
        fit.refine(draws=5, tune=5, chains=1, progress=False)


def test_folders_without_a_library_are_no_platforms(tmp_path, plant):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed (extra fmu)")
    here, called = fmpy.platform, f"Pendulum{fmpy.sharedLibraryExtension}"
    empty, other = tmp_path / "empty.fmu", tmp_path / "other.fmu"
    with zipfile.ZipFile(plant) as archive:
        description = archive.read("modelDescription.xml")
    for file in (empty, other):
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("modelDescription.xml", description)
            archive.writestr(f"binaries/{here}/", "")
            archive.writestr("binaries/vax64/Pendulum.exe", "x")
    with zipfile.ZipFile(other, "a") as archive:
        archive.writestr(f"binaries/{here}/another", "x")
    with pytest.raises(bg.InputError, match=rf"\({here}\): its libraries are for vax64; export it for {here}\."):
        bg.FMU(empty)
    with pytest.raises(bg.InputError, match=rf"\({here}\): its library for that is not called {called}; export it"):
        bg.FMU(other)
