"""How programs are compiled: in little time, and once for all processes of a user.

Most of what a first fit waits for is XLA's compiler. Programs of this package are many and short, and what they spend
is in BLAS and LAPACK; of the compiler's work only little pays. On a CPU, code by fusions of its former emitters
takes half the time to make, and runs as fast. A program that runs once takes a third of that again without
optimisation.

What was compiled is kept in the user's cache folder, unless JAX was told of another one: `BAYES_GREYBOX_CACHE` names
another folder, or is "off". Beside it are traces, see `traces`.
"""

import hashlib
import logging
import os
import platform
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path
from typing import Any, TypeVar, cast

import jax

FAST = {"xla_cpu_use_fusion_emitters": False}
"""Options of XLA for all programs; how much of them is optimised JAX was told, or does in full."""

ONCE = {**FAST, "xla_backend_optimization_level": 0}
"""For those that run once or twice."""

OFTEN = {**FAST, "xla_backend_optimization_level": 1}
"""For those that run thousands of times or in long loops, whatever JAX was told to optimise: below this level a loop,
over a matrix or along the path of hidden states, takes a multiple of the time, and beyond it nothing is gained."""

FOLDER = "BAYES_GREYBOX_CACHE"
"""Environment variable: folder for compiled programs, or "off"."""

CACHE_SUBFOLDER = "bayes-greybox-compiled"
"""Folder within the one that the user names: nothing else in there is ours to delete."""

PROGRAM_ENDING, TRACE_ENDING = "-cache", "-trace"
"""Endings of names: those that JAX gives to what it keeps, and of traces."""

SHORTEST_COMPILATION = 0.0
"""Seconds of compilation from which on a program is kept: a hundred that each take a hundredth are a second too."""

CACHE_LIMIT_BYTES = 500_000_000
"""Bytes of the folder; beyond them what was not used longest is deleted, when a process starts."""

MAPPED = 1 / 3
"""Share of the memory mappings that the system allows a process, from which on its programs are let go.

A program takes some, and a process that has none left dies in the compiler."""

ALLOWED, OWN_MAPPINGS = Path("/proc/sys/vm/max_map_count"), Path("/proc/self/maps")
"""Where Linux says how many mappings a process may have, and which this one has."""

Function = TypeVar("Function", bound=Callable[..., Any])

log = logging.getLogger(__name__)


def compiled(function: Function, *, once: bool = False, often: bool = False, **options: Any) -> Function:
    """`jax.jit` of a function that no other program calls; nothing happens before its first call.

    Args:
        function: What to compile.
        once: Whether it will run once or twice.
        often: Whether it will run thousands of times, or loops as often.
        **options: Of `jax.jit`.
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
    """The options, where this XLA has them.

    Args:
        once: Whether the program will run once or twice.
        often: Whether it will run thousands of times, or loops as often.
    """
    if jax.default_backend() != "cpu":
        return None
    wanted = ONCE if once else OFTEN if often else FAST
    try:
        jax.jit(lambda x: x + 1, compiler_options=wanted)(0.0)
    except Exception:  # noqa: BLE001 - of many classes, by version; without these options all is right, but slow
        return None
    return wanted


@cache
def keep_programs() -> Path | None:
    """Have JAX keep what it compiles from now on; of whatever begins with single operations, the first line.

    Returns:
        The folder that is ours; None if there is none. Of two folders, one told to us and one to JAX, each is used.
    """
    said, theirs = os.environ.get(FOLDER, ""), getattr(jax.config, "jax_compilation_cache_dir", None)
    if said.lower() in ("off", "0", "no") or (theirs is not None and not said):
        return None
    folder = (Path(said).expanduser() / CACHE_SUBFOLDER if said else _user_folder()) / _machine()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _prune(folder.parent)
    except OSError:
        # A home that cannot be written to costs time, and nothing else.
        return None
    if theirs is None:
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", SHORTEST_COMPILATION)
    return folder


def make_room() -> bool:
    """Let go of programs of earlier fits and studies where these have taken much of what a process may have.

    To be called before long work. What is needed again is found in the folder, or compiled again.

    Returns:
        Whether they were let go.
    """
    try:
        allowed = int(ALLOWED.read_text(encoding="ascii"))
        with OWN_MAPPINGS.open("rb") as mappings:
            mapped = sum(1 for _ in mappings)
    except (OSError, ValueError):
        # Other systems have no such bound.
        return False
    if mapped < MAPPED * allowed:
        return False
    log.debug("%d of %d memory mappings are taken: compiled programs are let go", mapped, allowed)
    jax.clear_caches()
    return True


def _user_folder() -> Path:
    from platformdirs import user_cache_dir

    return Path(user_cache_dir("bayes-greybox", appauthor=False)) / "compiled"


def _machine() -> str:
    """A name for processors that run the same programs: homes are shared, and instructions are not."""
    said = [platform.machine(), platform.processor()]
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        said += [line for line in lines if line.startswith(("flags", "Features"))][:1]
    except OSError:
        pass
    return hashlib.sha256("\n".join(said).encode()).hexdigest()[:12]


def _prune(folder: Path) -> None:
    found = []
    for file in folder.glob("*/*"):
        try:
            status = file.stat()
        except OSError:
            continue
        if not file.name.endswith((PROGRAM_ENDING, TRACE_ENDING)) or not file.is_file():
            continue
        found.append((max(status.st_atime, status.st_mtime), status.st_size, file))
    left = sum(size for _, size, _ in found)
    for _, size, file in sorted(found):
        if left <= CACHE_LIMIT_BYTES:
            return
        file.unlink(missing_ok=True)
        left -= size
