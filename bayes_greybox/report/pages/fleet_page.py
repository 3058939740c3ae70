"""The page of a fleet: what assets lack together, each effect pooled over them, and all assets by their gap."""

import os
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial

from bayes_greybox.discovery.fleet.shared import AssetStudy, Fleet, Shared
from bayes_greybox.inference.kept.netcdf import versions
from bayes_greybox.physics.catalogue.names import within
from bayes_greybox.report.plots.studies import plot_pooled
from bayes_greybox.report.plots.style import with_unit
from bayes_greybox.report.tables import table_of
from bayes_greybox.report.words.fleet import fleet_sentence, lacks_text, likely_text, not_pooled, shared_text, unit_of

from ..words.formatting import estimate, formula, interval, known_share, number, probability_text, unit_text
from .page import Badge, Card, Cards, Page, Pictures, Section, Words, time_picture, write_page
from .shared import footer


def fleet_html(fleet: Fleet, path: str | os.PathLike[str], pages: dict[str, str] | None = None) -> None:
    """Write the report of a fleet, with links to the `pages` of its assets, as one HTML file; see `write_page`."""
    write_page(fleet_page(fleet, pages or {}), path)


def fleet_page(fleet: Fleet, pages: dict[str, str]) -> Page:
    """Return the report of a fleet; see `fleet_html`."""
    alerts = [f"{each.asset} could not be studied: {each.sentence}" for each in fleet.failed]
    alerts += [f"The sampler did not converge for {e.asset}." for e in fleet.studied if e.converged is False]
    cause = fleet.causes[0] if len(fleet.causes) == 1 else None
    badge = _badge(fleet)
    others = {"wrong coefficient": fleet.recalibrated, "fault of the measurement": fleet.mismeasured}
    counts = {"Assets": len(fleet.assets), "lacking something": fleet.lacking, **{k: n for k, n in others.items() if n}}
    return Page(
        title=f"Fleet: {badge.text.lower()}",
        kind="bayes_greybox · fleet of studies",
        headline=fleet_sentence(fleet),
        badges=[badge],
        facts=[f"{name}: {n}" for name, n in {**counts, "failed": len(fleet.failed)}.items()],
        alerts=alerts,
        opening=_pooled_numbers(cause),
        sections=[_shared(fleet), _assets(fleet, pages)],
        footer=footer(versions()["bayes-greybox"]),
    )


def _badge(fleet: Fleet) -> Badge:
    if not fleet.studied:
        return Badge("Nothing studied", "bad", "!")
    if not fleet.lacking:
        if fleet.recalibrated and fleet.mismeasured:
            return Badge("Coefficients and measurements", "warn", "⟳")
        if fleet.recalibrated:
            return Badge("Recalibrate", "warn", "⟳")
        return Badge("The measurement", "warn", "∿") if fleet.mismeasured else Badge("No gap", "good", "✓")
    if not fleet.shared:
        return Badge("No name", "warn", "?")
    if fleet.causes:
        return Badge("One cause" if len(fleet.causes) == 1 else "Causes in common", "good", "✓")
    if fleet.lacking == 1:
        return Badge("One asset", "warn", "1")
    return Badge("No sure cause", "warn", "?") if fleet.suspected else Badge("Several causes", "warn", "≈")


def _pooled_numbers(cause: Shared | None) -> list[Section]:
    if cause is None or cause.whole is None:
        return []
    whole, unit = cause.whole, f" {unit_text(cause.unit)}".rstrip()
    mean, between = f"{number(whole.mean)}{unit}", f"{number(whole.between)}{unit}"
    span = f"{number(whole.between_lower)} to {number(whole.between_upper)}"
    about = "standard deviation of their coefficients, 90\u00a0% interval"
    cards = [
        Card("Mean", "of the assets that lack it, 90\u00a0% interval", mean, note=interval(whole.lower, whole.upper)),
        Card("Between assets", about, between, note=span),
        Card("One coefficient for all", "probability, 0.5 beforehand", probability_text(whole.same)),
    ]
    return [Section("numbers", shared_text(cause), "", [Cards(cards)])]


def _shared(fleet: Fleet) -> Section:
    if not fleet.shared:
        return Section("lacks", "What they lack", blocks=[Words("No effect was added to the model of any asset.")])

    def span(ends: Iterable[float]) -> str:
        return " to ".join(dict.fromkeys(map(number, ends)))

    columns: dict[str, Callable[[Shared], str]] = {
        "effect": lambda each: each.name,
        "equation": lambda each: each.equation,
        # Those that have it for sure, and those that may.
        "#assets": lambda e: f"{len(e.assets)}{f' to {len({*e.assets, *e.possible})}' if e.possible else ''}",
    }
    if any(each.likely for each in fleet.shared):
        columns["#P where not sure"] = lambda each: likely_text(each.likely.values())
        columns["or a fault of a sensor"] = lambda each: ", ".join(each.faults) or "–"
    columns |= {
        "#mean": lambda each: "–" if each.whole is None else estimate(each.whole.mean, each.whole.sd),
        "#between assets": lambda each: "–" if each.whole is None else number(each.whole.between),
        "#P(one for all)": lambda each: "–" if each.whole is None else probability_text(each.whole.same),
        "nonlinear parameters": lambda each: ", ".join(f"{k} {span(v)}" for k, v in each.inner.items()) or "–",
        "unit": unit_of,
    }
    drawn = []
    for each in fleet.shared[:4]:
        if each.whole is not None:
            alt = f"Coefficient of {within(each.name)} in each asset, its own and pooled"
            label = with_unit(f"coefficient of {formula(each.expression)}", each.unit)
            draw = partial(plot_pooled, each.assets, each.mean, each.sd, each.whole, label)
            drawn.append(time_picture(draw, alt, shared_text(each)))
    lead = (
        "Effects that were added to the models of assets; “3 to 5” are three that surely have it and two that may, as "
        "something else does the same there. A coefficient is pooled over those that surely have it: each one's own is "
        "drawn towards their mean as far as its data leave it open. Assets with too little of it to be found are not "
        "in the mean, which is therefore one of those that lack it, and not of the fleet."
    )
    table = table_of(fleet.shared, columns, "Effects and their coefficients")
    return Section("lacks", "What they lack", lead, [table, *map(Words, not_pooled(fleet)), Pictures(drawn)])


def _assets(fleet: Fleet, pages: dict[str, str]) -> Section:
    columns: dict[str, Callable[[AssetStudy], str]] = {
        "asset": lambda each: each.asset,
        "verdict": lambda each: each.verdict,
        "lacks": lacks_text,
        "#gap": lambda each: known_share(each.gap),
        "#left": lambda each: known_share(each.left),
        "~what its study says": lambda each: each.sentence,
    }
    lead = (
        "By the share of the measured rate, or of the samples, that the simulation leaves unexplained, largest first; "
        "of held-out data where there are any. An asset's name opens its own report."
    )
    links = [pages.get(each.asset, "") for each in fleet.assets]
    table = replace(table_of(fleet.assets, columns, "All assets"), links=links)
    return Section("assets", "Assets by their gap", lead, [table])
