"""What the sampler says of the effects that a study added, beside the closed form that its tables have."""

import numpy as np
from jaxtyping import Float

from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.physics.catalogue.names import within

from .formatting import estimate
from .study import added

APART = 3.0
"""Of so many standard deviations, of the wider one, the closed form and the sampler do not speak of one posterior."""


def added_draws(study: StudyResult, place: int) -> Float[np.ndarray, " n_draw"] | None:
    """Posterior draws of an added effect's coefficient: its terms are the last of the amended dictionary, in order."""
    if study.fit is None:
        return None
    chosen = study.effects.iloc[added(study)]
    equation = chosen["equation"].iloc[place]
    after = int(np.sum(chosen["equation"].iloc[place:] == equation))
    theta = study.fit.idata["posterior"][study.fit.sites[equation].theta].to_numpy()
    return theta[..., theta.shape[-1] - after].ravel()


def sampled_elsewhere(study: StudyResult) -> list[str]:
    """Coefficients of added effects that the sampler puts elsewhere than the closed form, in words."""
    found = []
    for place, row in enumerate(study.effects.iloc[added(study)].to_dict("records")):
        draws = added_draws(study, place)
        if draws is None or not np.isfinite(row["mean"]):
            continue
        mean, sd = float(np.mean(draws)), float(np.std(draws))
        if abs(mean - row["mean"]) > APART * max(sd, float(row["sd"])):
            told = estimate(row["mean"], row["sd"], row["unit"])
            found.append(f"its coefficient of {within(row['name'])} is {estimate(mean, sd, row['unit'])}, not {told}")
    return found
