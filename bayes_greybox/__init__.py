"""Find, name and add the physics a simulation is missing, with honest uncertainty.

The public names are listed in the stub beside this file; each is imported when it is first used.
"""

import importlib
import time
from typing import Any

import lazy_loader

_SINCE = time.time()
"""When this process began to read the package: what is younger in its files may not be what runs."""

_named, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# The stub's loader reads names from modules; a submodule that nobody has imported yet is no such name.
_MODULES = {
    "figures": "report.plots",  # its older name
    "plots": "report.plots",
    "priors": "model.priors",
    "signals": "physics.experiments.signals",
    "study_figures": "report.study_figures",
    "systems": "physics.experiments.systems",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        # Imported here because it is slow and seldom needed.
        from importlib.metadata import version

        return version("bayes-greybox")
    if name in _MODULES:
        return importlib.import_module(f"{__name__}.{_MODULES[name]}")
    return _named(name)
