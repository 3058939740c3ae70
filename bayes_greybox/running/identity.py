"""What a trace depends on, in one name: two programs with the same name are the same program, or neither has one.

A trace taken for another one would give wrong posteriors and say nothing. So the name is a digest of all that a trace
is made of, stated in one way only; where something of it cannot be stated, there is no name, and nothing is kept:

    the source of this package, and versions of what it calls
    what its modules hold in memory: constants, and where functions come from
    what the program is called, and its static settings
    shapes and types of its arguments, and what is static in them
    configuration of JAX and NumPyro, the backend

What no name can see is a function of JAX or NumPyro that was replaced in memory.
"""

import functools
import hashlib
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import BuiltinFunctionType, FunctionType, ModuleType
from typing import Any, cast

import jax
import numpy as np

PACKAGE = __name__.partition(".")[0]

LIBRARIES = (
    "jax",
    "jaxlib",
    "numpy",
    "numpyro",
    "scipy",
    "sympy",
    "diffrax",
    "equinox",
    "lineax",
    "optimistix",
    "threadpoolctl",
)
"""What traces call: of other versions they are others."""

PLAINER = ("annotated_types", "beartype", "jaxtyping")
"""What only says what may be given."""

TRUSTED = {PACKAGE, *LIBRARIES, *PLAINER, *sys.stdlib_module_names} - {"unittest"}
"""Where functions come from whose versions or source the name has."""

FRESH = 2.0
"""Seconds by which clocks of files may be off."""

PLAIN_TYPES = (type(None), bool, int, float, complex, str, bytes)


class Unkept(Exception):
    """Something that cannot be stated, and what."""


def name_of(name: str, modules: tuple[str, ...], identity: Any, leaves: list[Any], tree: Any) -> str | None:
    """A digest of all that the trace of a program depends on; None where that is not certain.

    Args:
        name: Of the program, within the package.
        modules: Where its function is defined, and modules and packages that its trace runs through.
        identity: What the function holds beside its arguments.
        leaves: Of its arguments.
        tree: Of its arguments, as `jax.tree.flatten` says it.
    """
    try:
        if any(module.partition(".")[0] != PACKAGE for module in modules):
            raise Unkept(modules)
        facts = (
            name,
            modules,
            told(identity),
            structure(tree),
            tuple(map(_shape, leaves)),
            sources(),
            tuple(in_memory(modules)),
            surroundings(),
        )
    except (Unkept, OSError, RecursionError):
        return None
    return hashlib.sha256(repr(facts).encode()).hexdigest()


def _refused(value: Any) -> Any:
    raise Unkept(type(value))


def told(value: Any, other: Callable[[Any], Any] = _refused) -> Any:
    """A value in tuples, words and numbers whose `repr` no other value has.

    Args:
        value: Plain values, arrays of NumPy, frozen dataclasses of this package, and collections of such.
        other: What to say of anything else; by default it is refused.

    Raises:
        Unkept: There is something else in it.
    """
    kind, parts = type(value), cast(Any, value)
    if kind in PLAIN_TYPES:
        return kind.__name__, repr(value)
    if isinstance(value, np.ndarray | np.generic) and kind.__module__ == "numpy" and value.dtype.kind in "biufcSU":
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return kind.__name__, value.dtype.str, value.shape, digest
    if kind in (tuple, list) or (isinstance(value, tuple) and _is_ours(kind)):
        return kind.__qualname__, *(told(each, other) for each in parts)
    if kind is dict:
        return "dict", *((told(key, other), told(each, other)) for key, each in parts.items())
    if kind in (set, frozenset):
        return kind.__name__, *sorted((told(each, other) for each in parts), key=repr)
    if is_dataclass(value) and _is_ours(kind):
        own = ((field.name, told(getattr(value, field.name), other)) for field in fields(value))
        return kind.__module__, kind.__qualname__, *own
    return other(value)


def structure(tree: Any) -> Any:
    """The same of what JAX takes as the structure of arguments, in which the static fields of dataclasses are.

    Raises:
        Unkept: There is something in it that `told` refuses.
    """
    data = tree.node_data()
    if data is None:
        return "leaf" if tree.num_leaves else "nothing"
    kind, static = data
    if kind not in (tuple, list, dict, type(None)) and not _is_ours(kind):
        raise Unkept(kind)
    return kind.__module__, kind.__qualname__, told(static), *map(structure, tree.children())


def _is_ours(kind: type) -> bool:
    """Whether a class is the one of this package under its name."""
    if kind.__module__.partition(".")[0] != PACKAGE:
        return False
    return vars(sys.modules.get(kind.__module__, object)).get(kind.__qualname__) is kind


def _shape(leaf: Any) -> Any:
    known = jax.typeof(leaf)
    if not isinstance(known.dtype, np.dtype):
        raise Unkept(known)  # keys of random numbers that have a type of their own
    if isinstance(leaf, jax.Array) and len(leaf.sharding.device_set) > 1:
        raise Unkept(leaf.sharding)
    return known.shape, known.dtype.name, known.weak_type


def sources() -> Any:
    """Of this package its source, of NumPyro, which may be installed from a checkout, when its files were changed.

    Raises:
        Unkept: A file is younger than what this process may have read of it.
    """
    # The name of the file that is read, and no older one, was stated when the package was imported.
    since = getattr(sys.modules[PACKAGE], "_SINCE", 0.0) - FRESH
    ours = tuple(_files(Path(__file__).parents[1]))
    numpyro = sys.modules.get("numpyro")
    theirs = tuple(_files(Path(str(numpyro.__file__)).parent)) if numpyro else ()
    if not ours or any(changed > since for *_, changed in (*ours, *theirs)):
        raise Unkept("source")
    return _contents(tuple(path for path, *_ in ours), ours), theirs


def _files(folder: Path) -> Iterator[tuple[str, int, int, float]]:
    """Path, size, nanosecond of the last change as it says, and second of it as the system says, of all source."""
    with os.scandir(folder) as entries:
        for entry in sorted(entries, key=lambda entry: entry.name):
            if entry.name.endswith(".py"):
                found = entry.stat()
                yield entry.path, found.st_size, found.st_mtime_ns, max(found.st_ctime, found.st_mtime)
            elif entry.is_dir() and entry.name != "__pycache__":
                yield from _files(Path(entry.path))


@functools.lru_cache(1)
def _contents(paths: tuple[str, ...], _: Any) -> str:
    root, digest = Path(__file__).parents[1], hashlib.sha256()
    for path in paths:
        content = Path(path).read_bytes()
        digest.update(repr((os.path.relpath(path, root), hashlib.sha256(content).hexdigest())).encode())
    return digest.hexdigest()


def in_memory(modules: tuple[str, ...]) -> Iterator[Any]:
    """What modules hold: constants, kernels, and of functions and classes where they come from.

    A constant that was set to another value, or a function that was replaced, makes a program another one.

    Args:
        modules: Their names, or those of packages, all of whose modules that were imported are looked at.

    Raises:
        Unkept: A function comes from somewhere else.
    """
    within = tuple(f"{name}." for name in modules)
    for name, each in sorted(sys.modules.items()):
        if name in modules or name.startswith(within):
            # Which modules of a package were imported, it holds too.
            held = (
                (k, v)
                for k, v in sorted(vars(each).items())
                if k[:2] != "__" and sys.modules.get(f"{name}.{k}") is not v
            )
            yield name, *((key, _held(value, name)) for key, value in held)


def _held(value: Any, module: str) -> Any:
    """What is said of something in a module, or in a class that is defined there."""
    if isinstance(value, ModuleType):
        return "module", value.__name__
    if isinstance(value, type):
        return _class(value, module)
    if isinstance(value, property):
        return "property", *(_held(each, module) for each in (value.fget, value.fset))
    if isinstance(value, staticmethod | classmethod):
        return type(value).__name__, _held(value.__func__, module)
    return told(value, lambda each: _function(each, module))


def _class(kind: type, module: str) -> Any:
    _trust(kind.__module__)
    named = ("class", kind.__module__, kind.__qualname__)
    if kind.__module__ != module:
        return named
    # Python writes these methods for dataclasses, and the rest with two underscores for itself.
    own = ((key, each) for key, each in vars(kind).items() if isinstance(each, FunctionType) or key[:2] != "__")
    return *named, *((key, _held(each, "")) for key, each in own)


def _function(value: Any, module: str) -> Any:
    if isinstance(value, functools.partial):
        return "partial", *(_held(each, module) for each in (value.func, value.args, value.keywords))
    if isinstance(value, FunctionType):
        _trust(value.__module__)
        cells = tuple(_held(cell.cell_contents, "") for cell in value.__closure__ or ())
        return "function", value.__module__, value.__qualname__, value.__code__.co_firstlineno, cells
    if not isinstance(value, BuiltinFunctionType):
        _trust(type(value).__module__)
    _trust(getattr(value, "__module__", None) or PACKAGE)
    return type(value).__name__, *(str(getattr(value, key, None)) for key in ("__module__", "__qualname__"))


def _trust(module: str | None) -> None:
    # A function that was made of a text may say of no module that it is from there.
    if module is None or module.partition(".")[0] not in TRUSTED:
        raise Unkept(module)


def surroundings() -> Any:
    """Versions, the backend, and settings of JAX and NumPyro.

    Raises:
        Unkept: A program runs inside a handler of NumPyro, which may change what it does.
    """
    # A library that says another version than the one that was installed is a checkout.
    loaded = [str(getattr(sys.modules.get(name), "__version__", None)) for name in LIBRARIES[:4]]
    versions = *loaded, *map(_installed, LIBRARIES)
    primitives, distributions = (sys.modules.get(f"numpyro.{name}") for name in ("primitives", "distributions"))
    if getattr(primitives, "_PYRO_STACK", None):
        raise Unkept("handlers")
    validated = getattr(getattr(distributions, "Distribution", None), "_validate_args", None)
    return versions, sys.version_info[:2], jax.default_backend(), settings(), repr(validated)


@functools.cache
def _installed(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return ""


def settings() -> Any:
    """JAX's configuration, but for where it keeps what.

    Raises:
        Unkept: Something in it has no name but an address.
    """
    config: Any = jax.config
    found = [(key, repr(getattr(config, key, value))) for key, value in config.values.items() if "cache" not in key]
    if any(" at 0x" in said for _, said in found):
        raise Unkept("configuration")
    return tuple(found)
