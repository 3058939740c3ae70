"""Coefficient tables with the inclusion of each term."""

import numpy as np
import pandas as pd

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.physics.units import coefficient_unit, target_unit
from bayes_greybox.running.errors import InputError

ROPE = 0.01
"""Default half-width of the region of practical equivalence: one percent of the RMS of the target."""


def inclusion(posterior: Posterior, level: float = 0.9, rope: float = ROPE) -> pd.DataFrame:
    """Return the coefficients of every equation and term.

    `inclusion` is P(γ_j = 1 | y), averaged over the hyperparameters from its exact conditional value (Rao–Blackwell).
    Only a spike-and-slab prior has it. Every prior has P(|θ_j| > ROPE) and the shrinkage factor
    κ_j = 1/(1 + ‖Wφ_j‖² sd_j²/σ²), 0 for a coefficient that the data determine and 1 for one that the prior keeps at
    zero (Piironen & Vehtari 2017, Eq. 2.6, where ‖φ_j‖² is n); W whitens the rows.

    Args:
        posterior: Fitted model.
        level: Probability of the equal-tailed interval.
        rope: Half-width of the region of practical equivalence, as a share: |θ_j| RMS(φ_j) over RMS of the target.

    Returns:
        Table indexed by (equation, term): mean, sd, lower, upper, `inclusion` (spike-and-slab only), outside_rope,
        shrinkage, unit; coefficients in user's units. Fixed coefficients come last, with sd 0. If single coefficients
        have priors or bounds of their own, a column `stated` has them in short, "N(-40, 10²), ≤ 0" or "= -1", and a
        column `given` is true where the probability says nothing, as the coefficient was given.

    Raises:
        InputError: `level` is not a probability, or `rope` is negative.
    """
    if not 0 < level < 1:
        raise InputError(f"level={level:g} must lie between 0 and 1.")
    if rope < 0:
        raise InputError(f"rope={rope:g} must not be negative.")
    group = posterior.drawn()
    tables = []
    for name, learned in posterior.learned().items():
        frame, own, draws = learned.frame, posterior.sites[learned.block], learned.of(posterior.draws(learned.block))
        theta = draws.theta * frame.coefficient_scale
        tail = (1 - level) / 2
        square = np.sum(np.asarray(learned.equation.design.Phi)[:, learned.columns] ** 2, axis=0)
        columns = {
            "mean": theta.mean(axis=0),
            "sd": theta.std(axis=0, ddof=1) if len(theta) > 1 else np.zeros(theta.shape[1]),
            "lower": np.quantile(theta, tail, axis=0),
            "upper": np.quantile(theta, 1 - tail, axis=0),
        }
        if own.inclusion in group:
            columns["inclusion"] = group[own.inclusion].mean(("chain", "draw")).to_numpy()[learned.columns]
        columns["outside_rope"] = np.mean(np.abs(draws.theta) > rope, axis=0)
        information = square * draws.prior_sd**2 / np.asarray(draws.hyper.sigma)[:, None] ** 2
        columns["shrinkage"] = np.mean(1 / (1 + information), axis=0)
        stated = posterior.model.stated(name, posterior.data)
        table = pd.DataFrame(columns, index=list(frame.dictionary.names))
        for term, value in stated.fixed:
            size = np.sqrt(np.mean(np.asarray(term.evaluate(learned.equation.rows.columns)) ** 2))
            moves = float(abs(value) * size > rope * frame.target_scale)
            row = {"sd": 0.0, "inclusion": 1.0, "outside_rope": moves, "shrinkage": 1.0}
            table.loc[term.name] = [row.get(column, value) for column in table]
        units, target = dict(posterior.data.units), target_unit(name, posterior.data)
        terms = (*frame.dictionary.terms, *(term for term, _ in stated.fixed))
        table["unit"] = [coefficient_unit(target, term, units) for term in terms]
        if posterior.model.stating:
            priors = [stated.priors.get(term.name) for term in terms]
            table["stated"] = [str(prior or "") for prior in priors]
            # Of a fixed coefficient nothing is learned; one with a mean of its own is in whatever the data say.
            spike = "inclusion" in table
            table["given"] = [bool(p and (not p.learned or (spike and p.certain))) for p in priors]
        table.index = pd.MultiIndex.from_product([[name], table.index], names=["equation", "term"])
        tables.append(table)
    return pd.concat(tables)
