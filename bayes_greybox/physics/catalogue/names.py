"""Names of effects within a sentence."""

from collections.abc import Iterable

PERSONS = frozenset(
    {
        "Allee", "Bouc", "Coulomb", "Dahl", "Darcy", "Duffing", "Haldane", "Hertz", "Hill", "Holling", "Maxwell",
        "Michaelis", "Monod", "Morison", "Newton", "Ohm", "Prandtl", "Rayleigh", "Stribeck", "Torricelli", "Van",
    }
)  # fmt: skip
"""First words of names that keep their capital: people's, of the catalogue and of files of a user's own."""


def within(name: str) -> str:
    """Write a name as it stands within a sentence: *cubic stiffness*, but *Coulomb friction* and *LuGre friction*.

    Names of several effects are joined by " + ".
    """
    return " + ".join(map(_lowered, name.split(" + ")))


def listing(names: Iterable[str], between: str = " + ") -> str:
    """Join names where a sentence or a label begins: only the first has its capital."""
    return between.join(name if place == 0 else within(name) for place, name in enumerate(names))


def slug_and_columns(label: str) -> tuple[str, list[str]]:
    """Return slug and columns of an effect from its label, `cube(r=u)`; a slug alone has no columns."""
    slug, _, roles = label.removesuffix(")").partition("(")
    return slug, sorted({part.partition("=")[2] for part in roles.split(", ")}) if roles else []


def _lowered(name: str) -> str:
    word = name.replace("-", " ").split(" ", 1)[0]
    # A word with capitals further on is a name or a short form: LuGre, DC.
    kept = word in PERSONS or word[1:] != word[1:].lower() or len(word) == 1
    return name if kept else name[:1].lower() + name[1:]
