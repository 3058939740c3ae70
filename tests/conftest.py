"""Shape and type checks of the whole package, switched on for the test run only."""

import os

if "PYTEST_XDIST_WORKER" in os.environ:
    # There are as many workers as cores, and threads of BLAS that wait for work would take the cores from them.
    # Set before NumPy is imported, and passed on to the programs that tests start.
    os.environ.update(OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1", OMP_NUM_THREADS="1")

import jax
import matplotlib
from jaxtyping import install_import_hook

matplotlib.use("Agg")
if "PYTEST_XDIST_WORKER" in os.environ:
    # Nearly every test compiles a program to run it once. Benchmarks and their timings run without workers.
    jax.config.update("jax_disable_most_optimizations", True)
if os.environ.get("BAYES_GREYBOX_TYPECHECK", "1") == "1":
    install_import_hook("bayes_greybox", "beartype.beartype")

LONGEST = ("test_readme.py", "test_loo.py", "test_cli.py")
"""Files of few long tests; they begin the run, so that no worker waits for one of them at its end."""


def pytest_collection_modifyitems(items):
    """The longest files first."""
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))
