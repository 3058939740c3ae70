"""Reading of FMU files by FMPy (extra `fmu`), which is imported here and nowhere at the start."""

import os
import re
import tempfile
import zipfile
from functools import lru_cache
from pathlib import Path
from typing import Any

from bayes_greybox.data.errors import InputError

from .description import MODEL_EXCHANGE, Description, description_of

INSTALL = 'install it with pip install "bayes-greybox[fmu]"'

KNOWN = 16
"""FMU files whose description, and whose folder, is kept."""


def fmpy() -> Any:
    """FMPy.

    Raises:
        InputError: It is not installed.
    """
    try:
        import fmpy
    except ImportError as error:
        raise InputError(f"Running an FMU needs FMPy; {INSTALL}.") from error
    return fmpy


def read_fmu(path: str | os.PathLike[str]) -> Description:
    """Read what an FMU says of itself.

    Args:
        path: The file.

    Raises:
        InputError: FMPy is not installed; no such file; no FMU; a version of FMI that is not supported; no library for
            this system.
    """
    file = Path(path)
    if not file.is_file():
        raise InputError(f'There is no FMU "{file}"; check the path.')
    return _described(*_facts(file))


def unpacked(description: Description) -> tempfile.TemporaryDirectory:
    """The folder in which an FMU lies unpacked; it is there as long as somebody holds it.

    Raises:
        InputError: The file is gone or is damaged.
    """
    file = description.file
    if not file.is_file():
        raise InputError(f'The FMU "{file}" is not there any more; put it back.')
    return _folder(*_facts(file))


def _facts(file: Path) -> tuple[Path, int, int]:
    """What a file is known by: where it is, when it was changed, its size."""
    found = file.resolve()
    return found, found.stat().st_mtime_ns, found.stat().st_size


@lru_cache(maxsize=KNOWN)
def _described(file: Path, changed: int, size: int) -> Description:
    library = fmpy()
    if not zipfile.is_zipfile(file):
        raise InputError(f'"{file}" is no FMU: it is not a ZIP archive; check the file.')
    try:
        with zipfile.ZipFile(file) as archive:
            names, text = archive.namelist(), archive.read("modelDescription.xml").decode("utf-8", "replace")
        stated = re.search(r'fmiVersion\s*=\s*["\']([^"\']*)', text)
        version = stated[1] if stated else "an unknown version"
        found = (
            description_of(file, library.read_model_description(str(file), validate=False))
            if version == "2.0"
            else None
        )
    except Exception as error:
        # FMPy and its XML reader raise errors of many kinds on what is no model description.
        raise _damaged(file, error) from error
    if found is None:
        raise InputError(f'"{file}" is an FMU of FMI {version}, and only 2.0 is supported: export it again as FMI 2.0.')
    if MODEL_EXCHANGE not in found.interfaces:
        raise InputError(
            f'"{file}" has no Model Exchange: a Co-Simulation FMU gives states at the ends of its steps and not their '
            "rates, which a right-hand side needs; export it for Model Exchange."
        )
    _require_library(found, names, library)
    return found


@lru_cache(maxsize=KNOWN)
def _folder(file: Path, changed: int, size: int) -> tempfile.TemporaryDirectory:
    # It is removed when nobody holds it any more, or the process ends.
    folder = tempfile.TemporaryDirectory(prefix="fmu-", ignore_cleanup_errors=True)
    try:
        fmpy().extract(str(file), folder.name)
    except Exception as error:
        raise _damaged(file, error) from error
    return folder


def _require_library(found: Description, names: list[str], library: Any) -> None:
    """Refuse an FMU without a library for this system."""
    here = library.platform
    identifier = found.interfaces[MODEL_EXCHANGE].identifier
    if f"binaries/{here}/{identifier}{library.sharedLibraryExtension}" in names:
        return
    others = sorted({name.split("/")[1] for name in names if name.startswith("binaries/") and name.count("/") > 1})
    has = f"its libraries are for {', '.join(others)}" if others else "it has no library at all"
    sources = any(name.startswith("sources/") and name.endswith(".c") for name in names)
    compiled = f' its C sources are in it, python -m fmpy compile "{found.file}" adds a library;' if sources else ""
    raise InputError(
        f'The FMU "{found.file}" cannot run on this system ({here}): {has};{compiled} or export it for {here}.'
    )


def _damaged(file: Path, error: Exception) -> InputError:
    line = (str(error).strip().splitlines() or [type(error).__name__])[0].rstrip(".")
    return InputError(f'"{file}" cannot be read as an FMU ({line}); export it again.')
