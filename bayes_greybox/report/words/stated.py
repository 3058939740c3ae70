"""What was stated of coefficients, in tables."""

from collections.abc import Mapping
from typing import Any

from bayes_greybox.physics.coefficient import Coefficient

from .formatting import probability_text


def term_probability(row: Mapping[Any, Any], column: str, prior: Coefficient | None) -> str:
    """The probability of a term in a coefficient table; "given" where it was stated and nothing was learned of it.

    Args:
        row: Of the table.
        column: `probability_column` of the table.
        prior: What was stated of the coefficient, if anything was.
    """
    given = prior is not None and (not prior.learned or (column == "inclusion" and prior.certain))
    return "given" if given else probability_text(row[column])


def stated_text(prior: Coefficient | None) -> str:
    """What was stated of a coefficient: "N(−40, 10²), ≤ 0", "= −2"."""
    return "" if prior is None else str(prior).replace("-", "−")
