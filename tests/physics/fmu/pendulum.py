"""An FMU of a spring pendulum, compiled from C against the headers in FMPy."""

import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

C = r"""
#include <stdlib.h>
#include <string.h>
#include "fmi2Functions.h"
/* 0: c, 1: s0, 2: s, 3: v, 4: der(v), 5: F, 6: what no variable shows, 7: start of s */
typedef struct { double z[8]; } M;
static double* z(fmi2Component c) { return ((M*)c)->z; }
static void rest(double* z) { z[0] = 10; z[1] = 1.1; z[2] = 0.5; z[3] = 0; z[5] = 0; z[6] = 0; z[7] = 0.5; }
static fmi2Status put(double* z)
  { z[4] = z[5] - z[0] * (z[2] - z[1]) - HIDDEN * z[6]; return z[2] > 90 ? fmi2Error : fmi2OK; }
fmi2Component fmi2Instantiate(fmi2String n, fmi2Type t, fmi2String g, fmi2String r, const fmi2CallbackFunctions* f,
  fmi2Boolean v, fmi2Boolean l) { M* m = malloc(sizeof(M)); rest(m->z); return m; }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean a, fmi2Real b, fmi2Real d, fmi2Boolean e, fmi2Real f)
  { return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return z(c)[0] < 0 ? fmi2Error : fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { START; return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { rest(z(c)); return RESET; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo* e) { memset(e, 0, sizeof *e); EVENT; return fmi2OK; }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
  { x[0] = z(c)[2]; x[1] = z(c)[3]; return fmi2OK; }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean b)
  { double* m = z(c), rest = h;
    while (rest > 1e-12) { double d = rest < INNER ? rest : INNER, v = m[3];
      put(m); m[3] += d * m[4]; m[2] += d * v; m[6] += d * (v - m[6]); rest -= d; }
    return fmi2OK; }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) { return fmi2OK; }
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
  { z(c)[2] = x[0]; z(c)[3] = x[1]; return fmi2OK; }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real x[])
  { for (size_t i = 0; i < n; i++) z(c)[r[i]] = x[i]; return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real x[])
  { fmi2Status s = put(z(c)); MEMORY; for (size_t i = 0; i < n; i++) x[i] = z(c)[r[i]]; return s; }
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference u[], size_t nu,
  const fmi2ValueReference k[], size_t nk, const fmi2Real d[], fmi2Real o[])
  { for (size_t i = 0; i < nu; i++)
      o[i] = u[i] == 4 ? (k[0] == 2 ? SLOPE * z(c)[0] * d[0] : (k[0] == 5) * d[0]) : (k[0] == 3) * d[0];
    return fmi2OK; }
"""

UNUSED = """
    GetTypesPlatform GetVersion SetDebugLogging FreeInstance Terminate GetInteger GetBoolean GetString SetInteger
    SetBoolean SetString GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize SerializeFMUstate
    DeSerializeFMUstate EnterEventMode CompletedIntegratorStep GetDerivatives GetEventIndicators
    GetNominalsOfContinuousStates SetRealInputDerivatives GetRealOutputDerivatives CancelStep GetStatus GetRealStatus
    GetIntegerStatus GetBooleanStatus GetStringStatus
"""

XML = """<?xml version="1.0"?>
<fmiModelDescription fmiVersion="{version}" modelName="Pendulum" guid="{guid}" numberOfEventIndicators="0">
  <{interface} modelIdentifier="Pendulum" providesDirectionalDerivative="{directional}"/>
  <UnitDefinitions><Unit name="m"><BaseUnit m="1"/></Unit><Unit name="m/s"><BaseUnit m="1" s="-1"/></Unit>
  </UnitDefinitions>{experiment}
  <ModelVariables>
    <ScalarVariable name="spring.c" valueReference="0" causality="parameter" variability="tunable"><Real start="10"/>
    </ScalarVariable>
    <ScalarVariable name="fixed.s0" valueReference="1" causality="parameter" variability="tunable"><Real start="1.1"/>
    </ScalarVariable>
    <ScalarVariable name="mass.s" valueReference="2" initial="{s}"><Real {start} unit="m"/></ScalarVariable>
    <ScalarVariable name="mass.v" valueReference="3" initial="{v}"><Real {start} unit="m/s" {of_s}/></ScalarVariable>
    <ScalarVariable name="der(mass.v)" valueReference="4"><Real {of_v}/></ScalarVariable>
    <ScalarVariable name="F" valueReference="5" causality="input"><{kind} start="0"/></ScalarVariable>
    <ScalarVariable name="s.start" valueReference="7" causality="parameter" variability="fixed"><Real start="0.5"/>
    </ScalarVariable>
  </ModelVariables>
  <ModelStructure>{structure}</ModelStructure>
</fmiModelDescription>"""


DESCRIBED = {
    "version": "2.0", "guid": "{p}", "interface": "ModelExchange", "directional": "true", "kind": "Real",
    "s": "exact", "v": "exact", "start": 'start="0.5"', "of_s": 'derivative="3"', "of_v": 'derivative="4"',
    "structure": '<Derivatives><Unknown index="4"/><Unknown index="5"/></Derivatives>', "experiment": "",
}  # fmt: skip

STEPPED = {
    "interface": "CoSimulation", "structure": "", "of_s": "", "of_v": "",
    "experiment": '<DefaultExperiment stepSize="0.001"/>',
}  # fmt: skip
"""Of a Co-Simulation that declares neither states nor rates."""

NAMES = {"s": "mass.s", "v": "mass.v"}
"""Its states, by the data's names."""

HELD = {"F": 0.0}
"""Its input as a parameter."""


def build(
    folder,
    slope="-1.0",
    memory="",
    library=True,
    hidden="0",
    start="",
    event="",
    inner="1",
    reset="fmi2OK",
    **described,
):
    """Compile an FMU; `slope` -1 makes its directional derivatives right, `described` goes into its description.

    `memory`, `start` and `event` are C at a reading, at the start and at an event; `hidden` is what the force has of a
    state that no variable shows; `inner` is the longest step that it takes within one that it is told to take, s;
    `reset` is what a reset returns.
    """
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed (extra fmu)")
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler")
    folder.mkdir(parents=True, exist_ok=True)
    source, shared, made = folder / "m.c", folder / "m.so", folder / "plant.fmu"
    # Functions of the standard that nothing here calls; their loader asks for all.
    rest = folder / "rest.c"
    rest.write_text("".join(f"int fmi2{name}(void) {{ return 0; }}\n" for name in UNUSED.split()))
    words = {"SLOPE": slope, "MEMORY": memory, "HIDDEN": hidden, "START": start, "EVENT": event, "INNER": inner}
    words |= {"RESET": reset}
    text = C
    for word, code in words.items():
        text = text.replace(word, code)
    source.write_text(text)
    headers = Path(fmpy.__file__).parent / "c-code"
    subprocess.run([compiler, "-shared", "-fPIC", f"-I{headers}", source, rest, "-o", shared], check=True)
    with zipfile.ZipFile(made, "w") as archive:
        archive.writestr("modelDescription.xml", XML.format(**{**DESCRIBED, **described}))
        where = fmpy.platform if library else "nowhere64"
        archive.write(shared, f"binaries/{where}/Pendulum{fmpy.sharedLibraryExtension}")
    return made
