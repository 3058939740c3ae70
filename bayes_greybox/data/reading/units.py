"""Units that a table states: behind the names of columns, in a row below them, or as attributes."""

import re
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any


@cache
def registry() -> Any:
    """Return pint's table of units, built on first use (it takes a noticeable part of a second)."""
    import pint

    return pint.UnitRegistry()


# Spellings of instruments that pint does not read, or reads as something else ("Nm" as number times metre).
_SPELLINGS = {"Nm": "N*m", "kNm": "kN*m", "mNm": "mN*m", "U/min": "rpm", "1/min": "1/min", "sek": "s", "Sek": "s"}
_ONE = "volt ampere newton pascal watt joule kelvin ohm hertz second minute hour meter metre degree radian"
_WORDS = {*_ONE.split(), *(f"{word}s" for word in _ONE.split()), *"bar sec min amp amps rad deg rpm".split()}
_UNITLESS = {"", "-", "--", "–", "none", "n/a"}
_BRACKETED = re.compile(r"^\[(.*)\]$|^\((.*)\)$")
_HEADER = re.compile(r"^(?P<name>.*?\S)\s*\[(?P<square>[^\[\]]*)\]$|^(?P<name2>.*?\S)\s+\((?P<round>[^()]*)\)$")


def known_unit(text: str) -> str | None:
    """Return a unit in the spelling of the package, such as "m/s"; None if it is not known.

    The table may write "m/s", "m s-1", "Volts" or "seconds since 2024-01-01".
    """
    text = re.sub(r" since .*$", "", text.strip())
    if len(text) > 40 or not re.search(r"[^\W\d]|[%°\"1]", text):
        return None
    if text in _SPELLINGS:
        return _SPELLINGS[text]
    # Powers without a sign for them, as the CF conventions have: m s-2.
    powers = re.sub(r"(?<=[A-Za-zµΩ])(-?\d)(?!\d)", r"^\1", text).replace(" ", "*")
    # Whole words may begin with a capital; elsewhere it has a meaning: Nl is no nanolitre.
    words = re.sub(r"[A-Za-z]+", lambda word: word[0].lower() if word[0].lower() in _WORDS else word[0], powers)
    for attempt in dict.fromkeys((text, powers, words)):
        try:
            registry().parse_units(attempt)
        except Exception:  # pint raises errors of many kinds on text that is no unit
            continue
        return attempt
    return None


def split_header(name: str) -> tuple[str, str | None]:
    """Split a header, such as "pos [mm]" or "pos (mm)", into name and unit; None if the brackets hold no unit."""
    match = _HEADER.match(name)
    if match is None:
        return name, None
    parts = match.groupdict()
    if parts["name"] is not None:
        # Square brackets mean a unit, even one that is not known; an index such as x[0] is none.
        unit = parts["square"].strip()
        return (name, None) if unit.isdigit() and unit != "1" else (parts["name"], unit)
    unit = parts["round"].strip()
    return (parts["name2"], unit) if not unit.isdigit() and (unit in _UNITLESS or known_unit(unit)) else (name, None)


def split_headers(names: Sequence[str]) -> list[tuple[str, str | None]]:
    """Split each header of one table as `split_header` does.

    "T (in)" is no temperature in inches beside "T (out)": brackets behind one name hold units, or none of them does.
    """
    split = [split_header(name) for name in names]
    stems = [match["name2"] if match else None for match in map(_HEADER.match, names)]
    unitless = {stem for stem, (_, unit) in zip(stems, split, strict=True) if stem and unit is None}
    return [(name, None) if stem in unitless else pair for name, stem, pair in zip(names, stems, split, strict=True)]


def unit_row(cells: Sequence[str], below: Sequence[bool]) -> list[str] | None:
    """Return the units of a row that holds nothing else; `below` is True where the next row has a number or a date."""
    if len(cells) != len(below) or not any(cells):
        return None
    units = []
    for cell, measured in zip(cells, below, strict=True):
        bracketed = _BRACKETED.match(cell)
        if (cell and not measured) or is_number(cell):
            return None
        if not (bracketed or cell in _UNITLESS or known_unit(cell)):
            return None
        units.append((bracketed[1] or bracketed[2] or "").strip() if bracketed else cell)
    return units if any(unit not in _UNITLESS for unit in units) else None


def checked_units(stated: Iterable[tuple[str, str]], where: str) -> tuple[dict[str, str], tuple[str, ...]]:
    """Return the known units by column, and a remark on the others."""
    units, unknown = {}, []
    for name, text in stated:
        unit = None if text.strip() in _UNITLESS else known_unit(text)
        if unit is not None:
            units[name] = unit
        elif text.strip() not in _UNITLESS:
            unknown.append(f'"{text}" of {name}')
    remark = f"units of {where} that are not known were left out: {', '.join(unknown)}; give them with units="
    return units, (remark,) if unknown else ()


def is_number(cell: str, decimal: str = ".") -> bool:
    """Return True if a cell of text is a number."""
    try:
        float(cell.replace(decimal, ".") if decimal != "." else cell)
    except ValueError:
        return False
    return True
