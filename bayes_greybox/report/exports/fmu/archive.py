"""An FMU: its description, its sources, and the library that a C compiler makes of them here."""

import hashlib
import io
import re
import shutil
import subprocess
import tempfile
import zipfile
from pathlib import Path
from typing import Any

from bayes_greybox.data.errors import InputError

from ..languages import c_program
from ..model import ExportedModel
from ..names import identifiers
from .description import description

COMPILERS = ("cc", "gcc", "clang")
"""Those that are looked for, in order."""

HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
"""Of the standard, which come with FMPy."""


def fmu_archive(model: ExportedModel, name: str) -> bytes:
    """The content of NAME.fmu: FMI 2.0, Model Exchange, for the system that this runs on; sources are in it.

    Args:
        model: The model.
        name: What it is called.

    Raises:
        InputError: FMPy is not installed; there is no C compiler; a simulation that is a function.
    """
    program = c_program(model, "model")
    called = next(iter(identifiers([name], ()).values()))
    fmpy, compiler = _fmpy(), _compiler()
    guid = hashlib.sha256("\n".join((called, program)).encode()).hexdigest()[:32]
    headers = Path(fmpy.__file__).parent / "c-code"
    sources = {each: (headers / each).read_bytes() for each in HEADERS}
    sources |= {"model.c": program.encode(), "model.h": _sizes(model, program, guid).encode()}
    sources["fmi2.c"] = Path(__file__).with_name("fmi2.c").read_bytes()
    said = model.notes.verdict or f"The equations of a {model.origin}"
    content = {"modelDescription.xml": description(model, name, called, guid, said)}
    library = f"binaries/{fmpy.platform}/{called}{fmpy.sharedLibraryExtension}"
    content[library] = _compiled(compiler, sources)
    content |= {f"sources/{each}": text for each, text in sources.items()}
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        for each, data in content.items():
            # Without a time, so that the same model is the same file.
            packed.writestr(zipfile.ZipInfo(each), data, zipfile.ZIP_DEFLATED)
    return archive.getvalue()


def _sizes(model: ExportedModel, program: str, guid: str) -> str:
    """What fmi2.c has to know of model.c."""
    place = {each.name: k for k, each in enumerate(model.states)}
    place |= {each.name: 2 * len(model.states) + k for k, each in enumerate(model.inputs)}

    def array(kind: str, name: str, values: list[Any]) -> str:
        return f"static const {kind} {name}[] = {{{', '.join(map(repr, [*values, 0]))}}};"

    defined = set(re.findall(r"^void (\w+)\(", program, re.MULTILINE))
    rhs, given = (
        next((f"{each}(t, x, u, y)" for each in defined if each.endswith(kind)), "((void)0)")
        for kind in ("_rhs", "_outputs")
    )
    return "\n".join(
        [
            f'#define GUID "{guid}"',
            *(
                f"#define N_{kind} {len(group)}"
                for kind, group in (
                    ("STATE", model.states),
                    ("INPUT", model.inputs),
                    ("OUTPUT", model.outputs),
                    ("FACTOR", model.factors),
                )
            ),
            f"#define RHS(t, x, u, y) {rhs}",
            f"#define GIVEN(t, x, u, y) {given}",
            array("double", "START", [float(each.start) for each in model.states]),
            array("double", "FACTOR", [float(each.value.mean) for each in model.factors]),
            array("int", "FOLLOWS", [place[each.follows] if each.follows else -1 for each in model.states]),
            "",
        ]
    )


def _compiled(compiler: str, sources: dict[str, bytes]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_bytes(text)
        words = [compiler, "-std=c99", "-O2", "-shared", "-fPIC", "-fvisibility=hidden"]
        words += ["fmi2.c", "-o", "library", "-lm"]
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, errors="replace")
        if done.returncode:
            lines = done.stderr.splitlines() or ["it said nothing"]
            said = next((line for line in lines if "error" in line), lines[0])
            raise InputError(f"The C compiler {compiler} could not compile the FMU ({said}): export to .c instead.")
        return (Path(folder) / "library").read_bytes()


def _compiler() -> str:
    found = next(filter(None, map(shutil.which, COMPILERS)), None)
    if found is None:
        raise InputError(
            f"An FMU is compiled, and there is no C compiler here ({', '.join(COMPILERS)}): install one, or export to "
            ".c."
        )
    return found


def _fmpy() -> Any:
    # Imported here because it is optional.
    try:
        import fmpy
    except ImportError:
        raise InputError('Writing an FMU needs FMPy; install it with pip install "bayes-greybox[fmu]".') from None
    return fmpy
