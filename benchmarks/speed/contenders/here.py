"""This package: θ and f integrated out, drawn exactly afterwards."""

from typing import TYPE_CHECKING

import numpy as np

from benchmarks.speed.drawn import BOUNDARY, FEATURES, LEAST_NOISE, Clock, Drawn, Settings
from benchmarks.speed.problems import Data

if TYPE_CHECKING:
    from bayes_greybox.data.trajectories import Trajectories
    from bayes_greybox.greybox import GreyBox


def sample(data: Data, settings: Settings, clock: Clock) -> Drawn:
    """Run `GreyBox.fit` with Laplace's prior and the projected kernel: a whole fit; it does not look at the cap."""
    return _fitted(data, settings, clock, FEATURES[len(data.columns)])


def without_f(data: Data, settings: Settings, clock: Clock) -> Drawn:
    """Run `GreyBox.fit` with the regularised horseshoe and no f, as PySINDy's SBR has it."""
    return _fitted(data, settings, clock, None)


def asked_of(data: Data, along: int | None) -> "tuple[GreyBox, Trajectories]":
    """Return the model that is fitted, and its rows.

    Without features `along` each variable there is no f, and the regularised horseshoe in the place of Laplace's prior.
    """
    from bayes_greybox.data.trajectories import Trajectories
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.model.gp.discrepancy import OrthogonalGP
    from bayes_greybox.model.priors import Laplace, RegularisedHorseshoe

    name = data.equation
    rows = Trajectories.from_arrays(data.time, states=dict(data.columns), derivatives={name: data.rate})
    model = GreyBox(
        dictionary={name: data.formulas},
        prior=RegularisedHorseshoe() if along is None else Laplace(),
        discrepancy=None if along is None else OrthogonalGP(features=along, boundary=BOUNDARY),
        noise_floor=LEAST_NOISE,
    )
    return model, rows


def _fitted(data: Data, settings: Settings, clock: Clock, along: int | None) -> Drawn:
    model, rows = asked_of(data, along)
    fit = model.fit(
        rows, draws=settings.draws, tune=settings.tune, chains=settings.chains, seed=settings.seed,
        target_accept=settings.target_accept, progress=False,
    )  # fmt: skip
    seconds = clock()
    name, posterior, stats = data.equation, fit.idata["posterior"].dataset, fit.idata["sample_stats"].dataset
    scale = fit.equations[name].frame.coefficient_scale
    of_eta = ("sigma", "tau") if along is None else ("sigma", "tau", "amplitude", "length_scale")
    eta = [posterior[f"{name}_{each}"].to_numpy() for each in of_eta]
    return Drawn(
        posterior[f"{name}_theta"].to_numpy() / scale,
        np.concatenate([each.reshape(*each.shape[:2], -1) for each in eta], axis=2),
        ((seconds, settings.draws),),
        float(stats["n_steps"].sum()),
        int(stats["diverging"].sum()),
    )
