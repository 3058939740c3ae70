"""Name of all that a trace depends on: two programs with the same name are the same program, or neither has one.

A trace taken for another one would give wrong posteriors without a sign. So the name is a digest of all that a trace
is made of, stated in one way only; where something of it cannot be stated, there is no name, and nothing is stored:

    the source of this package, and versions of the libraries that it calls
    the content of its modules in memory: constants, and the origin of functions
    the name of the program, and its static settings
    shapes and types of its arguments, and their static parts
    configuration of JAX and NumPyro, the backend

No name can reflect a function of JAX or NumPyro that was replaced in memory.
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

LIBRARIES = "jax jaxlib numpy numpyro scipy sympy diffrax equinox lineax optimistix threadpoolctl".split()
"""Libraries that traces call: with other versions they are other traces."""

TRUSTED = {PACKAGE, *LIBRARIES, "annotated_types", "beartype", "jaxtyping", *sys.stdlib_module_names} - {"unittest"}
"""Modules of functions whose versions or source are part of the name, or which only restrict arguments."""


class Unkept(Exception):
    """Something that cannot be stated."""


def name_of(name: str, modules: tuple[str, ...], identity: Any, leaves: list[Any], tree: Any) -> str | None:
    """Return a digest of all that the trace of a program depends on; None if that is not certain.

    `modules` are that of its function, and modules and packages that its trace runs through; `identity` is everything
    that the function depends on beside its arguments, whose leaves and structure are those of `jax.tree.flatten`.
    """
    try:
        if any(module.partition(".")[0] != PACKAGE for module in modules):
            raise Unkept(modules)
        program = (name, modules, stated(identity), structure(tree), tuple(map(_shape, leaves)))
        facts = (*program, sources(), tuple(in_memory(modules)), surroundings())
    except (Unkept, OSError, RecursionError):
        return None
    return hashlib.sha256(repr(facts).encode()).hexdigest()


def _refused(value: Any) -> Any:
    raise Unkept(type(value))


def stated(value: Any, other: Callable[[Any], Any] = _refused) -> Any:
    """Return a value in tuples, words and numbers whose `repr` no other value has.

    It may be plain, an array of NumPy, a frozen dataclass of this package, or a collection of such; `other` states
    values of other kinds, and refuses them by default.
    """
    kind, parts = type(value), cast(Any, value)
    if kind in (type(None), bool, int, float, complex, str, bytes):
        return kind.__name__, repr(value)
    if isinstance(value, np.ndarray | np.generic) and kind.__module__ == "numpy" and value.dtype.kind in "biufcSU":
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return kind.__name__, value.dtype.str, value.shape, digest
    if kind in (tuple, list) or (isinstance(value, tuple) and _is_ours(kind)):
        return kind.__qualname__, *(stated(each, other) for each in parts)
    if kind is dict:
        return "dict", *((stated(key, other), stated(each, other)) for key, each in parts.items())
    if kind in (set, frozenset):
        return kind.__name__, *sorted((stated(each, other) for each in parts), key=repr)
    if is_dataclass(value) and _is_ours(kind):
        attributes = ((field.name, stated(getattr(value, field.name), other)) for field in fields(value))
        return kind.__module__, kind.__qualname__, *attributes
    return other(value)


def structure(tree: Any) -> Any:
    """State what JAX takes as the structure of arguments, in which the static fields of dataclasses are."""
    data = tree.node_data()
    if data is None:
        return "leaf" if tree.num_leaves else "nothing"
    kind, static = data
    if kind not in (tuple, list, dict, type(None)) and not _is_ours(kind):
        raise Unkept(kind)
    return kind.__module__, kind.__qualname__, stated(static), *map(structure, tree.children())


def _is_ours(kind: type) -> bool:
    """Return True if a class is the one of this package under its name."""
    if kind.__module__.partition(".")[0] != PACKAGE:
        return False
    return vars(sys.modules.get(kind.__module__, object)).get(kind.__qualname__) is kind


def _shape(leaf: Any) -> Any:
    kind = jax.typeof(leaf)
    if not isinstance(kind.dtype, np.dtype):
        raise Unkept(kind)  # keys of random numbers that have a type of their own
    if isinstance(leaf, jax.Array) and len(leaf.sharding.device_set) > 1:
        raise Unkept(leaf.sharding)
    return kind.shape, kind.dtype.name, kind.weak_type


def sources() -> Any:
    """Return a digest of this package's source, and the files of NumPyro, which may be installed from a checkout.

    They are refused if one is younger than the version of it that this process may have read.
    """
    # The package recorded the time of its import; clocks of files may differ by two seconds.
    since = getattr(sys.modules[PACKAGE], "_SINCE", 0.0) - 2.0
    ours = tuple(_files(Path(__file__).parents[1]))
    numpyro = sys.modules.get("numpyro")
    theirs = tuple(_files(Path(str(numpyro.__file__)).parent)) if numpyro else ()
    if not ours or any(changed > since for *_, changed in (*ours, *theirs)):
        raise Unkept("source")
    return _contents(tuple(path for path, *_ in ours), ours), theirs


def _files(folder: Path) -> Iterator[tuple[str, int, int, float]]:
    """Yield path, size, nanosecond of the last change, and second of it by the system, of all source files."""
    with os.scandir(folder) as entries:
        for entry in sorted(entries, key=lambda entry: entry.name):
            if entry.name.endswith(".py"):
                status = entry.stat()
                yield entry.path, status.st_size, status.st_mtime_ns, max(status.st_ctime, status.st_mtime)
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
    """Yield the content of modules and imported packages: constants, kernels, and the origin of functions.

    A constant that was set to another value, or a function that was replaced, makes a program another one.
    """
    within = tuple(f"{name}." for name in modules)
    for name, each in sorted(sys.modules.items()):
        if name in modules or name.startswith(within):
            # A package also has its imported modules as attributes, which depend on what ran before.
            content = sorted((k, v) for k, v in vars(each).items() if sys.modules.get(f"{name}.{k}") is not v)
            yield name, *((key, _content(value, name)) for key, value in content if key[:2] != "__")


def _content(value: Any, module: str) -> Any:
    """State an attribute of a module, or of a class that is defined there."""
    if isinstance(value, ModuleType):
        return "module", value.__name__
    if isinstance(value, type):
        return _class(value, module)
    if isinstance(value, property):
        return "property", *(_content(each, module) for each in (value.fget, value.fset))
    if isinstance(value, staticmethod | classmethod):
        return type(value).__name__, _content(value.__func__, module)
    return stated(value, lambda each: _function(each, module))


def _class(kind: type, module: str) -> Any:
    _trust(kind.__module__)
    named = ("class", kind.__module__, kind.__qualname__)
    if kind.__module__ != module:
        return named
    # Methods with two underscores may be written by hand; Python adds other such attributes for itself.
    parts = ((key, each) for key, each in vars(kind).items() if isinstance(each, FunctionType) or key[:2] != "__")
    return *named, *((key, _content(each, "")) for key, each in parts)


def _function(value: Any, module: str) -> Any:
    if isinstance(value, functools.partial):
        return "partial", *(_content(each, module) for each in (value.func, value.args, value.keywords))
    if isinstance(value, FunctionType):
        _trust(value.__module__)
        cells = tuple(_content(cell.cell_contents, "") for cell in value.__closure__ or ())
        return "function", value.__module__, value.__qualname__, value.__code__.co_firstlineno, cells
    if not isinstance(value, BuiltinFunctionType):
        _trust(type(value).__module__)
    _trust(getattr(value, "__module__", None) or PACKAGE)
    return type(value).__name__, *(str(getattr(value, key, None)) for key in ("__module__", "__qualname__"))


def _trust(module: str | None) -> None:
    # A function made by `exec` may have no module.
    if module is None or module.partition(".")[0] not in TRUSTED:
        raise Unkept(module)


def surroundings() -> Any:
    """Return versions, the backend and settings; inside a handler of NumPyro, which may change programs, refuse."""
    # A library whose version differs from the installed one is a checkout.
    loaded = [str(getattr(sys.modules.get(name), "__version__", None)) for name in LIBRARIES[:4]]
    versions = *loaded, *map(_installed, LIBRARIES)
    primitives, distributions = (sys.modules.get(f"numpyro.{name}") for name in ("primitives", "distributions"))
    if getattr(primitives, "_PYRO_STACK", None):
        raise Unkept("handlers")
    validated = getattr(getattr(distributions, "Distribution", None), "_validate_args", None)
    return versions, sys.version_info[:2], jax.default_backend(), settings(), repr(validated)


@functools.cache
def _installed(name: str) -> str:
    """Return the version of a library by its metadata; "" without any."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def settings() -> Any:
    """Return JAX's configuration, but not the folders of its caches; a value that has only an address is refused."""
    config: Any = jax.config
    values = [(key, repr(getattr(config, key, value))) for key, value in config.values.items() if "cache" not in key]
    if any(" at 0x" in text for _, text in values):
        raise Unkept("configuration")
    return tuple(values)
