"""An FMU: its description, its sources, and the library that a C compiler makes of them here."""

import hashlib
import io
import re
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from bayes_greybox.data.writing import unit_text
from bayes_greybox.report.exports.languages import c_program, uncertainty
from bayes_greybox.report.exports.model import ExportedModel
from bayes_greybox.report.exports.printers import identifiers, one_line
from bayes_greybox.running.errors import InputError

COMPILERS = ("cc", "gcc", "clang")
"""Names of C compilers that are looked for, in order."""

HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
"""Headers of the standard, which come with FMPy."""


def fmu_archive(model: ExportedModel, name: str) -> bytes:
    """Return the content of NAME.fmu: FMI 2.0, both kinds, for this operating system, with its sources.

    Raises:
        InputError: FMPy is not installed; there is no C compiler; a simulation that is a function.
    """
    program = c_program(model, "model", tunable=True)
    called = next(iter(identifiers([name], ()).values()))
    fmpy, compiler = installed_fmpy(), c_compiler()
    files = {each: Path(__file__).with_name(each).read_bytes() for each in ("fmi2.c", "step.c")}
    files["model.c"] = program.encode()
    about = model.notes.verdict or f"The equations of a {model.origin}"
    # Of all that may differ, as importers keep what they know by it.
    every = [*files.values(), _sizes(model, program, "").encode(), description(model, name, called, "", about)]
    guid = hashlib.sha256(b"\n".join(every)).hexdigest()[:32]
    sources = {**standard_headers(fmpy), **files, "model.h": _sizes(model, program, guid).encode()}
    content = {"modelDescription.xml": description(model, name, called, guid, about)}
    library = f"binaries/{fmpy.platform}/{called}{fmpy.sharedLibraryExtension}"
    content[library] = compiled(compiler, sources, "fmi2.c")
    content |= {f"sources/{each}": text for each, text in sources.items()}
    return packed(content)


def packed(content: Mapping[str, bytes]) -> bytes:
    """Return an FMU of its files by their names, without times, so that the same files give the same FMU."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as opened:
        for each, data in content.items():
            opened.writestr(zipfile.ZipInfo(each), data, zipfile.ZIP_DEFLATED)
    return archive.getvalue()


def compiled(compiler: str, sources: Mapping[str, bytes], main: str) -> bytes:
    """Return the library that a C compiler makes of the file `main` among sources and headers by name, or refuse it."""
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_bytes(text)
        words = [compiler, "-std=c99", "-O2", "-shared", "-fPIC", "-fvisibility=hidden"]
        words += [main, "-o", "library", "-lm"]
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, errors="replace")
        if done.returncode:
            lines = done.stderr.splitlines() or ["it said nothing"]
            error = next((line for line in lines if "error" in line), lines[0])
            raise InputError(f"The C compiler {compiler} could not compile the FMU ({error}): export to .c instead.")
        return (Path(folder) / "library").read_bytes()


def c_compiler() -> str:
    """Return the C compiler of this system, or refuse one without."""
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        raise InputError(
            f"An FMU is compiled, and there is no C compiler here ({', '.join(COMPILERS)}): install one, or export to "
            ".c."
        )
    return compiler


def installed_fmpy() -> Any:
    """Return FMPy, which comes with the headers of the standard, or refuse a system without."""
    try:
        import fmpy  # optional
    except ImportError:
        raise InputError('Writing an FMU needs FMPy; install it with pip install ".[fmu]" in the checkout.') from None
    return fmpy


def standard_headers(fmpy: Any) -> dict[str, bytes]:
    """Return the headers of the standard by name, which are in the package `installed_fmpy`."""
    folder = Path(fmpy.__file__).parent / "c-code"
    return {each: (folder / each).read_bytes() for each in HEADERS}


def _sizes(model: ExportedModel, program: str, guid: str) -> str:
    """Return the definitions that fmi2.c needs of model.c."""
    place = {each.name: k for k, each in enumerate(model.states)}
    place |= {each.name: 2 * len(model.states) + k for k, each in enumerate(model.inputs)}

    def array(kind: str, name: str, values: list[Any]) -> str:
        return f"static const {kind} {name}[] = {{{', '.join(map(repr, [*values, 0]))}}};"

    defined = set(re.findall(r"^static void (\w+)\(", program, re.MULTILINE))
    rhs, given = (
        next((f"{each}(t, x, u, p, y)" for each in defined if each.endswith(kind)), "((void)0)")
        for kind in ("_rhs", "_outputs")
    )
    groups = {"STATE": model.states, "INPUT": model.inputs, "OUTPUT": model.outputs, "FACTOR": model.factors}
    lines = [
        f'#define GUID "{guid}"',
        *(f"#define N_{kind} {len(group)}" for kind, group in groups.items()),
        f"#define RHS(t, x, u, p, y) {rhs}",
        f"#define GIVEN(t, x, u, p, y) {given}",
        array("double", "START", [float(each.start) for each in model.states]),
        array("double", "FACTOR", [float(each.value.mean) for each in model.factors]),
        array("int", "FOLLOWS", [place[each.follows] if each.follows else -1 for each in model.states]),
    ]
    return "\n".join([*lines, ""])


def description(model: ExportedModel, name: str, called: str, guid: str, about: str) -> bytes:
    """Return the text of modelDescription.xml; value references are those of fmi2.c.

    `name` is for users, `called` that of the library, and library and description recognise each other by the guid.
    """
    root = ElementTree.Element(
        "fmiModelDescription", fmiVersion="2.0", modelName=one_line(name), guid=guid, description=one_line(about),
        generationTool=f"bayes_greybox {version('bayes-greybox')}", variableNamingConvention="flat",
        numberOfEventIndicators="0",
    )  # fmt: skip
    for kind, able in (("ModelExchange", {}), ("CoSimulation", {"canHandleVariableCommunicationStepSize": "true"})):
        shared = {"modelIdentifier": called, "canNotUseMemoryManagementFunctions": "true"}
        offered = ElementTree.SubElement(root, kind, {**shared, **able})
        ElementTree.SubElement(ElementTree.SubElement(offered, "SourceFiles"), "File", name="fmi2.c")
    units = [each.unit for each in (*model.quantities, *model.formulas, *model.factors)]
    if named := dict.fromkeys(text for text in map(unit_text, units) if text):
        definitions = ElementTree.SubElement(root, "UnitDefinitions")
        for text in named:
            ElementTree.SubElement(definitions, "Unit", name=text)
    variables = ElementTree.SubElement(root, "ModelVariables")

    # A state that moves along with another where a run starts is calculated from it.
    rows: list[tuple[str, str, str, dict[str, str], str, str]] = [
        (each.name, each.about, each.unit, {}, "output", "calculated")
        if each.follows
        else (each.name, each.about, each.unit, {"start": repr(each.start)}, "output", "exact")
        for each in model.states
    ]
    for k, each in enumerate(model.rates, start=1):
        # Per second, whatever the data's time is in.
        unit = each.unit if model.per_second == 1.0 else ""
        rows.append((f"der({each.name})", "", unit, {"derivative": str(k)}, "local", ""))
    rows += [(each.name, each.about, each.unit, {"start": "0.0"}, "input", "") for each in model.inputs]
    rows += [(each.name, each.about, each.unit, {}, "output", "") for each in model.outputs]
    for each in model.factors:
        mean = {"start": repr(float(each.value.mean))}
        rows.append((each.name, uncertainty(each), each.unit, mean, "parameter", "exact"))
    for place, (name, about, unit, number, causality, initial) in enumerate(rows):
        kind = {"causality": causality, "variability": "tunable" if causality == "parameter" else "continuous"}
        attributes = {"name": name, "valueReference": str(place), "description": one_line(about), **kind}
        attributes |= {"initial": initial} if initial else {}
        scalar = ElementTree.SubElement(variables, "ScalarVariable", attributes)
        ElementTree.SubElement(scalar, "Real", number | ({"unit": unit_text(unit)} if unit_text(unit) else {}))

    n, inputs = len(model.states), len(model.inputs)
    states, rates = range(1, n + 1), range(n + 1, 2 * n + 1)
    outputs = range(2 * n + inputs + 1, 2 * n + inputs + len(model.outputs) + 1)
    following = [k for k, each in zip(states, model.states, strict=True) if each.follows]
    structure = ElementTree.SubElement(root, "ModelStructure")
    groups = {"Outputs": [*states, *outputs], "Derivatives": rates, "InitialUnknowns": [*following, *rates, *outputs]}
    for group, places in groups.items():
        if places:
            parent = ElementTree.SubElement(structure, group)
            for place in sorted(places):
                ElementTree.SubElement(parent, "Unknown", index=str(place))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
