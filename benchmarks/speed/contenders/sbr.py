"""PySINDy's sparse Bayesian regression: θ under a regularised horseshoe, no f, by NumPyro's NUTS."""

import importlib
from typing import Any

import numpy as np

from bayes_greybox.running.errors import InputError
from benchmarks.speed.drawn import Clock, Drawn, Settings
from benchmarks.speed.problems import Data


def sample(data: Data, settings: Settings, clock: Clock) -> Drawn:
    """`SBR` with its own priors.

    Args:
        data: Data.
        settings: Settings; the cap is not looked at.
        clock: Seconds since the process started.

    Raises:
        InputError: PySINDy or NumPyro is not installed.
    """
    try:
        pysindy: Any = importlib.import_module("pysindy")
    except ImportError as error:
        raise InputError("This needs pysindy: pip install 'bayes-greybox[peers]'.") from error
    scaled = data.scaled()
    chains = {"num_chains": settings.chains, "chain_method": "sequential", "progress_bar": False}
    # Given whole: SBR takes the seed out of the dictionary that it is handed.
    regression = pysindy.SBR(
        num_warmup=settings.tune, num_samples=settings.draws, mcmc_kwargs={**chains, "seed": settings.seed},
        nuts_kwargs={"target_accept_prob": settings.target_accept},
    )  # fmt: skip
    regression.fit(scaled.Phi, scaled.y[:, None])
    drawn = regression.mcmc_.get_samples(group_by_chain=True)
    seconds = clock()
    eta = np.stack([np.asarray(drawn["sigma"]), np.asarray(drawn["tau"])], axis=2)
    diverging = regression.mcmc_.get_extra_fields()["diverging"]
    return Drawn(
        np.asarray(drawn["beta"])[:, :, 0], eta, ((seconds, settings.draws),), float("nan"), int(np.sum(diverging))
    )
