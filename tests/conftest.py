"""What all tests share: threads, shape and type checks of the whole package where they are asked for, a tiny study."""

import gc
import os
from importlib.metadata import version
from pathlib import Path

if "PYTEST_XDIST_WORKER" in os.environ:
    # There are as many workers as cores, and threads of BLAS that wait for work would take the cores from them.
    # Set before NumPy is imported, and passed on to the programs that tests start.
    os.environ.update(OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1", OMP_NUM_THREADS="1")
    # Nearly every test compiles a program to run it once; what one worker compiled serves the others, and the next run.
    # Benchmarks and their timings run without workers.
    os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"
    if (0, 7) <= tuple(map(int, version("jaxlib").split(".")[:2])) <= (0, 10):
        # Half the time to compile; XLA ends the process at a flag that it does not know, as later ones do not.
        os.environ.setdefault(
            "XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
        )
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
    # Imports and tracing make millions of objects that stay; looking for cycles among them so often took a tenth of
    # the time.
    gc.set_threshold(100_000, 20, 20)
# Where JAX has a folder of its own no traces are kept: tests replace what is traced, and count it.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[1] / ".pytest_cache" / "compiled"))

import pkgutil
from importlib.util import find_spec

import matplotlib
import pytest
from jaxtyping import install_import_hook

matplotlib.use("Agg")
if os.environ.get("BAYES_GREYBOX_TYPECHECK", "0") == "1":
    # They make studies take twice as long.
    rooms = pkgutil.iter_modules(find_spec("bayes_greybox").submodule_search_locations, "bayes_greybox.")
    install_import_hook([room.name for room in rooms], "beartype.beartype")


@pytest.fixture(scope="session")
def study():
    """A real, tiny study."""
    from tiny_study import tiny_study

    return tiny_study()


LONGEST = (
    "test_cli.py", "test_refine.py", "test_shared_rows.py", "test_fleet.py", "test_sampled_study.py",
    "test_long_runs.py", "test_sampling.py", "test_stated_coefficients.py", "test_streams.py", "test_loo.py",
)  # fmt: skip
"""Files that take longest, or of few long tests; they begin the run, so that no worker waits for one at its end."""


def pytest_collection_modifyitems(items):
    """The longest files first."""
    items.sort(key=lambda item: LONGEST.index(item.path.name) if item.path.name in LONGEST else len(LONGEST))
