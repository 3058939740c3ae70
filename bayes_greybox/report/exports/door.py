"""Export of learned equations to a file, whose ending says the language."""

import os
from pathlib import Path

from bayes_greybox.criticism.equations.learned import LearnedSystem
from bayes_greybox.data.errors import InputError
from bayes_greybox.data.whole import write_text

from .languages import c_program, modelica_program, python_program
from .model import Notes, exported_model

LANGUAGES = {".py": python_program, ".c": c_program, ".mo": modelica_program}
"""Writers by the ending of a file."""


def export_system(system: LearnedSystem, path: str | os.PathLike[str], notes: Notes) -> None:
    """Write the right-hand side of learned equations as a program.

    Args:
        system: The equations.
        path: Destination; its ending is one of `LANGUAGES`, its stem what is exported is called.
        notes: What its header says beside the equations.

    Raises:
        InputError: An unknown ending; equations that the language cannot have; a file that cannot be written.
    """
    file = Path(path)
    require_ending(file)
    text = LANGUAGES[file.suffix](exported_model(system, notes), file.stem)
    try:
        write_text(file, text)
    except OSError as error:
        raise InputError(f'"{file}" cannot be written ({error.strerror}); choose another file.') from None


def require_ending(path: Path) -> None:
    """Refuse a file whose ending is no language's.

    Args:
        path: Destination.

    Raises:
        InputError: Another ending than those of `LANGUAGES`.
    """
    if path.suffix not in LANGUAGES:
        known = ", ".join(LANGUAGES)
        raise InputError(f'"{path}" has no ending of a language that models are exported to: use one of {known}.')
