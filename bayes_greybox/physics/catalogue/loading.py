"""Catalogues as they are asked for: domains of the package, files of the user's own, effects, and lists of these.

The packaged files stand beside this one, one for each domain; users write their own in the same layout (see
`effect_tables`).
"""

import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, cast

import pandas as pd

from bayes_greybox.data.reading.toml_files import read_toml
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.running.errors import InputError

from .effect_tables import effect_tables, keys_of, nearest
from .effects import Effect
from .inner_parameter import InnerParameter

DOMAINS = ("mechanical", "fluid", "population", "electrical", "thermal", "battery", "compartment", "vehicle")
"""Catalogues that come with the package."""

IN_ALL = tuple(domain for domain in DOMAINS if domain != "vehicle")
"""Catalogues of "all": those of vehicles are mechanical effects by other names, and one column is not two effects."""

CatalogueSpec = str | os.PathLike[str] | Effect | Sequence[str | os.PathLike[str] | Effect]
"""What `load_catalogue` takes."""

_TABLE_FIELDS = (
    "slug", "name", "domain", "expression", "roles", "inner", "hidden", "sign", "meaning", "reverse", "confusions",
)  # fmt: skip


def load_catalogue(spec: CatalogueSpec) -> tuple[Effect, ...]:
    """Read a catalogue: a domain, "all", the path of a TOML file, an `Effect`, or a sequence of these; each slug once.

    Raises:
        InputError: A domain is unknown, a file cannot be read or used, two different effects have one slug, a confusion
            names an unknown effect, or there are no effects at all.
    """
    effects: dict[str, Effect] = {}
    for effect in _each(spec):
        known = effects.setdefault(effect.slug, effect)
        # Some effects, such as a gain of the input, belong to several domains, each with look-alikes of its own.
        if known is not effect and replace(known, domain=effect.domain, confusions=effect.confusions) != effect:
            raise InputError(
                f"Two different effects have the slug {effect.slug!r} (in {known.domain} and {effect.domain}); "
                "rename one of them."
            )
        if known.confusions != effect.confusions:
            both = dict.fromkeys((*known.confusions, *effect.confusions))
            effects[effect.slug] = replace(known, confusions=tuple(both))
    if not effects:
        raise InputError(f"The catalogue is empty; give one of {', '.join(DOMAINS)}, 'all' or a TOML file.")
    _check_confusions(effects)
    return tuple(effects.values())


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
    effects = load_catalogue(domain)
    table = pd.DataFrame([{field: getattr(effect, field) for field in _TABLE_FIELDS} for effect in effects])
    for part in ("inner", "hidden"):
        table[part] = [tuple(each.name for each in parts) for parts in table[part]]
    words = (search or "").casefold().split()
    texts = table.apply(lambda row: " ".join(map(str, row)).casefold(), axis=1)
    matching = table.loc[[all(word in text for word in words) for text in texts]].reset_index(drop=True)
    if matching.empty:
        raise InputError(f"No effect of the catalogue has {search!r} in it: search for one word, or in domain='all'.")
    return matching


def located(spec: CatalogueSpec) -> CatalogueSpec:
    """Return the same catalogue for any working folder: paths of files become absolute."""
    if isinstance(spec, Effect) or spec in (*DOMAINS, "all"):
        return spec
    if isinstance(spec, str | os.PathLike):
        return str(Path(spec).absolute())
    return [cast(str | Effect, located(part)) for part in spec]


def _each(spec: Any) -> Iterator[Effect]:
    if isinstance(spec, Effect):
        yield spec
    elif isinstance(spec, str) and spec in (*DOMAINS, "all"):
        for domain in IN_ALL if spec == "all" else (spec,):
            yield from _packaged(domain)
    elif isinstance(spec, str | os.PathLike):
        yield from _own(spec)
    elif isinstance(spec, Sequence):
        for part in spec:
            yield from _each(part)
    else:
        raise InputError(
            f"A catalogue is a domain ({', '.join(DOMAINS)}), 'all', the path of a TOML file, an Effect or a list of "
            f"these, not {type(spec).__name__}."
        )


@cache
def _packaged(domain: str) -> tuple[Effect, ...]:
    file = resources.files(__package__ or "").joinpath(f"{domain}.toml")
    return _effects(tomllib.loads(file.read_text(encoding="utf-8")), domain)


def _own(path: str | os.PathLike[str]) -> tuple[Effect, ...]:
    given = Path(path)
    if isinstance(path, str) and not given.suffix and given.name == path and not given.exists():
        raise InputError(
            f"There is no catalogue {path!r}: {nearest(path, [*DOMAINS, 'all'])} Or give the path of a TOML file."
        )
    content, _ = read_toml(given, "catalogue")
    try:
        return _effects(content, given.stem)
    except InputError as error:
        raise InputError(f'"{path}": {error}') from None


def _effects(content: Mapping[str, Any], domain: str) -> tuple[Effect, ...]:
    # The domain is the whole file's, and the name of a nonlinear parameter or a hidden state that of its table.
    parts = {"inner": keys_of(InnerParameter, "name"), "hidden": keys_of(HiddenState, "name", "rest")}
    effects, domain = [], content.get("domain", domain)
    for table in effect_tables(content, keys_of(Effect, "domain"), parts):
        try:
            table["inner"] = tuple(InnerParameter(**item) for item in table["inner"])
            table["hidden"] = tuple(HiddenState(**item) for item in table["hidden"])
            effects.append(Effect(**{**table, "domain": domain, "confusions": tuple(table["confusions"])}))
        except InputError as error:
            raise InputError(f"effect {table['slug']!r}: {error}") from None
    return tuple(effects)


def _check_confusions(effects: Mapping[str, Effect]) -> None:
    for effect in effects.values():
        for slug in [slug for slug in effect.confusions if slug not in effects]:
            known = [*effects, *(entry.slug for domain in DOMAINS for entry in _packaged(domain))]
            if slug not in known:
                hint = nearest(slug, known)
                raise InputError(f"The effect {effect.slug!r} has the unknown {slug!r} among its confusions; {hint}")
