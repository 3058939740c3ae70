"""How a fit does on data: error of what it predicts, and its free run, found once and kept with it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.remembering import remember, remembered
from bayes_greybox.running.errors import InputError

from .free_run import FreeRun, free_run
from .prediction import completed, predict

MOST_ROWS = 20_000
"""Rows over which a free run is made without being asked for: some seconds of work."""


@dataclass(frozen=True)
class Trial:
    """A fit on data.

    Attributes:
        held_out: Whether it did not learn from them.
        n_obs: Rows of the data.
        n_run: Their runs.
        nmse: Normalised mean square error of the predicted rate or output on held-out data, by equation.
        run: Free run over the data; None where there is none.
        why: Why there is none, in words; empty where outputs alone were learned, which move nothing.
    """

    held_out: bool
    n_obs: int
    n_run: int
    nmse: Mapping[str, float] = field(default_factory=dict)
    run: FreeRun | None = None
    why: str = ""


@remembered
def trial(posterior: Posterior) -> Trial:
    """A fit on the data that `try_on` was given; without such on those that it learned from.

    Args:
        posterior: Fitted model.
    """
    data = posterior.data
    return Trial(False, data.n_obs, data.n_run, {}, *_free_run(posterior, data))


def try_on(posterior: Posterior, data: Trajectories) -> Trial:
    """A fit on held-out data, which `trial` returns from then on.

    Args:
        posterior: Fitted model.
        data: Data that it did not learn from.

    Raises:
        InputError: Data that lack a state, an input or the rates of the model, or have one in another unit.
    """
    data = completed(posterior, data)
    nmse = {str(name): float(value) for name, value in predict(posterior, data).nmse().items()}
    found = Trial(True, data.n_obs, data.n_run, nmse, *_free_run(posterior, data))
    remember(posterior, trial, found)
    return found


def _free_run(posterior: Posterior, data: Trajectories) -> tuple[FreeRun | None, str]:
    """The free run, or why there is none; no word where what was learned moves nothing."""
    if all(posterior.data.is_output(name) for name in posterior.learned()):
        return None, ""
    if data.n_obs > MOST_ROWS:
        return None, f"Over {data.n_obs:,} rows it would take long: fit.simulate(data) makes it."
    try:
        return free_run(posterior, data), ""
    except InputError as error:
        return None, str(error)
