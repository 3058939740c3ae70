"""Check of linear rows: exact paths at posterior draws, as importance weights."""

import math
from collections.abc import Collection

import numpy as np

from bayes_greybox.criticism.linearity import draws_followed, linearity_of_paths
from bayes_greybox.discovery.answer.amendment import Amendment
from bayes_greybox.discovery.regressors.regressors import Regressors
from bayes_greybox.model.rows.equation_rows import Columns

from .adequacy import Check


def check_linearity(amendment: Amendment, regressors: Regressors, inputs: Collection[str]) -> list[Check]:
    """Return the check of rows that are linear near the answer only; nothing if rows are linear, or it is not known.

    It is not known beside a latent force, beside errors of inputs, which act along the path, and for effects with
    memory that the path was found without.
    """
    after, rows = amendment.after, regressors.rows
    sensors = [regressors.columns[i].suspect for i in after.suspects]
    if rows.exact is None or amendment.forced or any(each and each.channel in inputs for each in sensors):
        return []
    n_draw = draws_followed(rows)
    terms, coefficients, _ = amendment.added(0, n_draw)
    if any(state.name not in rows.columns for term in terms for state in term.states):
        # Its memory was followed along the path, and is no state of it.
        return []
    pick = amendment.pick(n_draw)
    errors = after.suspect_draws[pick] @ regressors.at_rows(after.suspects).T if after.suspects else 0.0

    def added(columns: Columns, draw: int) -> np.ndarray:
        inside = np.flatnonzero(coefficients[draw])
        rate = sum((coefficients[draw, k] * np.asarray(terms[k].evaluate(columns)) for k in inside), np.zeros(()))
        return np.broadcast_to(rate, np.shape(next(iter(columns.values()))))[:, None]

    scale = regressors.target_scale
    linearity = linearity_of_paths(rows, added, scale * after.sigma[pick], scale * errors)
    text = (
        ""
        if linearity.ok
        else f"{linearity.elsewhere:.0%} of the exact posterior lies elsewhere than that of linear rows"
    )
    return [Check("linearity", math.nan, text, linearity.khat)]
