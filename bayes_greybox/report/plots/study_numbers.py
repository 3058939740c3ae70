"""What the figures of a study show that its result holds in another form."""

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.criticism import discrepancy
from bayes_greybox.discovery.answer.where import GapMap
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.report.words.study import added

REACH = 1.6449
"""Standard deviations on either side of the mean that hold 90 % of a normal distribution."""


def support(gap: GapMap) -> Bool[np.ndarray, "*grid"]:
    """Where the grid of a gap map lies within the data, as for the figures of a fit."""
    return discrepancy.support(np.reshape(gap.samples, (-1, len(gap.variables))), gap.axes)


def added_draws(study: StudyResult, place: int) -> Float[np.ndarray, " n_draw"] | None:
    """Posterior draws of an added effect's coefficient: its terms are the last of the amended dictionary, in order."""
    if study.fit is None:
        return None
    chosen = study.effects.iloc[added(study)]
    equation = chosen["equation"].iloc[place]
    after = int(np.sum(chosen["equation"].iloc[place:] == equation))
    theta = study.fit.idata["posterior"][study.fit.sites[equation].theta].to_numpy()
    return theta[..., theta.shape[-1] - after].ravel()


def normal_band(mean: np.ndarray, sd: np.ndarray) -> Float[np.ndarray, "3 n_obs"]:
    """Mean, lower and upper end of a 90 % band."""
    return np.stack([mean, mean - REACH * sd, mean + REACH * sd])
