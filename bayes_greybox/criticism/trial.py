"""Trials of a fit on data: the error of its predictions and its free run, computed once and kept with it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.remembering import remember, remembered
from bayes_greybox.running.errors import InputError

from .free_run import FreeRun, free_run
from .prediction import completed, predict

FREE_RUN_ROWS = 20_000
"""Most rows over which a free run is made without request, which takes some seconds."""


@dataclass(frozen=True)
class Trial:
    """Predictions of a fit on data, held out or not, of a number of rows and runs.

    There are the normalised mean square error of the predicted rate or output on held-out data, by equation, and the
    free run over the data, or the reason why there is none, empty if only outputs were learned.
    """

    held_out: bool
    n_obs: int
    n_run: int
    nmse: Mapping[str, float] = field(default_factory=dict)
    run: FreeRun | None = None
    why: str = ""


@remembered
def trial(posterior: Posterior) -> Trial:
    """Return the trial on the data of `try_on`; before that, on the training data."""
    data = posterior.data
    return Trial(False, data.n_obs, data.n_run, {}, *_free_run(posterior, data))


def try_on(posterior: Posterior, data: Trajectories) -> Trial:
    """Try a fit on held-out data; `trial` returns the result from then on.

    It raises InputError if the data lack a state, an input or the rates of the model, or have one in another unit.
    """
    data = completed(posterior, data)
    nmse = {str(name): float(value) for name, value in predict(posterior, data).nmse().items()}
    result = Trial(True, data.n_obs, data.n_run, nmse, *_free_run(posterior, data))
    remember(posterior, trial, result)
    return result


def _free_run(posterior: Posterior, data: Trajectories) -> tuple[FreeRun | None, str]:
    """Return the free run, or the reason why there is none; neither if only outputs were learned."""
    if all(posterior.data.is_output(name) for name in posterior.learned()):
        return None, ""
    if data.n_obs > FREE_RUN_ROWS:
        return None, f"Over {data.n_obs:,} rows it would take long: fit.simulate(data) makes it."
    try:
        return free_run(posterior, data), ""
    except InputError as error:
        return None, str(error)
