"""Names of columns as identifiers of other languages, and text that cannot leave the comment it stands in."""

import re
import unicodedata
from collections.abc import Collection, Iterable, Sequence

_ASCII_SIGNS = {
    "±": "+-", "−": "-", "–": "-", "·": "*", "⋅": "*", "×": "*", "°": "deg", "µ": "u", "μ": "u", "Ω": "Ohm", "∞": "inf",
    "≥": ">=", "≤": "<=",
}  # fmt: skip
_RAISED_DIGITS = {"⁻": "-", **{raised: str(k) for k, raised in enumerate("⁰¹²³⁴⁵⁶⁷⁸⁹")}}


def distinct(wanted: Sequence[str], taken: Iterable[str]) -> list[str]:
    """Return names that differ from each other and from those that are taken, by underscores at their ends."""
    used, names = set(taken), []
    for name in wanted:
        while name in used:
            name = f"{name}_"
        used.add(name)
        names.append(name)
    return names


def identifiers(names: Sequence[str], reserved: Collection[str]) -> dict[str, str]:
    """Return an identifier of ASCII letters, digits and underscores for each name; the name itself if it is one.

    None is one of `reserved`: words of the language, and names that the program uses itself.
    """
    plain = {name: _plain(name) for name in names}
    # Those that stay as they are come first, so that no other takes their name.
    order = sorted(names, key=lambda name: plain[name] != name)
    return dict(zip(order, distinct([plain[name] for name in order], reserved), strict=True))


def ascii_text(text: str) -> str:
    """Return text in ASCII, on one line: ± as +-, m² as m^2; a letter without a likeness by its name."""
    text = re.sub("[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda match: f"^{''.join(_RAISED_DIGITS[c] for c in match[0])}", text)
    return "".join(_ASCII_SIGNS.get(char) or _letter(char) for char in one_line(text))


def one_line(text: str) -> str:
    """Return text on one line, without characters that do not show."""
    return " ".join("".join(c if c.isprintable() or c.isspace() else " " for c in text).split())


def within_c(text: str) -> str:
    """Return text for a comment of C, which cannot end it."""
    # A backslash at the end of a line would join the next one to it, and ??/ is one.
    return ascii_text(text).replace("*/", "* /").replace("/*", "/ *").replace("\\", "/").replace("??", "? ?")


def quoted(text: str) -> str:
    """Return text as a string of Modelica."""
    escaped = ascii_text(text).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _plain(name: str) -> str:
    word = re.sub(r"\W", "_", "".join(_letter(char) for char in name), flags=re.ASCII)
    # Names that start with an underscore belong to compilers.
    return word if re.match("[A-Za-z]", word) else f"v{word}"


def _letter(char: str) -> str:
    if char.isascii():
        return char
    likeness = unicodedata.normalize("NFKD", char).encode("ascii", "ignore").decode()
    if likeness.strip():
        return likeness
    if unicodedata.category(char) == "Zs":
        return " "
    name = unicodedata.name(char, "")
    spoken = re.search(r"LETTER ([A-Z]+)(?: |$)", name)
    word = spoken[1].lower() if spoken else f"u{ord(char):04x}"
    return word.capitalize() if "CAPITAL" in name else word
