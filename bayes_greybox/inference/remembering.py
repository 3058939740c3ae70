"""Results about a posterior that are computed once and kept with it."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from .posterior import Posterior

Result = TypeVar("Result")


def remembered(function: Callable[[Posterior], Result]) -> Callable[[Posterior], Result]:
    """Compute a result about a posterior once; later calls return the same object."""
    name = _name(function)

    @wraps(function)
    def once(posterior: Posterior) -> Result:
        if name not in posterior.memory:
            posterior.memory[name] = function(posterior)
        return posterior.memory[name]

    return once


def recall(posterior: Posterior, function: Callable[[Posterior], Result]) -> Result | None:
    """Return the result of a `remembered` function if it has been called for this posterior."""
    return posterior.memory.get(_name(function))


def remember(posterior: Posterior, function: Callable[[Posterior], Result], result: Result) -> None:
    """Have a `remembered` function return a result that was read from a file."""
    posterior.memory[_name(function)] = result


def _name(function: Callable[..., Any]) -> str:
    # A name, not the function, so that a posterior can be pickled.
    return f"{function.__module__}.{function.__qualname__}"
