"""Suggestions of another noise model, if the residuals contradict the present one."""

from dataclasses import asdict

import numpy as np

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.model.gp.hyper import NoisePrior
from bayes_greybox.model.noise.asked import FIT, Noise, varies_with
from bayes_greybox.model.noise.noise_model import CORRELATED, HEAVY, PROCESS, VARYING, NoiseModel
from bayes_greybox.model.noise.suspicions import suspicions

CLEAR_LOG_BAYES_FACTOR, MEAN_RESIDUAL_DRAWS = 3.0, 100
"""Log Bayes factor from which on a noise is suggested; posterior draws over which the residual is averaged."""

NOISE_ARGUMENTS = {CORRELATED: "correlation", VARYING: "depends_on", HEAVY: "tails", PROCESS: "force"}
"""Arguments of `Noise` by the kind of noise that they allow."""


def suggestion(posterior: Posterior, equation: str) -> str:
    """Return a sentence with the noise to try next; "" if the residuals support none.

    A residual of rates that is smooth in time is a missing effect and no noise, so nothing is suggested for it; but an
    unknown force may move the path of samples.
    """
    entry = posterior.equations[equation]
    rows = entry.rows
    if not rows.noise.square:
        return ""
    draws = posterior.draws(equation, MEAN_RESIDUAL_DRAWS)
    Phi, Psi, y = entry.parts()
    residual = np.mean(y - draws.theta @ Phi.T - entry.design.at_data(Psi, slice(None), draws), axis=0)
    noise = posterior.model.noise
    noise = noise if isinstance(noise, Noise) else Noise(scale=noise)
    modelled = [name for name, argument in NOISE_ARGUMENTS.items() if getattr(noise, argument) is not None]
    # The correlation that differentiation causes is known.
    if not rows.noise.error.independent and noise.correlation is None:
        modelled.append(CORRELATED)
    present = NoiseModel(rows.noise, tuple(modelled))
    quantities = varies_with(rows)
    prior = NoisePrior(float(entry.design.noise_floor), noise.scale)
    suspected = suspicions(residual, present, rows.time, rows.run, quantities, prior)
    factors = {each.name: each.log_bayes_factor for each in suspected}
    best = max(factors, key=factors.__getitem__, default=PROCESS)
    if factors.get(best, 0.0) < CLEAR_LOG_BAYES_FACTOR or (best == PROCESS and not len(rows.noise.intensities)):
        return ""
    stated = {key: value for key, value in asdict(noise).items() if key != "found" and value is not None}
    options = {key: value for key, value in stated.items() if (key, value) != ("scale", 1.0)}
    options[NOISE_ARGUMENTS[best]] = FIT
    written = ", ".join(f"{key}={value!r}" for key, value in options.items())
    what = "an unknown force on the path" if best == PROCESS else best
    return (
        f"The residuals of {equation!r} speak for {what} (log Bayes factor {factors[best]:.0f}): "
        f"try GreyBox(noise=bg.Noise({written}))."
    )
