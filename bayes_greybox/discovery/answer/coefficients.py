"""Posterior draws of the coefficients of an equation, with the effects that were added to it, from the noise grid."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from bayes_greybox.discovery.decision.decide import Verdict
from bayes_greybox.discovery.decision.probabilities import INSTRUMENT, NO_GAP, RECALIBRATE
from bayes_greybox.discovery.grid.log_evidence import modes
from bayes_greybox.discovery.grid.weigh import Hypothesis
from bayes_greybox.discovery.linearise.near import Near
from bayes_greybox.discovery.regressors.regressors import CORRECTION, FREE, SENSOR, Regressors
from bayes_greybox.discovery.sensor_errors.channels import ChannelSuspect


class Coefficients(NamedTuple):
    """Posterior draws for a set of columns: free, corrections, effects.

    Attributes:
        draws: Scaled coefficients, exactly zero for corrections that are out.
        inner: For each draw, the index of the column that stands for each added effect [n_draw, n_effect].
        sigma: Noise standard deviations, scaled.
        suspects: Columns of the sensor errors in the model, of scaled coefficients `suspect_draws`.
    """

    indices: tuple[int, ...]
    draws: Float[np.ndarray, "n_draw n_column"]
    inner: np.ndarray
    sigma: Float[np.ndarray, " n_draw"]
    suspects: tuple[int, ...] = ()
    suspect_draws: np.ndarray = np.zeros((0, 0))

    @property
    def n_own(self) -> int:
        """Return the number of columns that are no effects."""
        return len(self.indices) - self.inner.shape[1]


def draw_coefficients(near: Near, verdict: Verdict, n_draw: int, seed: int) -> Coefficients:
    """Return posterior draws given the effects and the sensor errors of an answer.

    Values of nonlinear parameters, patterns of corrections and noise points are drawn by their posterior.
    """
    rng, regressors, grid = np.random.default_rng(seed), near.regressors, near.weighed.grid
    names = [column.called for column in regressors.columns]
    plain = [*regressors.of_kind(FREE), *regressors.of_kind(CORRECTION)]
    sensors = [i for i in regressors.of_kind(SENSOR) if names[i] in verdict.sensors]
    place = {index: k for k, index in enumerate(plain)}
    draws = np.zeros((n_draw, len(plain) + len(verdict.labels)))
    inner = np.zeros((n_draw, len(verdict.labels)), int)
    sigma, errors = np.zeros(n_draw), np.zeros((n_draw, len(sensors)))
    chosen = answering(near, verdict)
    weights = np.exp(np.array([h.log_weight for h in chosen]) - max(h.log_weight for h in chosen))
    picks = rng.choice(len(chosen), size=n_draw, p=weights / weights.sum())
    for k in np.unique(picks):
        hypothesis, rows = chosen[k], np.flatnonzero(picks == k)
        points = rng.choice(len(grid.points), size=len(rows), p=hypothesis.points / hypothesis.points.sum())
        distinct = np.unique(points)
        sets = [hypothesis.members] * len(distinct)
        at_points = modes(grid, near.weighed.precision, sets, distinct, near.weighed.floor)
        for v, mean, covariance, point in zip(at_points.v, at_points.mean, at_points.covariance, distinct, strict=True):
            here = rows[points == point]
            theta = mean + rng.standard_normal((len(here), len(mean))) @ factor_of(covariance)
            # v given the data is inverse gamma with n/2 degrees, up to the few coefficients.
            sigma[here] = np.sqrt(v * grid.n_obs / rng.chisquare(grid.n_obs, len(here)))
            for j, i in enumerate(hypothesis.members):
                if i in place:
                    draws[here, place[i]] = theta[:, j]
                elif i in sensors:
                    errors[here, sensors.index(i)] = theta[:, j]
                else:
                    effect = verdict.labels.index(names[i])
                    draws[here, len(plain) + effect], inner[here, effect] = theta[:, j], i
    base = [next(i for i in verdict.hypothesis.members if names[i] == label) for label in verdict.labels]
    return Coefficients((*plain, *base), draws, inner, sigma, tuple(sensors), errors)


def answering(near: Near, verdict: Verdict) -> list[Hypothesis]:
    """Return the hypotheses with the effects and the sensor errors of an answer, likeliest first."""
    columns = near.regressors.columns

    def answers(hypothesis: Hypothesis) -> bool:
        members = [columns[i] for i in hypothesis.members]
        corrected = any(column.kind == CORRECTION for column in members)
        return (
            {c.called for c in members if c.effect is not None} == set(verdict.labels)
            and {c.called for c in members if c.suspect is not None} == set(verdict.sensors)
            and (corrected == (verdict.code == RECALIBRATE) or verdict.code not in (NO_GAP, INSTRUMENT, RECALIBRATE))
        )

    kept = [h for h in near.weighed.hypotheses if answers(h)] or [without_sensors(near, verdict)]
    # No draw in ten thousand is of the others.
    return [h for h in kept if h.log_weight > kept[0].log_weight + np.log(1e-4)]


def without_sensors(near: Near, verdict: Verdict) -> Hypothesis:
    """Return the hypothesis of an answer, its sensor errors those of the answer alone."""
    columns, own = near.regressors.columns, verdict.hypothesis
    kept = [k for k, i in enumerate(own.members) if columns[i].suspect is None or columns[i].called in verdict.sensors]
    return own.keeping(kept)


def sensor_errors(regressors: Regressors, coefficients: Coefficients) -> dict[ChannelSuspect, float]:
    """Return the mean sizes of the sensor errors in the model, in their units."""
    return {
        suspect: float(size) * regressors.target_scale / regressors.columns[i].scale
        for i, size in zip(coefficients.suspects, coefficients.suspect_draws.mean(axis=0), strict=True)
        if (suspect := regressors.columns[i].suspect) is not None
    }


def factor_of(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """Return W with WᵀW a covariance, which rounding may have made indefinite."""
    values, vectors = np.linalg.eigh(covariance)
    return (vectors * np.sqrt(np.maximum(values, 0.0))).T
