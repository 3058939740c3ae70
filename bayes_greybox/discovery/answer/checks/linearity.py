"""Whether rows that are linear near an answer serve it: exact paths of its posterior draws, as importance weights."""

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from bayes_greybox.criticism.linearity import Linearity, draws_followed, linearity_of_paths
from bayes_greybox.discovery.answer.amendment import Amendment
from bayes_greybox.discovery.regressors.regressors import Regressors
from bayes_greybox.model.rows.equation_rows import Columns

from .adequacy import Check

LINEARITY = "linearity"


@dataclass(frozen=True)
class LinearityCheck(Check):
    """Check of linear rows; it has no p-value.

    Attributes:
        found: How far the exact posterior is.
    """

    found: Linearity

    @property
    def khat(self) -> float:
        """k̂ of the weights of exact paths."""
        return self.found.khat

    @property
    def ok(self) -> bool:
        """Whether the exact posterior is near the linear one."""
        return self.found.ok


def check_linearity(amendment: Amendment, regressors: Regressors, inputs: Collection[str]) -> list[LinearityCheck]:
    """Exact paths at draws of the model after; nothing where rows are linear, or where it is not known.

    It is not known beside an unknown force, beside errors of inputs, which act along the path, and where the path was
    found without what the model after remembers.

    Args:
        amendment: What was added, with draws of its coefficients and of the sensors' errors; nothing remains beside it.
        regressors: What it was weighed on.
        inputs: Their names.
    """
    after = amendment.after
    rows, suspects = regressors.rows, [regressors.columns[i].suspect for i in after.suspects]
    driven = any(each is not None and each.channel in inputs for each in suspects)
    if rows.exact is None or amendment.forced or driven:
        return []
    n_draw = draws_followed(rows)
    terms, coefficients, _ = amendment.added(0, n_draw)
    if any(state.name not in rows.columns for term in terms for state in term.states):
        # What it remembers was followed along the path, and is no state of it.
        return []
    pick = amendment.pick(n_draw)
    errors = after.suspect_draws[pick] @ regressors.at_rows(after.suspects).T if after.suspects else 0.0

    def added(columns: Columns, draw: int) -> np.ndarray:
        inside = np.flatnonzero(coefficients[draw])
        rate = sum((coefficients[draw, k] * np.asarray(terms[k].evaluate(columns)) for k in inside), np.zeros(()))
        return np.broadcast_to(rate, np.shape(next(iter(columns.values()))))[:, None]

    scale = regressors.target_scale
    found = linearity_of_paths(rows, added, scale * after.sigma[pick], scale * errors)
    text = "" if found.ok else f"{found.elsewhere:.0%} of the exact posterior lies elsewhere than that of linear rows"
    return [LinearityCheck(LINEARITY, math.nan, text, found)]
