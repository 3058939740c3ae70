"""The simulation as an FMU, compiled from C that shares nothing with the package: FMIZoo's SpringPendulum1D."""

from pathlib import Path

from bayes_greybox.report.exports.fmu.archive import c_compiler, compiled, installed_fmpy, packed, standard_headers

NAMES = {"s": "mass.s", "v": "mass.v"}
"""States of the FMU by column."""

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="SpringPendulum1D" guid="{spring-pendulum}" numberOfEventIndicators="0">
  <ModelExchange modelIdentifier="SpringPendulum1D"/>
  <UnitDefinitions>
    <Unit name="m"><BaseUnit m="1"/></Unit>
    <Unit name="m/s"><BaseUnit m="1" s="-1"/></Unit>
    <Unit name="m/s2"><BaseUnit m="1" s="-2"/></Unit>
  </UnitDefinitions>
  <ModelVariables>
    <ScalarVariable name="spring.c" valueReference="0" causality="parameter" variability="fixed">
      <Real start="10"/></ScalarVariable>
    <ScalarVariable name="spring.s_rel0" valueReference="1" causality="parameter" variability="fixed">
      <Real start="1" unit="m"/></ScalarVariable>
    <ScalarVariable name="fixed.s0" valueReference="2" causality="parameter" variability="fixed">
      <Real start="0.1" unit="m"/></ScalarVariable>
    <ScalarVariable name="mass.m" valueReference="3" causality="parameter" variability="fixed">
      <Real start="1"/></ScalarVariable>
    <ScalarVariable name="mass.s" valueReference="4" causality="local" initial="exact">
      <Real start="0.5" unit="m"/></ScalarVariable>
    <ScalarVariable name="mass.v" valueReference="5" causality="local" initial="exact">
      <Real start="0" derivative="5" unit="m/s"/></ScalarVariable>
    <ScalarVariable name="mass.a" valueReference="6" causality="local">
      <Real derivative="6" unit="m/s2"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Derivatives><Unknown index="6"/><Unknown index="7"/></Derivatives>
    <InitialUnknowns><Unknown index="6"/><Unknown index="7"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""


def plant(folder: Path) -> Path:
    """Compile the FMU into a folder.

    Raises:
        InputError: FMPy is not installed; there is no C compiler.
    """
    fmpy, compiler = installed_fmpy(), c_compiler()
    sources = {**standard_headers(fmpy), "plant.c": Path(__file__).with_name("plant.c").read_bytes()}
    library = f"binaries/{fmpy.platform}/SpringPendulum1D{fmpy.sharedLibraryExtension}"
    content = {"modelDescription.xml": DESCRIPTION.encode(), library: compiled(compiler, sources, "plant.c")}
    file = folder / "SpringPendulum1D.fmu"
    file.write_bytes(packed(content))
    return file
