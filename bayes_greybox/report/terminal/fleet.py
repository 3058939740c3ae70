"""A fleet for a terminal."""

from rich.console import Group
from rich.text import Text

from bayes_greybox.discovery.fleet.shared import Fleet
from bayes_greybox.report.tables import table_of
from bayes_greybox.report.words.fleet import fleet_sentence, lacks_text, not_pooled
from bayes_greybox.report.words.formatting import known_share

from .tables import drawn


def fleet_tables(fleet: Fleet) -> tuple[Text | Group, ...]:
    """Return the sentence, the assets by their gap, and the effects that are not pooled."""
    columns = {
        "asset": lambda each: each.asset,
        "verdict": lambda each: each.verdict,
        "lacks": lambda each: each.sentence if each.failed else lacks_text(each),
        "#gap": lambda each: known_share(each.gap),
        "#left": lambda each: known_share(each.left),
    }
    table = drawn(table_of(fleet.assets, columns, "Assets by their gap"))
    return Text(fleet_sentence(fleet), style="bold"), table, *map(Text, not_pooled(fleet))
