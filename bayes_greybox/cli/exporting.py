"""The command export: the learned equations of a saved fit or study, as a program."""

from pathlib import Path
from typing import Annotated

import typer

from .ending import exit_code, log_to_stderr, show
from .options import Quiet, Verbose


def export(
    file: Annotated[Path, typer.Argument(metavar="RESULT", help="A saved fit or study (.nc).")],
    output: Annotated[
        Path,
        typer.Argument(metavar="OUTPUT", help="The file to write: .py (NumPy), .c (C99), .mo (Modelica) or .fmu."),
    ],
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> int:
    """Write the equations of a saved fit or study as a program, in the language that the file's ending names.

    It computes rates of change from states and inputs. Comments say what is known of its coefficients, and what is not
    in it.
    """
    log_to_stderr(verbose)
    from bayes_greybox.missing_effects import Study, load
    from bayes_greybox.report.exports.door import require_ending

    # A large result takes long to read.
    require_ending(output)
    result = load(file)
    result.export(output)
    show(output if quiet else f"The program is {output}.")
    fit = result.fit if isinstance(result, Study) else result
    return exit_code({} if fit is None else {file.stem: fit})
