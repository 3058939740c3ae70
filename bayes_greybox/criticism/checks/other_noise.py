"""Which noise the residuals speak for, where a check says that they are not what the model's noise leaves."""

from dataclasses import asdict

import numpy as np

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.model.gp.hyper import NoisePrior
from bayes_greybox.model.noise.asked import FIT, Noise, varies_with
from bayes_greybox.model.noise.noise_model import CORRELATED, HEAVY, PROCESS, VARYING, NoiseModel
from bayes_greybox.model.noise.suspicions import suspicions

CLEAR = 3.0
"""Log Bayes factor from which a noise is worth a try."""

OPTIONS = {CORRELATED: "correlation", VARYING: "depends_on", HEAVY: "tails", PROCESS: "force"}
"""Arguments of `Noise` by what they let the noise be."""

DRAWS = 100
"""Posterior draws that the mean residual is taken over."""


def suggestion(posterior: Posterior, equation: str) -> str:
    """A sentence with the noise to try next; "" where the residuals speak for none.

    A rest of rates that is smooth in time is something that the model lacks and no noise, so nothing is suggested for
    it; the path of samples may be moved by an unknown force.

    Args:
        posterior: Fitted model.
        equation: Learned state.
    """
    entry = posterior.equations[equation]
    rows = entry.rows
    if not rows.noise.square:
        return ""
    draws = posterior.draws(equation, DRAWS)
    Phi, Psi, y = entry.parts()
    residual = np.mean(y - draws.theta @ Phi.T - entry.design.at_data(Psi, slice(None), draws), axis=0)
    given = posterior.model.noise
    noise = given if isinstance(given, Noise) else Noise(scale=given)
    taken = tuple(name for name, option in OPTIONS.items() if getattr(noise, option) is not None)
    # The correlation that differentiation gives is known.
    known = NoiseModel(
        rows.noise, taken if rows.noise.error.independent or noise.correlation is not None else (*taken, CORRELATED)
    )
    quantities = varies_with(rows)
    prior = NoisePrior(float(entry.design.noise_floor), noise.scale)
    factors = {s.name: s.log_bayes_factor for s in suspicions(residual, known, rows.time, rows.run, quantities, prior)}
    best = max(factors, key=factors.__getitem__, default=PROCESS)
    if factors.get(best, 0.0) < CLEAR or (best == PROCESS and not len(rows.noise.intensities)):
        return ""
    options = {key: value for key, value in asdict(noise).items() if key != "found" and value is not None}
    options = {key: value for key, value in options.items() if (key, value) != ("scale", 1.0)} | {OPTIONS[best]: FIT}
    written = ", ".join(f"{key}={value!r}" for key, value in options.items())
    what = "an unknown force on the path" if best == PROCESS else best
    return (
        f"The residuals of {equation!r} speak for {what} (log Bayes factor {factors[best]:.0f}): "
        f"try GreyBox(noise=bg.Noise({written}))."
    )
