"""Checks of the explanation that a study settles on, in closed form, before its verdict.

With X the whitened columns of the explanation and h the diagonal of X (XᵀX + σ² D⁻¹)⁻¹ Xᵀ, the leave-one-out residual
of row i over its predictive standard deviation is z_i = e_i / (σ √(1 − h_i)), e the whitened residual: standard normal
and independent from row to row, up to what few coefficients take away, if the explanation and its noise are right.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import ndtr
from scipy.stats import chi2

from bayes_greybox.criticism.checks.loo_pit import anderson_darling
from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.discovery.grid.hypotheses.weigh import Hypothesis
from bayes_greybox.discovery.linearise.near import Near
from bayes_greybox.model.noise.noise_model import HEAVY

LEVEL = Criteria().level
"""p-value below which a check speaks against the verdict."""

LAGS = 20
"""Most lags that whiteness is tested at, and a fifth of the rows at most."""

FEWEST = 2 * LAGS
"""Rows that count, as white numbers, below which nothing is tested."""

PIT_ROWS, REPLICATES = 500, 4000
"""Rows whose leave-one-out values are tested, evenly thinned, and draws of the statistic under the model."""

WHITENESS, LOO_PIT = "whiteness", "LOO-PIT"


@dataclass(frozen=True)
class Check:
    """One check.

    Attributes:
        name: `WHITENESS` or `LOO_PIT`.
        p: Its p-value.
        text: What is wrong, in words; "" where nothing is.
    """

    name: str
    p: float
    text: str

    @property
    def khat(self) -> float:
        """It is a p-value that says it."""
        return math.nan

    @property
    def ok(self) -> bool:
        """Whether it does not speak against the verdict."""
        return self.p >= LEVEL


def check_hypothesis(near: Near, hypothesis: Hypothesis, unit: str = "") -> list[Check]:
    """Return whiteness and LOO-PIT of a hypothesis at its likeliest noise point.

    Args:
        near: Hypotheses.
        hypothesis: The one that the study settled on.
        unit: Of time, for the words.
    """
    z = near.weighed.standardised(hypothesis)
    if len(z) < FEWEST:
        return []
    rows = near.regressors.rows
    lengths = tuple(np.unique(rows.run, return_counts=True)[1].tolist()) if len(z) == rows.n_row else (len(z),)
    steps = np.diff(rows.time)[np.diff(rows.run) == 0]
    white, lasting = _whiteness(z, lengths)
    over = f"{lasting * float(np.median(steps)) if len(steps) else 0.0:.2g} {unit}".rstrip()
    said = "" if white >= LEVEL else f"residuals hang together over {over}"
    shape = near.weighed.grid.points[hypothesis.point].shape
    if shape and HEAVY in near.rows.point.shapes[shape - 1].about:
        # Weights that made the tails light were found on these very residuals.
        return [Check(WHITENESS, white, said)]
    return [Check(WHITENESS, white, said), _loo_pit(z)]


def _whiteness(z: np.ndarray, lengths: tuple[int, ...]) -> tuple[float, float]:
    """p-value of Ljung & Box (1978), pairs within runs only; and over how many rows the values hang together."""
    n = len(z)
    lags = np.arange(1, max(1, min(LAGS, n // 5)) + 1)
    run = np.repeat(np.arange(len(lengths)), lengths)
    z = z - z.mean()
    total, r, pairs = float(z @ z), [], []
    for lag in lags:
        within = run[lag:] == run[:-lag]
        r.append(float(np.sum((z[lag:] * z[:-lag])[within])) / total)
        pairs.append(max(int(within.sum()), 1))
    r, pairs = np.array(r), np.array(pairs)
    q = float(np.sum(r**2 * n * (n + 2) / pairs))
    # How long: the integral of |ρ| up to where it is lost in chance
    chance = 2 / np.sqrt(pairs)
    lost = np.flatnonzero(np.abs(r) < chance)
    until = int(lost[0]) if len(lost) else len(lags)
    return float(chi2.sf(q, len(lags))), 0.5 + float(np.sum(np.abs(r[:until])))


def _loo_pit(z: np.ndarray) -> Check:
    picked = z[np.unique(np.linspace(0, len(z) - 1, min(len(z), PIT_ROWS)).round().astype(int))]
    picked = (picked - picked.mean()) / picked.std()
    statistic = float(anderson_darling(picked[None])[0])
    p = float((1 + np.sum(_replicates(len(picked)) >= statistic)) / (1 + REPLICATES))
    if p >= LEVEL:
        return Check(LOO_PIT, p, "")
    outside = float(np.mean(np.abs(picked) > 2.5758))
    expected = 2 * float(ndtr(-2.5758))
    shape = "heavier tails than" if outside > 1.5 * expected else "another shape than"
    return Check(LOO_PIT, p, f"the noise has {shape} the model's")


@cache
def _replicates(n: int) -> np.ndarray:
    """The statistic of normal samples of this size, centred and scaled by their own moments."""
    rng = np.random.default_rng(n)
    found = []
    for start in range(0, REPLICATES, 500):
        draws = rng.standard_normal((min(500, REPLICATES - start), n))
        draws = (draws - draws.mean(axis=1, keepdims=True)) / draws.std(axis=1, keepdims=True)
        found.append(anderson_darling(draws))
    return np.concatenate(found)
