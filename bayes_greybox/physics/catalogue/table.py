"""The catalogue of effects as a table to read and to search."""

import pandas as pd

from bayes_greybox.running.errors import InputError

from .effects import Effect
from .loading import CatalogueSpec, load_catalogue

_COLUMNS = (
    "slug",
    "name",
    "domain",
    "expression",
    "roles",
    "inner",
    "hidden",
    "sign",
    "meaning",
    "reverse",
    "confusions",
)


def catalogue(domain: CatalogueSpec = "all", search: str | None = None) -> pd.DataFrame:
    """The effects that a study can name, as a table; `find_missing_effects` takes the same first argument.

    Args:
        domain: "mechanical", "fluid", "population", "electrical", "all", the path of a TOML file of the user's own,
            or a list of these.
        search: Words that must all occur in an effect, in any column, whatever their case; all effects by default.

    Returns:
        One row for each effect: slug, name, domain, expression over roles, the roles, the inner parameters, the hidden
        states of one that remembers, the sign that its coefficient has when it dissipates or restores (0: either), what
        it means, what the other sign would mean, and the slugs of effects that it is easily taken for.

    Raises:
        InputError: No such catalogue; no effect has the words.
    """
    table = pd.DataFrame([_row(effect) for effect in load_catalogue(domain)], columns=list(_COLUMNS))
    words = (search or "").casefold().split()
    texts = table.apply(lambda row: " ".join(map(str, row)).casefold(), axis=1)
    found = table.loc[[all(word in text for word in words) for text in texts]].reset_index(drop=True)
    if found.empty:
        raise InputError(f"No effect of the catalogue has {search!r} in it: search for one word, or in domain='all'.")
    return found


def _row(effect: Effect) -> tuple[object, ...]:
    inner = tuple(parameter.name for parameter in effect.inner)
    hidden = tuple(state.name for state in effect.hidden)
    return (
        effect.slug, effect.name, effect.domain, effect.expression, effect.roles, inner, hidden, effect.sign,
        effect.meaning, effect.reverse, effect.confusions,
    )  # fmt: skip
