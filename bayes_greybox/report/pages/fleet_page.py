"""The page of a fleet: what assets lack together, each effect pooled over them, and all assets by their gap."""

import math
import os

from bayes_greybox.discovery.fleet import Fleet, Shared
from bayes_greybox.inference.kept.netcdf import versions
from bayes_greybox.report.plots.fleet import plot_pooled
from bayes_greybox.report.words.fleet import fleet_sentence, shared_text
from bayes_greybox.report.words.formatting import estimate, interval, number, probability_text, share_text, unit_text

from .page import Badge, Card, Page, Pictures, Section, Table, Words, picture, write_page
from .tables import footer


def fleet_html(fleet: Fleet, path: str | os.PathLike[str], pages: dict[str, str] | None = None) -> None:
    """Write the report of a fleet as one HTML file that needs no network.

    Args:
        fleet: The fleet.
        path: Destination.
        pages: Where each asset's own report lies, from the folder of this one.

    Raises:
        InputError: The destination cannot be written.
    """
    write_page(fleet_page(fleet, pages or {}), path)


def fleet_page(fleet: Fleet, pages: dict[str, str]) -> Page:
    """The report of a fleet.

    Args:
        fleet: The fleet.
        pages: Where each asset's own report lies.
    """
    alerts = [f"{each.asset} could not be studied: {each.sentence}" for each in fleet.failed]
    alerts += [f"The sampler did not converge for {e.asset}." for e in fleet.studied if e.converged is False]
    cause = fleet.cause
    if not fleet.with_gap:
        badge = Badge("No gap", "good", "✓") if fleet.studied else Badge("Nothing studied", "bad", "!")
    else:
        badge = Badge("One cause", "good", "✓") if cause else Badge("Several causes", "warn", "≈")
    return Page(
        title=f"Fleet: {badge.text.lower()}",
        kind="bayes_greybox · fleet of studies",
        headline=fleet_sentence(fleet),
        badges=[badge],
        facts=[f"{len(fleet.assets)} assets", f"{fleet.with_gap} with a gap", f"{len(fleet.failed)} failed"],
        alerts=alerts,
        cards=_cards(cause),
        cards_title="" if cause is None else shared_text(cause),
        sections=[_shared(fleet), _assets(fleet, pages)],
        footer=footer(versions()["bayes-greybox"]),
    )


def _cards(cause: Shared | None) -> list[Card]:
    if cause is None or cause.whole is None:
        return []
    whole, unit = cause.whole, f" {unit_text(cause.unit)}".rstrip()
    return [
        Card(
            "On the whole",
            "mean of the fleet, 90 % interval",
            f"{number(whole.mean)}{unit}",
            note=interval(whole.lower, whole.upper),
        ),
        Card(
            "Between assets",
            "standard deviation of their own coefficients, 90 % interval",
            f"{number(whole.between)}{unit}",
            note=f"{number(whole.between_lower)} to {number(whole.between_upper)}",
        ),
        Card("One coefficient for all", "probability, 0.5 beforehand", probability_text(whole.same)),
    ]


def _shared(fleet: Fleet) -> Section:
    if not fleet.shared:
        return Section("lacks", "What they lack", blocks=[Words("No effect was added to the model of any asset.")])
    head = ("effect", "equation", "#assets", "#on the whole", "#between assets", "#P(one for all)", "unit")
    rows = []
    for each in fleet.shared:
        whole = each.whole
        numbers = ("–", "–", "–")
        if whole is not None:
            numbers = estimate(whole.mean, whole.sd), number(whole.between), probability_text(whole.same)
        rows.append((each.name, each.equation, str(len(each.assets)), *numbers, unit_text(each.unit) or "–"))
    drawn = [
        picture(
            plot_pooled(
                each.assets, each.mean, each.sd, each.whole, f"{each.name} ({unit_text(each.unit) or 'user units'})"
            ),
            f"Coefficient of {each.name.lower()} in each asset, its own and pooled",
            shared_text(each),
        )
        for each in fleet.shared[:4]
        if each.whole is not None
    ]
    lead = (
        "Effects that were added to the models of assets. A coefficient is pooled over those that have it: each one's "
        "own is drawn towards that of the whole as far as its data leave it open. Assets whose data do not tell the "
        "effect are not in the pool."
    )
    return Section(
        "lacks", "What they lack", lead, [Table(head, rows, "Effects and their coefficients"), Pictures(drawn)]
    )


def _assets(fleet: Fleet, pages: dict[str, str]) -> Section:
    head = ("asset", "verdict", "lacks", "#gap", "#left", "what its study says")
    rows = [
        (each.asset, each.verdict, ", ".join(each.lacks) or "–", _share(each.gap), _share(each.left), each.sentence)
        for each in fleet.assets
    ]
    lead = (
        "By the share of the measured rate, or of the samples, that the simulation leaves unexplained, largest first; "
        "of held-out data where there are any. An asset's name opens its own report."
    )
    links = [pages.get(each.asset, "") for each in fleet.assets]
    return Section("assets", "Assets by their gap", lead, [Table(head, rows, "All assets", links=links)])


def _share(value: float) -> str:
    return "–" if math.isnan(value) else share_text(value)
