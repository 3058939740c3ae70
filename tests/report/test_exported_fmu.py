"""An exported FMU, run by FMPy, says what the package's own right-hand side says, to 1e-8."""

import shutil
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from exported_systems import CASES, CLOSE, MEMORY, points, system_of

from bayes_greybox.criticism.equations.learned import Value
from bayes_greybox.criticism.equations.rates import learned_rates
from bayes_greybox.data.errors import InputError
from bayes_greybox.report.exports.door import export_system
from bayes_greybox.report.exports.model import Notes

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed (extra fmu)")
compiled = pytest.mark.skipif(not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="there is no C compiler")


class Running:
    """An instance of an FMU in continuous time."""

    def __init__(self, path, folder, **start):
        from fmpy.fmi2 import FMU2Model

        self.description = fmpy.read_model_description(path, validate=True)
        self.place = {each.name: each.valueReference for each in self.description.modelVariables}
        self.fmu = FMU2Model(
            guid=self.description.guid, unzipDirectory=fmpy.extract(path, folder), instanceName="m",
            modelIdentifier=self.description.modelExchange.modelIdentifier,
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


@compiled
def test_an_fmu_is_simulated_along_a_known_motion(tmp_path):
    """x'' = -x + k x with k = 0: the learned term counts for nothing, and the motion is a cosine."""
    system = system_of({"y": "v", "v": "-y", "z": "0"}, ["y"])
    (equation,) = system.learned.values()
    terms = tuple(replace(each, value=Value.exact(0.0)) for each in equation.terms)
    system = replace(system, learned={"v": replace(equation, terms=terms)})
    export_system(system, tmp_path / "m.fmu", Notes())
    start = {"y": 1.0, "v": 0.0, "z": 0.0}
    run = fmpy.simulate_fmu(
        str(tmp_path / "m.fmu"), start_values=start, stop_time=5.0, output_interval=0.5, relative_tolerance=1e-10
    )
    # CVode's tolerance bounds the error of a step, of which there are some hundred.
    np.testing.assert_allclose(run["y"], np.cos(run["time"]), atol=1e-6)


def test_without_a_compiler_there_is_a_sentence_and_no_file(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(InputError, match="there is no C compiler here .* or export to .c"):
        export_system(system_of(MEMORY, ["y"]), tmp_path / "m.fmu", Notes())
    assert list(tmp_path.iterdir()) == []
