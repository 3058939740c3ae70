"""Limits of the fields of a class, stated once, in the types of the fields.

A class refuses values beyond them when it is made; the sections of configuration files and the tables of catalogues
are derived from the same types.
"""

import math
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Lt

from .errors import InputError


@dataclass(frozen=True)
class OneOf:
    """Limit: one of the keys of a registry, as they are when a value is checked."""

    known: Mapping[str, Any] = field(repr=False)


@dataclass(frozen=True)
class Rule:
    """Limit that a function says is kept, with a message that follows the value in a sentence: "should be ..."."""

    holds: Callable[[Any], bool] = field(repr=False)
    words: str


Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]
Count = Annotated[int, Ge(1)]
Whole = Annotated[int, Ge(0)]
Seed = Whole
Probability = Annotated[float, Gt(0), Lt(1)]


def is_finite(value: Any) -> bool:
    """Return True if a value is one finite number."""
    if isinstance(value, str | bytes | bool):
        return False
    try:
        return math.isfinite(float(value))
    except (TypeError, ValueError, OverflowError):
        return False


def require_limits(part: object) -> None:
    """Raise InputError for the first field of an object that is beyond its limits."""
    for name, value, words in beyond_limits(part):
        raise InputError(f"{type(part).__name__}({name}={value!r}) {words}.")


def beyond_limits(part: object) -> Iterator[tuple[str, Any, str]]:
    """Yield the fields of an object that are beyond the limits of their types: name, value, and message."""
    for name, hint in get_type_hints(type(part), include_extras=True).items():
        value = getattr(part, name)
        for limit in _limits(hint) if value is not None else ():
            words = _broken(limit, value)
            if words is not None:
                yield name, value, words


def _limits(hint: Any) -> Iterator[Any]:
    """Yield the limits in a type, through the alternatives of a union and annotations."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Literal:
        yield OneOf(dict.fromkeys(arguments))
    elif origin is Annotated:
        yield from (*_limits(arguments[0]), *arguments[1:])
    elif origin in (Union, UnionType):
        for alternative in arguments:
            yield from _limits(alternative)


def _broken(limit: Any, value: Any) -> str | None:
    """Return the message on a value beyond a limit; None if it keeps to the limit."""
    match limit:
        case OneOf(known):
            return None if value in known else f"is not one of {', '.join(map(repr, known))}"
        case Rule(holds, words):
            return None if holds(value) else words
        case Gt(gt=bound):
            within, words = operator.gt, f"must exceed {bound}" if bound else "must be positive"
        case Ge(ge=bound):
            within, words = operator.ge, f"must be at least {bound}"
        case Lt(lt=bound):
            within, words = operator.lt, f"must be below {bound}"
        case _:
            return None
    try:
        return None if within(value, bound) else words
    except TypeError:
        # A value that cannot be compared with a number is beyond every limit.
        return words
