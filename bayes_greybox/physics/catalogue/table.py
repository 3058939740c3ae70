"""The catalogue of effects as a table to read and to search."""

from collections.abc import Mapping

import pandas as pd

from bayes_greybox.running.errors import InputError

from .effects import Effect
from .loading import CatalogueSpec, load_catalogue

_TABLE_FIELDS = (
    "slug", "name", "domain", "expression", "roles", "inner", "hidden", "sign", "meaning", "reverse", "confusions",
)  # fmt: skip


def catalogue(domain: CatalogueSpec = "all", search: str | None = None) -> pd.DataFrame:
    """List the effects that a study can name, as a table; `find_missing_effects` takes the same first argument.

    Args:
        domain: "mechanical", "fluid", "population", "electrical", "thermal", "battery", "compartment", "vehicle",
            "all", the path of a TOML file of the user's own, or a list of these.
        search: Words that must all occur in an effect, in any column and in either case; all effects by default.

    Returns:
        One row for each effect: slug, name, domain, expression over roles, the roles, the nonlinear parameters, the
        hidden states of one with memory, the sign of its coefficient when it dissipates or restores (0: either), its
        meaning, the meaning of the other sign, and the slugs of effects that it is easily taken for.

    Raises:
        InputError: There is no such catalogue, or no effect has the words.
    """
    table = pd.DataFrame([_row(effect) for effect in load_catalogue(domain)])
    words = (search or "").casefold().split()
    texts = table.apply(lambda row: " ".join(map(str, row)).casefold(), axis=1)
    matching = table.loc[[all(word in text for word in words) for text in texts]].reset_index(drop=True)
    if matching.empty:
        raise InputError(f"No effect of the catalogue has {search!r} in it: search for one word, or in domain='all'.")
    return matching


def _row(effect: Effect) -> Mapping[str, object]:
    names = {part: tuple(each.name for each in getattr(effect, part)) for part in ("inner", "hidden")}
    return {field: getattr(effect, field) for field in _TABLE_FIELDS} | names
