"""FMUs of FMI 3.0: a mass on a spring, compiled from C against the headers in FMPy."""

import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.physics.simulation.reading import simulation_of

C = r"""
#include <stdlib.h>
#include <string.h>
#include "fmi3Functions.h"
/* 0: time, 1: c, 2: x, 3: v, 4: der(v), 5: F, as value references have them */
static double* z(fmi3Instance m) { double* a = m; a[4] = a[5] - a[1] * a[2]; return a; }
static fmi3Instance made(void) { double* a = calloc(6, sizeof(double)); a[1] = 10; a[2] = 0.5; return a; }
fmi3Instance fmi3InstantiateModelExchange(fmi3String n, fmi3String token, fmi3String r, fmi3Boolean v, fmi3Boolean l,
  fmi3InstanceEnvironment e, fmi3LogMessageCallback f) { return strcmp(token, "{3}") ? NULL : made(); }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String n, fmi3String token, fmi3String r, fmi3Boolean v, fmi3Boolean l,
  fmi3Boolean u, fmi3Boolean y, const fmi3ValueReference q[], size_t k, fmi3InstanceEnvironment e,
  fmi3LogMessageCallback f, fmi3IntermediateUpdateCallback g) { return strcmp(token, "{3}") ? NULL : made(); }
void fmi3FreeInstance(fmi3Instance m) { free(m); }
fmi3Status fmi3Reset(fmi3Instance m)
  { double* a = m; memset(a, 0, 6 * sizeof(double)); a[1] = 10; a[2] = 0.5; return 0; }
fmi3Status fmi3EnterInitializationMode(fmi3Instance m, fmi3Boolean a, fmi3Float64 b, fmi3Float64 start, fmi3Boolean c,
  fmi3Float64 d) { z(m)[0] = start; return z(m)[1] < 0 ? fmi3Error : fmi3OK; }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance m, fmi3Boolean* a, fmi3Boolean* b, fmi3Boolean* c, fmi3Boolean* d,
  fmi3Boolean* e, fmi3Float64* f) { *a = *b = *c = *d = *e = false; return fmi3OK; }
fmi3Status fmi3SetTime(fmi3Instance m, fmi3Float64 t) { z(m)[0] = t; return fmi3OK; }
fmi3Status fmi3SetContinuousStates(fmi3Instance m, const fmi3Float64 x[], size_t n)
  { memcpy(z(m) + 2, x, 2 * sizeof(double)); return fmi3OK; }
fmi3Status fmi3GetContinuousStates(fmi3Instance m, fmi3Float64 x[], size_t n)
  { memcpy(x, z(m) + 2, 2 * sizeof(double)); return fmi3OK; }
fmi3Status fmi3SetFloat64(fmi3Instance m, const fmi3ValueReference r[], size_t n, const fmi3Float64 x[], size_t k)
  { for (size_t i = 0; i < n; i++) z(m)[r[i]] = x[i]; return fmi3OK; }
fmi3Status fmi3GetFloat64(fmi3Instance m, const fmi3ValueReference r[], size_t n, fmi3Float64 x[], size_t k)
  { for (size_t i = 0; i < n; i++) x[i] = z(m)[r[i]]; return fmi3OK; }
fmi3Status fmi3DoStep(fmi3Instance m, fmi3Float64 t, fmi3Float64 h, fmi3Boolean p, fmi3Boolean* a, fmi3Boolean* b,
  fmi3Boolean* c, fmi3Float64* d)
  { double *s = z(m), v = s[3]; s[3] += h * s[4]; s[2] += h * v; *a = *b = *c = false; *d = t + h; return fmi3OK; }
"""

XML = """<?xml version="1.0"?>
<fmiModelDescription fmiVersion="3.0" modelName="Mass" instantiationToken="{{3}}">
  <{interface} modelIdentifier="Mass"/>
  <UnitDefinitions><Unit name="m"><BaseUnit m="1"/></Unit></UnitDefinitions>
  <DefaultExperiment stepSize="0.001"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Float64 name="c" valueReference="1" causality="parameter" variability="tunable" start="10"/>
    <Float64 name="x" valueReference="2" causality="output" initial="exact" start="0.5" unit="m"/>
    <Float64 name="v" valueReference="3" initial="exact" start="0" {of_x}/>
    <Float64 name="der(v)" valueReference="4" {of_v}/>
    <Float64 name="F" valueReference="5" causality="input" start="0"/>
  </ModelVariables>
  <ModelStructure><Output valueReference="2"/>{structure}</ModelStructure>
</fmiModelDescription>"""

EXCHANGED = {
    "interface": "ModelExchange", "of_x": 'derivative="2"', "of_v": 'derivative="3"',
    "structure": '<ContinuousStateDerivative valueReference="3"/><ContinuousStateDerivative valueReference="4"/>',
}  # fmt: skip
STEPPED = {"interface": "CoSimulation", "of_x": "", "of_v": "", "structure": ""}


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed (extra fmu)")
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    folder, headers = tmp_path_factory.mktemp("mass"), Path(fmpy.__file__).parent / "c-code"
    # FMPy asks for all functions of the standard.
    every = re.findall(r"\bfmi3[A-Z]\w+(?=TYPE)", (headers / "fmi3Functions.h").read_text())
    stubs = "".join(f"int {name}(void) {{ return 0; }}\n" for name in every if f" {name}(" not in C)
    (folder / "mass.c").write_text(C)
    (folder / "rest.c").write_text(stubs)
    shared = folder / "mass.so"
    sources = [folder / "mass.c", folder / "rest.c"]
    subprocess.run([compiler, "-shared", "-fPIC", f"-I{headers}", *sources, "-o", shared], check=True)
    return shared


def packed(library, folder, platform=None, **described):
    import fmpy

    file = folder / "mass.fmu"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", XML.format(**described))
        archive.write(library, f"binaries/{platform or fmpy.platform_tuple}/Mass{fmpy.sharedLibraryExtension}")
    return file


def points(n=7):
    rng = np.random.default_rng(0)
    return np.linspace(0, 1, n), rng.normal(size=(n, 2)), rng.normal(size=(n, 1))


def test_rates_and_their_derivatives_by_model_exchange(library, tmp_path):
    t, x, u = points()
    given = bg.FMU(packed(library, tmp_path, **EXCHANGED), parameters={"c": 4.0})
    own = simulation_of(given, ("x", "v"), ("F",))
    np.testing.assert_allclose(own.rates(t, x, u), np.column_stack([x[:, 1], u[:, 0] - 4 * x[:, 0]]), rtol=1e-12)
    np.testing.assert_allclose(own.jacobian(t, x, u)[3], [[0, 1], [-4, 0]], atol=1e-7)
    assert "central differences" in given.derivatives and given.description.version == "3.0"
    # Another parameter, and a start that it refuses.
    other = simulation_of(bg.FMU(given.path, parameters={"c": 2.0}), ("x", "v"), ("F",))
    np.testing.assert_allclose(other.rates(t, x, u)[:, 1], u[:, 0] - 2 * x[:, 0])
    with pytest.raises(bg.InputError, match="cannot be started"):
        simulation_of(bg.FMU(given.path, parameters={"c": -1.0}), ("x", "v"), ("F",)).rates(t, x, u)


def test_rates_by_co_simulation(library, tmp_path):
    t, x, u = points()
    given = bg.FMU(packed(library, tmp_path, **STEPPED), states={"x": "x", "v": "v"})
    own = simulation_of(given, ("x", "v"), ("F",))
    np.testing.assert_allclose(own.rates(t, x, u), np.column_stack([x[:, 1], u[:, 0] - 10 * x[:, 0]]), rtol=1e-4)


def test_a_library_for_another_system_is_named(library, tmp_path):
    with pytest.raises(bg.InputError, match=r"its libraries are for x86_64-windows; export it for"):
        bg.FMU(packed(library, tmp_path, "x86_64-windows", **EXCHANGED))
