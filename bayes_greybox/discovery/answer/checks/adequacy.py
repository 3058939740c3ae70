"""Checks of the residuals of an answer's hypothesis, in closed form, before its verdict.

With X the whitened columns of the hypothesis and h the diagonal of X (XᵀX + σ² D⁻¹)⁻¹ Xᵀ, the leave-one-out residual
of row i over its predictive standard deviation is z_i = e_i / (σ √(1 − h_i)), e the whitened residual. If the
hypothesis and its noise are right, z_i is standard normal and independent from row to row, up to the few coefficients
that were fitted.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import ndtr
from scipy.stats import chi2

from bayes_greybox.criticism.checks.loo_pit import anderson_darling
from bayes_greybox.discovery.decision.criteria import CRITERIA, Criteria
from bayes_greybox.discovery.grid.hypotheses.weigh import Hypothesis
from bayes_greybox.discovery.linearise.near import Near
from bayes_greybox.model.noise.noise_model import HEAVY

LARGEST_LAG = 20
"""Largest lag at which whiteness is tested, and a fifth of the rows at most."""

PIT_ROWS, NORMAL_SAMPLES = 500, 4000
"""Rows whose leave-one-out values are tested, evenly thinned, and samples of the statistic under the model."""

WHITENESS, LOO_PIT = "whiteness", "LOO-PIT"


@dataclass(frozen=True)
class Check:
    """One check.

    Attributes:
        name: `WHITENESS`, `LOO_PIT` or "linearity".
        p: p-value; NaN of linearity.
        text: Reason against the answer, in words; "" if there is none.
        khat: k̂ of the weights of exact paths, of linearity.
    """

    name: str
    p: float
    text: str
    khat: float = math.nan

    @property
    def ok(self) -> bool:
        """Return whether the check does not speak against the answer."""
        return not self.text


def check_hypothesis(
    near: Near, hypothesis: Hypothesis, unit: str = "", criteria: Criteria = CRITERIA
) -> list[Check]:  # fmt: skip
    """Return whiteness and LOO-PIT of a hypothesis at its likeliest noise point."""
    z = near.weighed.standardised(hypothesis)
    if len(z) < criteria.checked_rows:
        return []
    rows = near.regressors.rows
    lengths = tuple(np.unique(rows.run, return_counts=True)[1].tolist()) if len(z) == rows.n_row else (len(z),)
    steps = np.diff(rows.time)[np.diff(rows.run) == 0]
    white, lasting = _whiteness(z, lengths)
    over = f"{lasting * float(np.median(steps)) if len(steps) else 0.0:.2g} {unit}".rstrip()
    checks = [Check(WHITENESS, white, "" if white >= criteria.level else f"residuals hang together over {over}")]
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
    total, r, pairs = float(z @ z), [], []
    for lag in lags:
        within = run[lag:] == run[:-lag]
        r.append(float(np.sum((z[lag:] * z[:-lag])[within])) / total)
        pairs.append(max(int(within.sum()), 1))
    r, pairs = np.array(r), np.array(pairs)
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
    """Return the statistic of normal samples of this size, centred and scaled by their own moments."""
    draws = np.random.default_rng(n).standard_normal((NORMAL_SAMPLES, n))
    return anderson_darling((draws - draws.mean(axis=1, keepdims=True)) / draws.std(axis=1, keepdims=True))
