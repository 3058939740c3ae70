"""The text of the catalogue's pages: every effect of its TOML files."""

from bayes_greybox.physics.catalogue.effects import Effect
from bayes_greybox.physics.catalogue.inner_parameter import InnerParameter
from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.physics.catalogue.roles import ROLES

DOMAINS = {
    "mechanical": "Forces over masses: effects in the equation of a velocity.",
    "fluid": "Flows in and out of tanks: effects in the equation of a level.",
    "population": "Growth, death and meetings: effects in the equation of a population.",
    "electrical": "Losses, sources and storage: effects in the equation of a voltage, a current or a flux.",
    "thermal": "Heat flows over heat capacities: effects in the equation of a temperature.",
    "battery": "Effects in the voltage of a cell, an output, whose current is an input in A.",
    "compartment": "What becomes of a substance: effects in the equation of a concentration.",
    "vehicle": "Forces over the mass of a vehicle: effects in the equation of its speed.",
}
"""The packaged catalogues, and what is in each."""


def page(domain: str) -> str:
    """The text of a catalogue's page, in MyST Markdown; it shows the picture SLUG.svg of each effect."""
    effects = load_catalogue(domain)
    names = {effect.slug: effect.name for effect in effects}
    used = sorted({role for effect in effects for role in effect.roles})
    roles = [f"| `{role}` | {ROLES.get(role, '')} |" for role in used]
    parts = [
        f"# {domain.capitalize()} effects\n\n{DOMAINS[domain]} {len(effects)} effects, rendered from "
        f"`bayes_greybox/physics/catalogue/{domain}.toml`. Pictures show the formula with the coefficient 1 over "
        "columns between −1 and 1 (or 0 and 1).",
        "\n".join(["| role | what it is in the equation of one state |", "|---|---|", *roles]),
        *(_entry(effect, domain, names) for effect in effects),
    ]
    return "\n\n".join(parts) + "\n"


def _entry(effect: Effect, domain: str, names: dict[str, str]) -> str:
    rows = [("slug", f"`{effect.slug}`"), ("formula", f"${effect.latex}$"), ("in roles", f"`{effect.expression}`")]
    rows += [(f"state `{state.name}`", f"{state.meaning}; its rate is `{state.rate}`") for state in effect.hidden]
    rows += [(f"parameter `{inner.name}`", _range(inner)) for inner in effect.inner]
    rows.append(("coefficient", _sign(effect)))
    if effect.family:
        rows.append(("family", effect.family))
    if effect.confusions:
        links = [f"[{names[slug]}](#effect-{domain}-{slug})" for slug in effect.confusions if slug in names]
        rows.append(("easily taken for", ", ".join(links)))
    table = ["| | |", "|---|---|", *(f"| {key} | {_cell(value)} |" for key, value in rows)]
    drawn = f"{domain}-{effect.slug}.svg\n:alt: The formula of {effect.name} drawn."
    picture = f"```{{image}} {drawn}\n:class: effect dark-light\n```"
    return "\n\n".join(
        [f"(effect-{domain}-{effect.slug})=\n## {effect.name}", effect.meaning, picture, "\n".join(table)]
    )


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _sign(effect: Effect) -> str:
    if not effect.sign:
        return "of either sign"
    usual = "negative" if effect.sign < 0 else "positive"
    return f"usually {usual}; the other sign {effect.reverse}" if effect.reverse else f"usually {usual}"


def _range(inner: InnerParameter) -> str:
    return f"{inner.meaning}; from {inner.low:g} to {inner.high:g} times {inner.scaled_by}"


def index() -> str:
    """The text of the page that lists the catalogues: the picture of each effect, by catalogue."""
    lead = [
        "# The catalogue\n",
        'What a study can name. `bg.catalogue()` has the same as a table, `bg.catalogue(search="friction")`',
        'searches it, and `catalogue=` of `bg.find_missing_effects` takes the name of one of these, `"all"`, or',
        "[a file of your own](/howto/memory.md).",
    ]
    toctree = "\n".join(["```{toctree}", ":hidden:\n", *DOMAINS, "```\n"])
    return "\n\n".join(["\n".join(lead), *map(_thumbnails, DOMAINS), toctree])


def _thumbnails(domain: str) -> str:
    effects = load_catalogue(domain)
    heading = f"## [{domain.capitalize()}]({domain}.md)\n\n{len(effects)} effects. {DOMAINS[domain]}"
    pictures = [
        f"```{{figure}} {domain}-{effect.slug}.svg\n:target: {domain}.html#effect-{domain}-{effect.slug}\n"
        f":class: dark-light\n:alt: The formula of {effect.name} drawn.\n\n{effect.name}\n```"
        for effect in effects
    ]
    return "\n\n".join([heading, ":::{container} thumbnails", *pictures, ":::"])
