"""Export of learned equations to a file, whose ending says the language."""

import os
from pathlib import Path

from bayes_greybox.equations.learned import LearnedSystem
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.whole_files import whole_file

from .fmu.archive import fmu_archive
from .languages import c_program, modelica_program, python_program
from .model import Notes, exported_model

LANGUAGES = {".py": python_program, ".c": c_program, ".mo": modelica_program, ".fmu": fmu_archive}
"""Functions that write a model under a name, by the ending of a file."""


def export_system(system: LearnedSystem, path: str | os.PathLike[str], notes: Notes) -> None:
    """Write the right-hand side of learned equations as a program, whose language is that of the path's ending.

    The stem of the path is what is exported is called.

    Raises:
        InputError: An unknown ending; equations that the language cannot have; a file that cannot be written.
    """
    file = Path(path)
    require_ending(file)
    content = LANGUAGES[file.suffix](exported_model(system, notes), file.stem)
    try:
        with whole_file(file) as part:
            part.write_bytes(content.encode() if isinstance(content, str) else content)
    except OSError as error:
        raise InputError(f'"{file}" cannot be written ({error.strerror}); choose another file.') from None


def require_ending(path: Path) -> None:
    """Refuse a file whose ending is no language's by an `InputError`."""
    if path.suffix not in LANGUAGES:
        endings = ", ".join(LANGUAGES)
        raise InputError(f'"{path}" has no ending of a language that models are exported to: use one of {endings}.')
