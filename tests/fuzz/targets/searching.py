"""What the targets share: where tests import from, and atheris."""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import atheris

HERE = Path(__file__).parents[1]
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parents[1])]

with atheris.instrument_imports(include=["bayes_greybox.physics.formula", "bayes_greybox.config", "tomllib"]):
    from bayes_greybox import config  # noqa: F401
    from bayes_greybox.inference.kept import netcdf  # noqa: F401
    from bayes_greybox.physics.formula import expressions  # noqa: F401


def search(target: Callable[[bytes, Path], None]) -> None:
    """Search for inputs that break a target, with the options of libFuzzer on the command line.

    Args:
        target: Takes bytes and a folder of its own.
    """
    with tempfile.TemporaryDirectory() as folder:
        atheris.Setup(sys.argv, lambda given: target(given, Path(folder)))
        atheris.Fuzz()
