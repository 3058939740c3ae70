"""Reading of FMU files by FMPy (extra `fmu`), which is imported here and nowhere at the start."""

import hashlib
import os
import re
import shutil
import tempfile
import threading
import weakref
import zipfile
from pathlib import Path
from typing import Any

from bayes_greybox.running.errors import InputError

from .description import Description, description_of

INSTALL_FMPY = 'install it with pip install ".[fmu]" in the checkout'

VERSIONS = ("2.0", "3.0")
"""Versions of FMI that are supported."""


def fmpy() -> Any:
    """Import FMPy."""
    try:
        import fmpy
    except ImportError as error:
        raise InputError(f"Running an FMU needs FMPy; {INSTALL_FMPY}.") from error
    return fmpy


def read_fmu(path: str | os.PathLike[str]) -> Description:
    """Read the description of an FMU, and keep a copy of its content: a file that changes later is another FMU."""
    file = Path(path)
    if not file.is_file():
        raise InputError(f'There is no FMU "{file}"; check the path.')
    library, file = fmpy(), file.resolve()
    with file.open("rb") as opened:
        content = hashlib.file_digest(opened, "sha256").hexdigest()
    with _reading:
        description = _known.get(content)
        if description is None:
            description = _known[content] = _read(file, content, library)
    return description


_known: weakref.WeakValueDictionary[str, Description] = weakref.WeakValueDictionary()
_reading = threading.Lock()


def _read(file: Path, content: str, library: Any) -> Description:
    if not zipfile.is_zipfile(file):
        raise InputError(f'"{file}" is no FMU: it is not a ZIP archive; check the file.')
    folder = Path(tempfile.mkdtemp(prefix="fmu-"))
    try:
        description = _unpacked(file, content, folder, library)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    # When nobody holds it any more, or the process ends.
    weakref.finalize(description, shutil.rmtree, folder, ignore_errors=True)
    return description


def _unpacked(file: Path, content: str, folder: Path, library: Any) -> Description:
    try:
        with zipfile.ZipFile(file) as archive:
            names, text = archive.namelist(), archive.read("modelDescription.xml").decode("utf-8", "replace")
        stated = re.search(r'fmiVersion\s*=\s*["\']([^"\']*)', text)
        version = stated[1] if stated else "an unknown version"
        if version not in VERSIONS:
            supported = " and ".join(VERSIONS)
            raise InputError(
                f'"{file}" is an FMU of FMI {version}, and only {supported} are supported: export it again as one.'
            )
        library.extract(str(file), str(folder))
        parsed = library.read_model_description(str(folder), validate=False)
        if parsed.modelExchange is None and parsed.coSimulation is None:
            raise InputError(f'"{file}" has neither Model Exchange nor Co-Simulation; export it again.')
        description = description_of(file, content, folder, parsed)
    except InputError:
        raise
    except Exception as error:
        # FMPy and its XML reader raise errors of many kinds on what is no model description.
        line = (str(error).strip().splitlines() or [type(error).__name__])[0].rstrip(".")
        raise InputError(f'"{file}" cannot be read as an FMU ({line}); export it again.') from error
    _require_library(description, names, library)
    return description


def _require_library(description: Description, names: list[str], library: Any) -> None:
    """Refuse an FMU without a library for this system."""
    here, file = library.platform if description.version == "2.0" else library.platform_tuple, description.file
    called = f"{description.identifier}{library.sharedLibraryExtension}"
    if f"binaries/{here}/{called}" in names:
        return
    # Archives may have folders without a library in them.
    places = sorted({name.split("/")[1] for name in names if re.fullmatch(r"binaries/[^/]+/.*[^/]", name)})
    if here in places:
        has = f"its library for that is not called {called}"
    else:
        has = f"its libraries are for {', '.join(places)}" if places else "it has no library at all"
    remedy = f"export it for {here}"
    if any(name.startswith("sources/") and name.endswith(".c") for name in names):
        remedy = f'its C sources are in it, and python -m fmpy compile "{file}" adds a library; or {remedy}'
    raise InputError(f'The FMU "{file}" cannot run on this system ({here}): {has}; {remedy}.')
