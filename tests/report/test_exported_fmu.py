"""An exported FMU, run by FMPy, says what the package's own right-hand side says, to 1e-8."""

import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exported_systems import CASES, CLOSE, MEMORY, points, system_of

from bayes_greybox.equations.learned import Value
from bayes_greybox.equations.rates import learned_rates
from bayes_greybox.report.exports.door import export_system
from bayes_greybox.report.exports.model import Notes
from bayes_greybox.running.errors import InputError

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed (extra fmu)")
compiled = pytest.mark.skipif(not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="there is no C compiler")


class Running:
    """An instance of an FMU, in continuous time unless it is told."""

    def __init__(self, path, folder, kind="ModelExchange", **start):
        from fmpy.fmi2 import FMU2Model, FMU2Slave

        self.description = fmpy.read_model_description(path, validate=True)
        self.place = {each.name: each.valueReference for each in self.description.modelVariables}
        # A library that an instance uses must not be written again.
        folder = folder if Path(folder).exists() else fmpy.extract(path, folder)
        offered = {"ModelExchange": self.description.modelExchange, "CoSimulation": self.description.coSimulation}[kind]
        self.fmu = {"ModelExchange": FMU2Model, "CoSimulation": FMU2Slave}[kind](
            guid=self.description.guid, unzipDirectory=folder, instanceName="m",
            modelIdentifier=offered.modelIdentifier,
        )  # fmt: skip
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0)
        self.set(**start)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def set(self, **values):
        if values:
            self.fmu.setReal([self.place[name] for name in values], list(values.values()))

    def get(self, *names):
        return np.array(self.fmu.getReal([self.place[name] for name in names]))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.fmu.terminate()
        self.fmu.freeInstance()


@compiled
@pytest.mark.parametrize("case", CASES)
def test_an_fmu_computes_the_packages_rates(case, tmp_path):
    system = system_of(*CASES[case])
    x, u = points(system, 30)
    export_system(system, tmp_path / "a model.fmu", Notes('A "verdict" & <more>'))
    own = learned_rates(system)(0.0, x, u)
    with Running(str(tmp_path / "a model.fmu"), str(tmp_path / "m")) as model:
        assert model.description.description == 'A "verdict" & <more>'
        found = np.zeros_like(own)
        for k in range(len(x)):
            model.set(**dict(zip((*system.states, *system.inputs), (*x[k], *u[k]), strict=True)))
            found[k] = model.get(*(f"der({name})" for name in system.states))
        np.testing.assert_allclose(model.get(*system.states), x[-1], rtol=0, atol=0)
    np.testing.assert_allclose(found, own, **CLOSE)


@compiled
def test_the_time_of_an_fmu_is_in_seconds_whatever_the_datas_is(tmp_path):
    system = system_of(*CASES["every function"], units={"t": "ms"})
    x, u = points(system, 1)
    export_system(system, tmp_path / "m.fmu", Notes())
    with Running(str(tmp_path / "m.fmu"), str(tmp_path / "m")) as model:
        model.set(**dict(zip((*system.states, *system.inputs), (*x[0], *u[0]), strict=True)))
        found = model.get(*(f"der({name})" for name in system.states))
    np.testing.assert_allclose(found, 1000 * learned_rates(system)(0.0, x, u)[0], **CLOSE)


@compiled
def test_an_fmu_has_units_outputs_and_coefficients_with_what_is_known_of_them(study, tmp_path):
    study.export(tmp_path / "amended.fmu")
    with zipfile.ZipFile(tmp_path / "amended.fmu") as archive:
        assert {"sources/model.c", "sources/fmi2.c", "sources/fmi2Functions.h"} <= set(archive.namelist())
    with Running(str(tmp_path / "amended.fmu"), str(tmp_path / "m")) as model:
        variables = {each.name: each for each in model.description.modelVariables}
        assert (variables["y"].unit, variables["F"].unit, variables["der(y)"].unit) == ("m", "m/s²", "m/s")
        factor = next(each for each in model.description.modelVariables if each.name.startswith("k_"))
        assert "±" in factor.description and model.get(factor.name) == float(factor.start)

    system = system_of({"y": "v", "v": "-y", "z": "0"}, ["y*F", "v**2"], equation="load")
    x, u = points(system, 10)
    export_system(system, tmp_path / "out.fmu", Notes())
    with Running(str(tmp_path / "out.fmu"), str(tmp_path / "o")) as model:
        for row, force, own in zip(x, u, learned_rates(system)(0.0, x, u), strict=True):
            model.set(y=row[0], v=row[1], z=row[2], F=force[0])
            np.testing.assert_allclose(model.get("load"), own[3:], **CLOSE)


@compiled
def test_a_hidden_state_starts_where_the_state_does_that_it_moves_along_with(tmp_path):
    system = system_of(MEMORY, ["z"])
    export_system(system, tmp_path / "m.fmu", Notes(starts={"z": "y"}))
    with Running(str(tmp_path / "m.fmu"), str(tmp_path / "m"), y=0.7) as model:
        np.testing.assert_array_equal(model.get("y", "z"), [0.7, 0.7])
        model.set(y=0.1)
        np.testing.assert_array_equal(model.get("y", "z"), [0.1, 0.7])


def exported(simulation, path):
    """The FMU of these equations, with k y in that of v and k = 0, as if that was learned."""
    system = system_of(simulation, ["y"])
    (equation,) = system.learned.values()
    terms = tuple(replace(each, value=Value.exact(0.0)) for each in equation.terms)
    export_system(replace(system, learned={"v": replace(equation, terms=terms)}), path, Notes())
    return str(path)


@pytest.fixture(scope="module")
def oscillator(tmp_path_factory):
    return exported({"y": "v", "v": "-y", "z": "0"}, tmp_path_factory.mktemp("oscillator") / "m.fmu")


@compiled
@pytest.mark.parametrize("k", [0.0, -3.0])
@pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
def test_an_fmu_is_simulated_along_a_known_motion_whatever_its_coefficients_are_set_to(oscillator, kind, k):
    (name,) = (each for each in names_of(oscillator) if each.startswith("k_"))
    start = {"y": 1.0, "v": 0.0, "z": 0.0, name: k}
    run = fmpy.simulate_fmu(
        oscillator, fmi_type=kind, start_values=start, stop_time=5.0, output_interval=0.5, relative_tolerance=1e-10
    )
    # The tolerance bounds the error of a step, of which there are some hundred.
    np.testing.assert_allclose(run["y"], np.cos(np.sqrt(1 - k) * run["time"]), atol=1e-6)


def stepped(model, length, n=1, begin=0.0):
    """Statuses of n communication steps, to the first error."""
    found = []
    for k in range(n):
        try:
            found.append(model.fmu.fmi2DoStep(model.fmu.component, begin + k * length, length, 1))
        except fmpy.fmi1.FMICallException as error:
            return [*found, error.status]
    return found


OK, WARNING, ERROR = 0, 1, 3


@compiled
def test_between_communication_points_it_takes_what_steps_it_needs(tmp_path):
    """A relaxation that is a thousand times faster than they are apart."""
    path = exported({"y": "v", "v": "-1000*(v - 1)", "z": "0"}, tmp_path / "m.fmu")
    with Running(path, str(tmp_path / "m"), "CoSimulation", y=0.0, v=0.0, z=0.5) as model:
        assert stepped(model, 1.0, 2) == [OK, OK]
        np.testing.assert_allclose(model.get("y", "v"), [2.0 - 1e-3, 1.0], atol=1e-6)


@pytest.fixture(scope="module")
def sliding(tmp_path_factory):
    """A path that dry friction holds, beside an oscillator that may not feel it."""
    return exported({"y": "v", "v": "-y", "z": "-sign(z)"}, tmp_path_factory.mktemp("sliding") / "s.fmu")


@compiled
@pytest.mark.parametrize("begin", [0.0, 1.76e9])
@pytest.mark.parametrize("z", [0.5, 0.0003, 0.0])
@pytest.mark.parametrize("length", [1.0, 0.1, 0.01, 0.001])
def test_what_dry_friction_holds_stays_and_steps_end_wherever_time_begins(sliding, tmp_path, length, z, begin):
    with Running(sliding, str(tmp_path / "m"), "CoSimulation", y=1.0, v=0.0, z=z) as model:
        model.fmu.setupExperiment(startTime=begin)
        assert set(stepped(model, length, 10, begin)) <= {OK, WARNING}
        # Time itself has 2e-7 s between two numbers there; the equations do not ask for it.
        np.testing.assert_allclose(model.get("y"), np.cos(10 * length), atol=1e-6)
        np.testing.assert_allclose(model.get("z"), max(z - 10 * length, 0.0), atol=2e-4 * length + 1e-8)


@compiled
def test_a_step_of_nothing_does_nothing_and_one_back_in_time_is_an_error(oscillator, tmp_path):
    with Running(oscillator, str(tmp_path / "m"), "CoSimulation", y=1.0, v=0.0, z=0.0) as model:
        assert stepped(model, 0.0) == [OK] and model.get("y") == 1.0
        assert stepped(model, 5e-324) == [OK]
        assert [stepped(model, length) for length in (-1.0, np.inf, np.nan)] == [[ERROR]] * 3
        assert stepped(model, 1.0, begin=np.nan) == [ERROR]


@compiled
def test_what_is_too_fast_for_the_communication_step_is_told(tmp_path):
    """Friction that rises within a millionth of the speed: v settles at 5e-7."""
    path = exported({"y": "v", "v": "0.5 - 1000000*tanh(v)", "z": "0"}, tmp_path / "m.fmu")
    with Running(path, str(tmp_path / "m"), "CoSimulation", y=0.0, v=0.0, z=0.0) as model:
        assert stepped(model, 1.0, 2)[-1] == WARNING
    with Running(path, str(tmp_path / "m"), "CoSimulation", y=0.0, v=0.0, z=0.0) as model:
        assert set(stepped(model, 0.005, 20)) == {OK}
        assert model.get("v") == pytest.approx(5e-7, rel=1e-3)


@compiled
def test_a_reset_gives_starts_and_coefficients_back(oscillator, tmp_path):
    (name,) = (each for each in names_of(oscillator) if each.startswith("k_"))
    with Running(oscillator, str(tmp_path / "m"), "CoSimulation", y=1.0, v=0.0, z=0.0, **{name: -3.0}) as model:
        begun = model.get("y", name)
        stepped(model, 1.0)
        model.fmu.reset()
        assert model.get(name) == 0.0 and begun[1] == -3.0
        assert model.get("y") == float(next(v for v in model.description.modelVariables if v.name == "y").start)


@compiled
def test_a_path_that_leaves_all_bounds_is_an_error_and_no_number(tmp_path):
    path = exported({"y": "v", "v": "0", "z": "z**2"}, tmp_path / "m.fmu")
    with Running(path, str(tmp_path / "m"), "CoSimulation", y=0.0, v=0.0, z=1.0) as model:
        assert stepped(model, 2.0) == [ERROR]


@compiled
def test_instances_have_coefficients_of_their_own_and_rates_cannot_be_set(oscillator, tmp_path):
    (name,) = (each for each in names_of(oscillator) if each.startswith("k_"))
    folder, start = str(tmp_path / "a"), {"y": 1.0, "v": 0.0, "z": 0.0}
    with Running(oscillator, folder, **start) as one, Running(oscillator, folder, **start) as two:
        one.set(**{name: -1.0})
        assert (one.get("der(v)"), two.get("der(v)")) == (-2.0, -1.0)
        with pytest.raises(Exception, match="fmi2SetReal"):
            one.set(**{"der(v)": 1.0})


def names_of(path):
    return [each.name for each in fmpy.read_model_description(path, validate=True).modelVariables]


def test_without_a_compiler_there_is_a_sentence_and_no_file(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(InputError, match="there is no C compiler here .* or export to .c"):
        export_system(system_of(MEMORY, ["y"]), tmp_path / "m.fmu", Notes())
    assert list(tmp_path.iterdir()) == []
