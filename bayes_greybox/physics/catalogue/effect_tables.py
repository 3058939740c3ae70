"""The layout of a catalogue file: tables of text and numbers, checked, before they become effects.

A file has `[[effect]]` tables with the fields of `Effect`, and optionally nonlinear parameters as
`[effect.inner.NAME]` with the fields of `InnerParameter`, and hidden states as `[effect.hidden.NAME]` with those of
`HiddenState`. Keys and their types are read from the classes; a file explains itself, so it needs the meaning too.
"""

import dataclasses
from collections.abc import Mapping
from difflib import get_close_matches
from types import UnionType
from typing import Any, NamedTuple, get_args, get_origin, get_type_hints

from bayes_greybox.running.errors import InputError

_TOML_WORDS = {str: "text in quotes", list: "a list", dict: "a table", float: "a number", int: "a whole number"}


_PART_WORDS = {"inner": ("nonlinear parameter", "parameter", "gap"), "hidden": ("hidden state", "state", "z")}
"""Subject of each table within an effect, the thing that it is named after, and an example of a name."""


class Keys(NamedTuple):
    """Keys of a table: the TOML type of each, and the required ones."""

    types: dict[str, type]
    needed: tuple[str, ...]


def keys_of(part: type, *elsewhere: str) -> Keys:
    """Return the keys of a table with the fields of a dataclass, without those that stand elsewhere in the file."""
    hints = get_type_hints(part)
    fields = [field for field in dataclasses.fields(part) if field.init and field.name not in elsewhere]
    needed = [f.name for f in fields if f.default is dataclasses.MISSING or f.name == "meaning"]
    return Keys({field.name: _in_toml(hints[field.name]) for field in fields}, tuple(needed))


def _in_toml(hint: Any) -> type:
    """Return the TOML type of a field: tables with names stand for a tuple of parts, a list for one of plain values."""
    if get_origin(hint) is UnionType:
        hint = get_args(hint)[0]
    if get_origin(hint) is tuple:
        return dict if dataclasses.is_dataclass(get_args(hint)[0]) else list
    return hint


def effect_tables(content: Mapping[str, Any], effect: Keys, parts: Mapping[str, Keys]) -> list[dict[str, Any]]:
    """Check a catalogue file and return one complete table for each effect.

    `parts` has the keys of the tables within an effect: "inner", its nonlinear parameters, and "hidden", its hidden
    states. They become lists of tables that carry their name.
    """
    _check_keys(content, Keys({"domain": str, "effect": list}, ()), "")
    tables = content.get("effect", [])
    if not tables:
        raise InputError("there are no effects; write at least one table [[effect]].")
    effects = [_effect_table(table, place, effect, parts) for place, table in enumerate(tables, start=1)]
    slugs = [table["slug"] for table in effects]
    if twice := [slug for slug in slugs if slugs.count(slug) > 1]:
        raise InputError(f"the slug {twice[0]!r} occurs {slugs.count(twice[0])} times; give every effect its own.")
    return effects


def nearest(word: str, known: list[str]) -> str:
    """Suggest the known word that is probably meant, or list all of them, as the end of a sentence."""
    near = get_close_matches(word.lower(), known, n=1, cutoff=0.6)
    return f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}."


def _effect_table(table: Any, place: int, effect: Keys, parts: Mapping[str, Keys]) -> dict[str, Any]:
    if not isinstance(table, Mapping):
        raise InputError("an effect is a table; start it with the line [[effect]].")
    slug = table.get("slug")
    where = f"effect {slug!r}: " if isinstance(slug, str) and slug else f"effect number {place}: "
    _check_keys(table, effect, where)
    confusions = table.get("confusions", [])
    if not all(isinstance(item, str) for item in confusions):
        raise InputError(f"{where}confusions = {confusions!r} cannot be used; it must be a list of slugs in quotes.")
    read = {"confusions": confusions}
    for part, keys in parts.items():
        (called, after, such), read[part] = _PART_WORDS[part], []
        for name, each in table.get(part, {}).items():
            if not isinstance(each, Mapping):
                raise InputError(
                    f"{where}{part} must hold a table named after the {after}; start it with a line such as "
                    f"[effect.{part}.{such}]."
                )
            _check_keys(each, keys, f"{where}{called} {name!r}: ")
            numbers = {key: float(value) for key, value in each.items() if keys.types[key] is float}
            read[part].append({**each, **numbers, "name": name})
    return {**table, **read}


def _check_keys(table: Mapping[str, Any], keys: Keys, where: str) -> None:
    for key, value in table.items():
        if key not in keys.types:
            raise InputError(f"{where}unknown key {key!r}; {nearest(key, list(keys.types))}")
        kind = keys.types[key]
        # To Python, true and false are numbers.
        if isinstance(value, bool) or not isinstance(value, int | float if kind is float else kind):
            raise InputError(f"{where}{key} = {value!r} cannot be used; it must be {_TOML_WORDS[kind]}.")
        if isinstance(value, str) and not value.strip() and key != "unit_of":
            raise InputError(f"{where}{key} is empty; write it or leave it out.")
    for key in keys.needed:
        if key not in table:
            raise InputError(f"{where}needs the key {key!r}.")
