"""Equations that share their rows: their joint dictionary, and states that only other equations mention."""

from collections.abc import Container, Mapping
from typing import Any

from bayes_greybox.physics.formula.expressions import parse_expression, symbol_names
from bayes_greybox.physics.terms import Dictionary, terms_of


def by_block(blocks: Mapping[str, tuple[str, ...]], dictionaries: Mapping[str, Dictionary]) -> dict[str, Dictionary]:
    """Return dictionaries by block, from those by learned state; equations that share their rows have a joint one."""
    return {
        name: dictionaries[name]
        if name in dictionaries
        else Dictionary.joined({each: dictionaries[each] for each in equations})
        for name, equations in blocks.items()
    }


def used_states(
    dictionary: Mapping[str, Any], simulation: Mapping[str, str], columns: Container[str]
) -> tuple[str, ...]:
    """Return learned states without data that another equation uses; one that nothing uses is a slip of the pen.

    Raises:
        InputError: Terms or expressions that cannot be read.
    """
    unknown = [name for name in dictionary if name not in columns and name not in simulation]
    if not unknown:
        return ()
    used: dict[str, set[str]] = {name: set(_names(text)) for name, text in simulation.items()}
    for name, terms in dictionary.items():
        used.setdefault(name, set()).update(*(term.symbols for term in terms_of(terms)))
    return tuple(name for name in unknown if any(name in each for state, each in used.items() if state != name))


def _names(text: str) -> tuple[str, ...]:
    return symbol_names(parse_expression(str(text)))
