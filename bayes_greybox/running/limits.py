"""Limits of the fields of a class, stated once, in the types of the fields.

A class refuses values beyond them when it is made; the sections of configuration files and the tables of catalogues
are derived from the same types.
"""

import math
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
    """Limit with a sentence of its own.

    Attributes:
        holds: Function that returns True if a value keeps to the limit.
        words: Message that follows the value in a sentence: "should be ...".
    """

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
    """Refuse an object with a field beyond its limits.

    Raises:
        InputError: The first such field, its value and the limit.
    """
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
    origin = get_origin(hint)
    if origin is Literal:
        yield OneOf(dict.fromkeys(get_args(hint)))
    elif origin is Annotated:
        yield from _limits(get_args(hint)[0])
        yield from get_args(hint)[1:]
    elif origin in (Union, UnionType):
        for alternative in get_args(hint):
            yield from _limits(alternative)


def _broken(limit: Any, value: Any) -> str | None:
    """Return the message on a value beyond a limit; None if it keeps to the limit."""
    match limit:
        case OneOf(known):
            return None if value in known else f"is not one of {', '.join(map(repr, known))}"
        case Rule(holds, words):
            return None if holds(value) else words
        case Gt(gt=bound):
            words = f"must exceed {bound}" if bound else "must be positive"
            return None if _compared(lambda: value > bound) else words
        case Ge(ge=bound):
            return None if _compared(lambda: value >= bound) else f"must be at least {bound}"
        case Lt(lt=bound):
            return None if _compared(lambda: value < bound) else f"must be below {bound}"
    return None


def _compared(comparison: Callable[[], Any]) -> bool:
    try:
        return bool(comparison())
    except TypeError:
        # A value that cannot be compared with a number is beyond every limit.
        return False
