"""Type checks of objects that were read from a file, against the annotations of their classes."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence, Set
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from bayes_greybox.running.errors import InputError


def require_kinds(made: Any) -> None:
    """Require that all fields have the types of their annotations, or raise InputError."""
    for name, hint in get_type_hints(type(made), include_extras=True).items():
        if hasattr(made, name) and not fits(getattr(made, name), hint):
            raise InputError(f"the file is damaged: {name} of {type(made).__name__} is not what it must be.")


def fits(value: Any, hint: Any) -> bool:
    """Return True if a value and everything in it match a type annotation.

    For arrays this covers dtype and number of dimensions, but not sizes that several arrays share.
    """
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return fits(value, args[0])
    if origin in (Union, UnionType):
        return any(fits(value, each) for each in args)
    if origin is Literal:
        return any(type(value) is type(each) and value == each for each in args)
    if hint is Any or hint is None:
        return hint is Any or value is None
    if origin in (tuple, list, frozenset, Sequence, Set):
        if isinstance(value, str) or not isinstance(value, (tuple, list) if origin is Sequence else origin):
            return False
        hints = args if origin is tuple and args[-1:] != (...,) else args[:1] * len(value)
        return len(value) == len(hints) and all(map(fits, value, hints))
    if origin in (Mapping, dict):
        return isinstance(value, Mapping) and all(fits(k, args[0]) and fits(v, args[1]) for k, v in value.items())
    if hint in (Callable, callable) or origin is Callable:
        return callable(value)
    if hint in (int, float):
        return isinstance(value, int if hint is int else int | float) and not isinstance(value, bool)
    # typing.is_protocol needs Python 3.13.
    if getattr(hint, "_is_protocol", False):
        return dataclasses.is_dataclass(value)
    return not isinstance(hint, type) or isinstance(value, hint)
