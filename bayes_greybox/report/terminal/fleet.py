"""A fleet in a terminal."""

import math

from rich.table import Table
from rich.text import Text

from bayes_greybox.discovery.fleet.shared import Fleet
from bayes_greybox.report.words.fleet import fleet_sentence, lacks_text, not_pooled
from bayes_greybox.report.words.formatting import share_text

from .tables import plain_table


def fleet_tables(fleet: Fleet) -> tuple[Text | Table, ...]:
    """The sentence, the assets by their gap, and what is not pooled."""
    table = plain_table("Assets by their gap")
    for name in ("asset", "verdict", "lacks"):
        table.add_column(name)
    for name in ("gap", "left"):
        table.add_column(name, justify="right")
    for each in fleet.assets:
        shares = ["–" if math.isnan(value) else share_text(value) for value in (each.gap, each.left)]
        what = each.sentence if each.failed else lacks_text(each)
        table.add_row(*(Text(cell) for cell in (each.asset, each.verdict, what, *shares)))
    return Text(fleet_sentence(fleet), style="bold"), table, *map(Text, not_pooled(fleet))
