"""The layout of a catalogue file: tables of text and numbers, checked, before they become effects.

A file has `[[effect]]` tables with the keys slug, name, expression and meaning, and optionally latex,
confusions and one inner parameter as `[effect.inner.NAME]` with meaning, of, low, high and unit_of.
"""

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

from bayes_greybox.data.errors import InputError

_FILE = {"domain": str, "effect": list}
_EFFECT = {
    "slug": str, "name": str, "expression": str, "meaning": str, "latex": str, "confusions": list, "inner": dict
}  # fmt: skip
_NEEDED = ("slug", "name", "expression", "meaning")
_INNER = {"meaning": str, "of": str, "low": float, "high": float, "unit_of": str}
_INNER_NEEDED = ("meaning", "of", "low", "high")
_WANTED = {str: "text in quotes", list: "a list", dict: "a table", float: "a number"}


def effect_tables(content: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The effects of a catalogue file.

    Args:
        content: The file, as TOML reads it.

    Returns:
        One table for each effect, complete and with values of the right kind; `inner` is a list of tables
        that carry their name.

    Raises:
        InputError: An unknown or missing key, a value of the wrong kind, no effects, a slug twice, or more
            than one inner parameter of an effect.
    """
    _check_keys(content, _FILE, (), "")
    tables = content.get("effect", [])
    if not tables:
        raise InputError("there are no effects; write at least one table [[effect]].")
    effects = [_effect_table(table, place) for place, table in enumerate(tables, start=1)]
    slugs = [effect["slug"] for effect in effects]
    for slug in slugs:
        if slugs.count(slug) > 1:
            raise InputError(f"the slug {slug!r} occurs {slugs.count(slug)} times; give every effect its own.")
    return effects


def nearest(word: str, known: list[str]) -> str:
    """The known word that is probably meant, or all of them, as the end of a sentence."""
    near = get_close_matches(word.lower(), known, n=1, cutoff=0.6)
    return f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}."


def _effect_table(table: Any, place: int) -> dict[str, Any]:
    if not isinstance(table, Mapping):
        raise InputError("an effect is a table; start it with the line [[effect]].")
    slug = table.get("slug")
    where = f"effect {slug!r}: " if isinstance(slug, str) and slug else f"effect number {place}: "
    _check_keys(table, _EFFECT, _NEEDED, where)
    confusions = table.get("confusions", [])
    if not all(isinstance(item, str) for item in confusions):
        raise InputError(f"{where}confusions = {confusions!r} cannot be used; it must be a list of slugs in quotes.")
    inner = table.get("inner", {})
    if len(inner) > 1 and all(isinstance(item, Mapping) for item in inner.values()):
        raise InputError(
            f"{where}has {len(inner)} inner parameters ({', '.join(inner)}); one at most can be integrated over: "
            "fix the others at numbers in the expression."
        )
    return {**table, "confusions": confusions, "inner": [_inner_table(name, inner[name], where) for name in inner]}


def _inner_table(name: str, table: Any, where: str) -> dict[str, Any]:
    if not isinstance(table, Mapping):
        raise InputError(
            f"{where}inner must hold a table named after the parameter; start it with a line such as "
            "[effect.inner.gap]."
        )
    where = f"{where}inner parameter {name!r}: "
    _check_keys(table, _INNER, _INNER_NEEDED, where)
    return {**table, "name": name, "low": float(table["low"]), "high": float(table["high"])}


def _check_keys(table: Mapping[str, Any], kinds: Mapping[str, type], needed: tuple[str, ...], where: str) -> None:
    for key, value in table.items():
        if key not in kinds:
            raise InputError(f"{where}unknown key {key!r}; {nearest(key, list(kinds))}")
        kind = kinds[key]
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (number if kind is float else isinstance(value, kind)):
            raise InputError(f"{where}{key} = {value!r} cannot be used; it must be {_WANTED[kind]}.")
        if isinstance(value, str) and not value.strip() and key != "unit_of":
            raise InputError(f"{where}{key} is empty; write it or leave it out.")
    for key in needed:
        if key not in table:
            raise InputError(f"{where}needs the key {key!r}.")
