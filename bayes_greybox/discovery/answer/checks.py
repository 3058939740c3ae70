"""Checks of an answer: residuals, rows linear near it only, ends of ranges, filtered rates, sizes of coefficients."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.special import ndtr
from scipy.stats import chi2

from bayes_greybox.criticism.checks.loo_pit import anderson_darling
from bayes_greybox.criticism.linearity import draws_followed, linearity_of_paths
from bayes_greybox.discovery.decision.criteria import CRITERIA, Criteria
from bayes_greybox.discovery.grid.weigh import Hypothesis
from bayes_greybox.discovery.linearise.near import Near
from bayes_greybox.discovery.regressors.columns import limits
from bayes_greybox.discovery.regressors.regressors import Regressors
from bayes_greybox.model.noise.noise_model import HEAVY
from bayes_greybox.model.rows.equation_rows import Columns
from bayes_greybox.physics.catalogue.names import within

from .amendment import Amendment
from .coefficients import Coefficients

LARGEST_LAG = 20
"""Largest lag at which whiteness is tested, and a fifth of the rows at most."""

PIT_ROWS, NORMAL_SAMPLES = 500, 4000
"""Rows whose leave-one-out values are tested, evenly thinned, and samples of the statistic under the model."""

WHITENESS, LOO_PIT = "whiteness", "LOO-PIT"


@dataclass(frozen=True)
class Check:
    """One check: p-value (NaN of linearity), k̂ of exact paths (of linearity alone), and text against the answer."""

    name: str
    p: float
    text: str
    khat: float = math.nan

    @property
    def ok(self) -> bool:
        """Return whether the check does not speak against the answer."""
        return not self.text


def check_hypothesis(near: Near, hypothesis: Hypothesis, unit: str = "", criteria: Criteria = CRITERIA) -> list[Check]:
    """Return whiteness and LOO-PIT of a hypothesis at its likeliest noise point, in closed form.

    If the hypothesis and its noise are right, leave-one-out residuals over their predictive standard deviations are
    standard normal and independent from row to row, up to the few coefficients that were fitted.
    """
    z = near.weighed.standardised(hypothesis)
    if len(z) < criteria.checked_rows:
        return []
    rows = near.regressors.rows
    lengths = tuple(np.unique(rows.run, return_counts=True)[1].tolist()) if len(z) == rows.n_row else (len(z),)
    steps = np.diff(rows.time)[np.diff(rows.run) == 0]
    white, lasting = _whiteness(z, lengths)
    over = f"{lasting * float(np.median(steps)) if len(steps) else 0.0:.2g} {unit}".rstrip()
    checks = [Check(WHITENESS, white, "" if white >= criteria.level else f"residuals are correlated over {over}")]
    shape = near.weighed.grid.points[hypothesis.point].shape
    # Weights that made the tails light were found on these very residuals.
    if not shape or HEAVY not in near.rows.point.shapes[shape - 1].about:
        checks.append(_loo_pit(z, criteria.level))
    return checks


def _whiteness(z: np.ndarray, lengths: tuple[int, ...]) -> tuple[float, float]:
    """Return the p-value of Ljung & Box (1978), pairs within runs only, and the correlation time in rows."""
    n = len(z)
    lags = np.arange(1, max(1, min(LARGEST_LAG, n // 5)) + 1)
    run = np.repeat(np.arange(len(lengths)), lengths)
    z = z - z.mean()
    same = [run[lag:] == run[:-lag] for lag in lags]
    r = np.array([np.sum((z[k:] * z[:-k])[inside]) for k, inside in zip(lags, same, strict=True)]) / float(z @ z)
    pairs = np.array([max(int(inside.sum()), 1) for inside in same])
    q = float(np.sum(r**2 * n * (n + 2) / pairs))
    # Correlation time: the integral of |ρ| up to where it is lost in chance.
    chance = 2 / np.sqrt(pairs)
    lost = np.flatnonzero(np.abs(r) < chance)
    until = int(lost[0]) if len(lost) else len(lags)
    return float(chi2.sf(q, len(lags))), 0.5 + float(np.sum(np.abs(r[:until])))


def _loo_pit(z: np.ndarray, level: float = CRITERIA.level) -> Check:
    picked = z[np.unique(np.linspace(0, len(z) - 1, min(len(z), PIT_ROWS)).round().astype(int))]
    picked = (picked - picked.mean()) / picked.std()
    statistic = float(anderson_darling(picked[None])[0])
    p = float((1 + np.sum(_null_statistics(len(picked)) >= statistic)) / (1 + NORMAL_SAMPLES))
    if p >= level:
        return Check(LOO_PIT, p, "")
    outside, expected = float(np.mean(np.abs(picked) > 2.5758)), 2 * float(ndtr(-2.5758))
    shape = "heavier tails than" if outside > 1.5 * expected else "another shape than"
    return Check(LOO_PIT, p, f"the noise has {shape} the model's")


@cache
def _null_statistics(n: int) -> np.ndarray:
    draws = np.random.default_rng(n).standard_normal((NORMAL_SAMPLES, n))
    return anderson_darling((draws - draws.mean(axis=1, keepdims=True)) / draws.std(axis=1, keepdims=True))


def check_linearity(amendment: Amendment, regressors: Regressors, inputs: Collection[str]) -> list[Check]:
    """Return the check of rows that are linear near the answer only; nothing where it cannot be made.

    It cannot beside a latent force, beside errors of inputs, and for effects with memory that the path was found
    without.
    """
    after, rows = amendment.after, regressors.rows
    sensors = [regressors.columns[i].suspect for i in after.suspects]
    if rows.exact is None or amendment.forced or any(each and each.channel in inputs for each in sensors):
        return []
    n_draw = draws_followed(rows)
    # The path of the rows has the tangent that the remainder is a part of.
    terms, coefficients, _ = replace(amendment, remainder=()).added(0, n_draw)
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
    against = f"{linearity.elsewhere:.0%} of the exact posterior lies elsewhere than that of linear rows"
    return [Check("linearity", math.nan, "" if linearity.ok else against, linearity.khat)]


OTHER_SIZE, CLOSED_SHARE, ROWS_EACH = 10.0, 0.9, 10
"""Factor from which on a coefficient is of another size, share of the gap's square that coefficients alone close then,
and least rows for each of them: any coefficients follow a few rows."""


def other_sizes(regressors: Regressors) -> list[str]:
    """Return a sentence if the simulation alone would be right with coefficients of another size, by least squares.

    Their prior believes the simulation: a table in mm beside equations in m would be explained by effects like it.
    """
    free, corrections = regressors.of_kind("free"), regressors.of_kind("correction")
    if not corrections or regressors.rows.n_white < ROWS_EACH * len([*free, *corrections]):
        return []
    theta, left = regressors.least_squares([*free, *corrections])
    _, gap = regressors.least_squares(free)
    share, sizes = 1 - left / gap if gap > 0 else 0.0, []
    for value, i in zip(theta[len(free) :], corrections, strict=True):
        column = regressors.columns[i]
        ratio = 1 + float(value) * regressors.target_scale / (column.scale * column.nominal) if column.nominal else 1.0
        if not 1 / OTHER_SIZE < ratio < OTHER_SIZE:
            sizes.append(f"{column.called} {ratio:.4g} times")
    if not sizes or share < CLOSED_SHARE:
        return []
    return [
        f"The simulation alone would close {share:.1%} of the gap of {regressors.equation} with other coefficients, of "
        f"{' and '.join(sizes)} what is given: are its units those of the data?"
    ]


def at_ends(regressors: Regressors, coefficients: Coefficients, criteria: Criteria) -> list[str]:
    """Return a sentence for each nonlinear parameter of the answer whose interval an end of its range cuts off."""
    sentences = []
    for drawn in coefficients.inner.T:
        columns = [regressors.columns[i] for i in drawn]
        effect = columns[0].effect
        if effect is None or not columns[0].inner:
            continue
        ranges = limits(effect, regressors.rows.columns, regressors.path)
        for parameter, low, high in zip(effect.effect.inner, *ranges, strict=True):
            values = np.array([column.inner[parameter.name] for column in columns])
            place = np.log(values / low) / np.log(high / low)
            for end, away in (("smallest", place), ("largest", 1 - place)):
                if np.mean(away < criteria.end) > criteria.at_end:
                    sentences.append(
                        f"{parameter.meaning} of {within(effect.effect.name)} is at the {end} value that was tried: "
                        "it may lie beyond, and its interval is cut off there"
                    )
    return sentences


def rounded_off(regressors: Regressors, effects: Sequence[int], criteria: Criteria) -> list[str]:
    """Return a sentence if effects jump or bend within the time that a filtered sample stands for.

    The smoothed state is off where the true one has a kink, and a mass that sticks has a friction that is no function
    of its velocity: samples, followed along a path, tell.
    """
    rows, spread, names = regressors.rows, regressors.rows.spread, []
    if spread is None:
        return []
    for i in effects:
        column = regressors.columns[i]
        if column.effect is None or column.formula.states:
            continue
        values = regressors.evaluate([i], rows.columns)
        bends = spread.bends(lambda at, i=i: regressors.evaluate([i], at), rows.columns)
        if np.mean(bends > criteria.bend * np.sqrt(np.mean(values**2))) > criteria.bent_rows:
            names.append(within(column.effect.name))
    if not names:
        return []
    where = "is where it jumps or bends" if len(names) == 1 else "are where they jump or bend"
    text = f"rates that a filter computed do not show how {' and '.join(names)} {where}"
    return [f"{text}: study the samples, without differentiate"]
