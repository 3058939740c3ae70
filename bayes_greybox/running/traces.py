"""Programs whose traces are stored, too: in a process that finds its programs compiled, half of the wait is tracing.

A trace lies beside its compiled program, in a format of JAX's own (`jax.export`): a program without any code of
Python, so that no file of the folder can make Python run something. It bears the name of all that it depends on, see
`identity`; where that is not certain, or a trace cannot be written down, a program is traced as usual.

Nothing is stored while shapes are checked, which happens in traces, and nothing of this package goes into a folder
that only JAX has.
"""

import hashlib
import logging
import os
import secrets
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp

from .compiling import TRACE_ENDING, compile_options, compiled, keep_programs
from .identity import PACKAGE, Unkept, name_of, settings

CHECKED = "BAYES_GREYBOX_TYPECHECK"
"""Environment variable: "1" has shapes and types checked."""

SAMPLER = ("model", "inference.sampler")
"""Modules and packages that a sampler traces through."""

LAPACK = "potrf geqrf geqp3 orgqr ormqr syevd geev gesdd getrf sytrd gehrd trsm gtsv".split()
"""Routines that a trace may call by name: JAX promises some of them for years, and a trace is for one version."""

Function = TypeVar("Function", bound=Callable[..., Any])

log = logging.getLogger(__name__)


def kept(
    function: Function, identity: Any, name: str, *, once: bool = False, rooms: tuple[str, ...] = SAMPLER
) -> Function:
    """Return `compiled`, with the trace stored for later processes.

    Args:
        function: Function to compile. Its positional arguments are pytrees of arrays, its results are arrays in
            dicts, lists and tuples, and beside its arguments it depends on nothing but `identity`.
        identity: Everything that it depends on, of values that `identity.stated` takes; None: store no trace.
        name: Name of the program, in the package.
        once: True if it will run once or twice.
        rooms: Modules and packages of ours that it is traced through, besides its own.
    """
    plain = compiled(function, once=once)
    if identity is None:
        return plain
    programs: dict[Any, Callable[..., Any]] = {}
    one_at_a_time = threading.Lock()

    @wraps(function)
    def call(*args: Any) -> Any:
        leaves, tree = jax.tree.flatten(args)
        if os.environ.get(CHECKED) == "1":
            return plain(*args)
        try:
            key = (tree, tuple(map(jax.typeof, leaves)), settings())
        except Unkept:
            return plain(*args)
        with one_at_a_time:
            program = programs.get(key)
            if program is None:
                traced = _from_trace(function, identity, name, once, rooms, leaves, tree)
                program = plain if traced is None else lambda *args: traced(*jax.tree.leaves(args))
                try:
                    result = program(*args)
                except Exception as error:  # noqa: BLE001 - whatever it is, a trace must not be the reason
                    if traced is None:
                        raise
                    log.debug("%s: the trace does not run (%s)", name, error)
                    program, result = plain, plain(*args)
                programs[key] = program
                return result
        return program(*args)

    return cast(Function, call)


def _from_trace(
    function: Callable[..., Any], identity: Any, name: str, once: bool, rooms: tuple[str, ...], leaves: Any, tree: Any
) -> Callable[..., Any] | None:
    """Return the program from its trace, of the leaves of its arguments; None if it has none."""
    from jax import export

    folder = keep_programs()
    modules = (function.__module__, *(f"{PACKAGE}.{room}" for room in rooms))
    key = name_of(name, modules, identity, leaves, tree) if folder is not None else None
    if folder is None or key is None:
        log.debug("%s: no trace is kept", name)
        return None
    file = folder / f"{key}{TRACE_ENDING}"
    trace = _stored(file, key)
    log.debug("%s: %s", name, "traced now" if trace is None else "the trace was kept")
    if trace is None:
        try:
            content = bytes(_traced(function, leaves, tree).serialize())
            # As later processes will read it, so that all run the same program.
            trace = export.deserialize(bytearray(content))
        except Exception as error:  # noqa: BLE001 - of many classes; a real fault shows when the program itself runs
            log.debug("%s: no trace can be kept (%s)", name, error)
            return None
        _write(file, key, content)
    return jax.jit(trace.call, compiler_options=compile_options(once))


def _traced(function: Callable[..., Any], leaves: list[Any], tree: Any) -> Any:
    from jax import export

    def flat(*leaves: Any) -> Any:
        # Traces do not store weak types, so that results must have none in any process.
        out = function(*jax.tree.unflatten(tree, leaves))
        return jax.tree.map(lambda leaf: jax.lax.convert_element_type(leaf, jnp.result_type(leaf)), out)

    routines = (f"lapack_{precision}{routine}_ffi" for precision in "sd" for routine in LAPACK)
    allowed = [export.DisabledSafetyCheck.custom_call(routine) for routine in routines]
    shapes = [jax.ShapeDtypeStruct(t.shape, t.dtype, weak_type=t.weak_type) for t in map(jax.typeof, leaves)]
    return export.export(jax.jit(flat), disabled_checks=allowed)(*shapes)


def _stored(file: Path, key: str) -> Any:
    """Read a trace from its file; None if there is none, or something else."""
    from jax import export

    try:
        content = file.read_bytes()
        # A SHA-256 digest has 32 bytes.
        digest, trace = content[:32], content[32:]
        return export.deserialize(bytearray(trace)) if digest == _digest(key, trace) else None
    except Exception:  # noqa: BLE001 - a file that is damaged costs a trace, and nothing else
        return None


def _write(file: Path, key: str, content: bytes) -> None:
    """Write a file as a whole, or not at all."""
    # The part that a killed process leaves has an ending by which it is pruned some day.
    part = file.with_name(f"{secrets.token_hex(8)}{TRACE_ENDING}")
    try:
        part.write_bytes(_digest(key, content) + content)
        os.replace(part, file)
    except OSError as error:
        log.debug("a trace could not be written (%s)", error)
        with suppress(OSError):
            part.unlink()


def _digest(key: str, content: bytes) -> bytes:
    return hashlib.sha256(key.encode() + content).digest()
