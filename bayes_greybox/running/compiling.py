"""Compilation in little time, and once for all processes of a user.

Most of the wait for a first fit is XLA's compiler. Programs of this package are many and short, and spend their time
in BLAS and LAPACK, so that little of the compiler's work pays. On a CPU, code by fusions of its former emitters
takes half the time to make, and runs as fast. A program that runs once takes a third of that again without
optimisation.

Compiled programs stay in the user's cache folder, unless JAX has another one: `BAYES_GREYBOX_CACHE` names another
folder, or is "off". Beside them are traces, see `traces`.
"""

import hashlib
import logging
import os
import platform
from collections.abc import Callable
from contextlib import suppress
from functools import cache, wraps
from pathlib import Path
from typing import Any, TypeVar, cast

import jax

FAST = {"xla_cpu_use_fusion_emitters": False}
ONCE, OFTEN = ({**FAST, "xla_backend_optimization_level": level} for level in (0, 1))
"""Options of XLA for all programs, and with the level of optimisation for those that run once, and often or in loops.

Below level 1 a loop, over a matrix or along a path, takes a multiple of the time; beyond it nothing is gained."""

FOLDER, CACHE_SUBFOLDER = "BAYES_GREYBOX_CACHE", "bayes-greybox-compiled"
"""Environment variable that names a folder or is "off", and our folder in that one: nothing else there is deleted."""

TRACE_ENDING = "-trace"
"""Ending of the names of traces, as "-cache" is that of JAX's programs."""

CACHE_LIMIT_BYTES = 500_000_000
"""Largest size of the folder in bytes; beyond it the files unused for longest are deleted when a process starts."""

ALLOWED, OWN_MAPPINGS = Path("/proc/sys/vm/max_map_count"), Path("/proc/self/maps")
"""Files with the number of mappings that Linux allows a process, and with those of this one."""

Function = TypeVar("Function", bound=Callable[..., Any])

log = logging.getLogger(__name__)


def compiled(function: Function, *, once: bool = False, often: bool = False, **options: Any) -> Function:
    """Return `jax.jit`, with its options, of a function that no other program calls; made at its first call.

    `once` if it will run once or twice, `often` if it will run thousands of times, or loops as often.
    """

    @cache
    def program() -> Any:
        keep_programs()
        return jax.jit(function, compiler_options=compile_options(once, often), **options)

    @wraps(function)
    def call(*args: Any, **named: Any) -> Any:
        return program()(*args, **named)

    return cast(Function, call)


@cache
def compile_options(once: bool, often: bool = False) -> dict[str, Any] | None:
    """Return the options for a program that runs `once`, `often` or in between, where this XLA has them."""
    if jax.default_backend() != "cpu":
        return None
    wanted = ONCE if once else OFTEN if often else FAST
    try:
        jax.jit(lambda x: x + 1, compiler_options=wanted)(0.0)
    except Exception:  # noqa: BLE001 - its class depends on the version; without these options all is right, but slow
        return None
    return wanted


@cache
def keep_programs() -> Path | None:
    """Have JAX store what it compiles from now on; any work that begins with single operations calls this first.

    Return the folder of this package, None if there is none; if JAX has a folder of its own too, both are used.
    """
    from platformdirs import user_cache_dir

    named, jax_folder = os.environ.get(FOLDER, ""), getattr(jax.config, "jax_compilation_cache_dir", None)
    if named.lower() in ("off", "0", "no") or (jax_folder is not None and not named):
        return None
    own = Path(user_cache_dir("bayes-greybox", appauthor=False)) / "compiled"
    folder = (Path(named).expanduser() / CACHE_SUBFOLDER if named else own) / _machine()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _prune(folder.parent)
    except OSError:
        # A home that cannot be written to costs time, and nothing else.
        return None
    if jax_folder is None:
        jax.config.update("jax_compilation_cache_dir", str(folder))
        # A hundred short compilations make a second too.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    return folder


def make_room() -> bool:
    """Drop programs of earlier work, before long work, if they take much of what a process may have; True if so."""
    try:
        allowed = int(ALLOWED.read_text(encoding="ascii"))
        with OWN_MAPPINGS.open("rb") as mappings:
            mapped = sum(1 for _ in mappings)
    except (OSError, ValueError):
        # Other systems have no such bound.
        return False
    # A process with no mappings left dies in the compiler.
    if mapped < allowed / 3:
        return False
    log.debug("%d of %d memory mappings are taken: compiled programs are dropped", mapped, allowed)
    jax.clear_caches()
    return True


def _machine() -> str:
    """Return a name for processors that run the same programs: homes are shared, and instructions are not."""
    processor = [platform.machine(), platform.processor()]
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor += [line for line in lines if line.startswith(("flags", "Features"))][:1]
    return hashlib.sha256("\n".join(processor).encode()).hexdigest()[:12]


def _prune(folder: Path) -> None:
    files = []
    for file in folder.glob("*/*"):
        # Other processes prune too.
        with suppress(OSError):
            status = file.stat()
            if file.name.endswith(("-cache", TRACE_ENDING)) and file.is_file():
                files.append((max(status.st_atime, status.st_mtime), status.st_size, file))
    total = sum(size for _, size, _ in files)
    for _, size, file in sorted(files):
        if total <= CACHE_LIMIT_BYTES:
            return
        file.unlink(missing_ok=True)
        total -= size
