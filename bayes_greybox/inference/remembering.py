"""What was found out about a posterior is kept with it, and found once."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from .posterior import Posterior

Result = TypeVar("Result")


def remembered(function: Callable[[Posterior], Result]) -> Callable[[Posterior], Result]:
    """Find something out about a posterior once; later calls return the same object."""
    name = _name(function)

    @wraps(function)
    def once(posterior: Posterior) -> Result:
        if name not in posterior.memory:
            posterior.memory[name] = function(posterior)
        return posterior.memory[name]

    return once


def recall(posterior: Posterior, function: Callable[[Posterior], Result]) -> Result | None:
    """What a `remembered` function found of a posterior; None where it was not asked yet."""
    return posterior.memory.get(_name(function))


def remember(posterior: Posterior, function: Callable[[Posterior], Result], found: Result) -> None:
    """Have a `remembered` function return what was found before, of a posterior that was read from a file."""
    posterior.memory[_name(function)] = found


def _name(function: Callable[..., Any]) -> str:
    # A name, not the function: a posterior read from a file can be pickled, whatever it was asked.
    return f"{function.__module__}.{function.__qualname__}"
