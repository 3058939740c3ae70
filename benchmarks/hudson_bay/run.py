"""`Fit.refine` on the pelts of Hudson Bay, against a reference, and against the model written by hand.

The reference is the posterior `hudson_lynx_hare-lotka_volterra` of posteriordb (Magnusson, Bürkner and Vehtari, github
stan-dev/posteriordb): 10,000 draws of Stan. The model is that of Carpenter (2018), du/dt = (α − β v) u,
dv/dt = (−γ + δ u) v, hares u and lynxes v with lognormal errors.
"""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from bayes_greybox.data.datasets import load_hudson_bay
from bayes_greybox.data.trajectories import Trajectories
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables

REFERENCE: dict[str, tuple[float, float, float, float, float]] = {
    "alpha": (0.54686, 0.063055, 0.44822, 0.54365, 0.65504),
    "beta": (0.027747, 0.0041547, 0.021378, 0.027502, 0.035021),
    "gamma": (0.8001, 0.08937, 0.66422, 0.79406, 0.95768),
    "delta": (0.024086, 0.0035281, 0.018857, 0.023825, 0.030307),
    "u(0)": (34.035, 2.9169, 29.344, 33.944, 39.038),
    "v(0)": (5.9359, 0.53055, 5.1149, 5.9113, 6.8339),
    "sigma_u": (0.24806, 0.043263, 0.18781, 0.24249, 0.3278),
    "sigma_v": (0.25102, 0.04359, 0.19107, 0.24484, 0.33129),
}
"""Mean, standard deviation, and quantiles at 5, 50 and 95 % by quantity."""

RATE, INTERACTION = (1.0, 0.5), (0.05, 0.05)
"""Mean and standard deviation of the normal priors of α and γ, and of β and δ; all are positive."""

START, ERROR = (10.0, 1.0), (-1.0, 1.0)
"""Median and logarithmic standard deviation of the populations in 1900; the same of both errors, by its logarithm."""

DRAWS_BY_HAND = 500
"""Draws of the one chain of the model written by hand, which takes minutes, after as many of warm-up."""

REFINED, BY_HAND = "fit and refine", "NumPyro and diffrax"
"""Samplers."""


def cases(asked: Asked) -> list[Case]:
    """Return both samplers."""
    return [
        Case(f"{name}/{asked.seed}", (name, asked.seed, asked.progress), {"sampler": name})
        for name in (REFINED, BY_HAND)
    ]


def sampled(name: str, seed: int, progress: bool) -> dict[str, Any]:
    """Return the moments of a sampler's draws against the reference, and its speed."""
    pelts, start = load_hudson_bay(), time.perf_counter()
    if name == REFINED:
        draws = refined(pelts, seed, progress)
    else:
        # Imported here: it brings NumPyro and diffrax.
        from .plain import by_hand

        draws = by_hand(
            pelts.time - pelts.time[0], pelts.matrix(("hare", "lynx")), DRAWS_BY_HAND, seed=seed, progress=progress
        )
    return {**speed(draws, time.perf_counter() - start), "quantities": compared(draws)}


def refined(pelts: Trajectories, seed: int, progress: bool) -> dict[str, np.ndarray]:
    """Return draws of `Fit.refine` under the reference's priors, [n_chain, n_draw] by quantity.

    The equations of the populations' logarithms are linear in the coefficients, and errors are normal.
    """
    # Imported here: these bring JAX.
    from bayes_greybox.greybox import GreyBox
    from bayes_greybox.model.rows.trajectory_rows import TrajectoryRows
    from bayes_greybox.physics.coefficient import Coefficient

    hare, lynx = (np.log(pelts.states[name]) for name in ("hare", "lynx"))
    data = Trajectories.from_arrays(pelts.time - pelts.time[0], states={"hare": hare, "lynx": lynx})

    def prior(mean: float, sd: float, sign: int) -> Coefficient:
        return Coefficient(mean=sign * mean, sd=sd, sign=sign)

    model = GreyBox(
        {"hare": ["1", "exp(lynx)"], "lynx": ["1", "exp(hare)"]},
        rows=TrajectoryRows(),
        discrepancy=None,
        coefficients={
            "hare": {"1": prior(*RATE, 1), "exp(lynx)": prior(*INTERACTION, -1)},
            "lynx": {"1": prior(*RATE, -1), "exp(hare)": prior(*INTERACTION, 1)},
        },
    )
    sampling: dict[str, Any] = {"tune": 300, "chains": 4, "seed": seed, "progress": progress}
    median, spread = ERROR
    start, error = (float(np.log(START[0])), START[1]), (float(np.exp(median)), spread)
    exact = model.fit(data, draws=500, **sampling).refine(
        draws=1000, starts={"hare": start, "lynx": start}, noise={"hare": error, "lynx": error}, **sampling
    )
    drawn = exact.idata["posterior"].dataset
    theta, begun, sigma = (drawn[f"hare_and_lynx_{name}"].to_numpy() for name in ("theta", "start", "sensor_sigma"))
    return {
        "alpha": theta[..., 0],
        "beta": -theta[..., 1],
        "gamma": -theta[..., 2],
        "delta": theta[..., 3],
        "u(0)": np.exp(begun[..., 0, 0]),
        "v(0)": np.exp(begun[..., 0, 1]),
        "sigma_u": sigma[..., 0],
        "sigma_v": sigma[..., 1],
    }


def compared(draws: Mapping[str, np.ndarray]) -> dict[str, dict[str, float]]:
    """Compare draws with the reference.

    Returns:
        By quantity: the reference's mean and sd; the error of the draws' mean and of their quantiles at 5, 50 and 95 %
        over that sd, and their sd over that sd.
    """
    rows = {}
    for name, (mean, sd, *quantiles) in REFERENCE.items():
        off = (np.quantile(draws[name], [0.05, 0.5, 0.95]) - quantiles) / sd
        rows[name] = {
            "reference mean": mean,
            "reference sd": sd,
            "mean": (float(draws[name].mean()) - mean) / sd,
            "sd": float(draws[name].std()) / sd,
            **dict(zip(("5 %", "50 %", "95 %"), map(float, off), strict=True)),
        }
    return rows


def speed(draws: Mapping[str, np.ndarray], seconds: float) -> dict[str, float]:
    """Return the least bulk effective sample size, the seconds, compilation included, and effective draws a second."""
    from bayes_greybox.criticism.convergence import array_stats

    least = min(float(array_stats().ess(value, method="bulk")) for value in draws.values())
    return {"effective draws": least, "seconds": seconds, "a second": least / seconds}


def score(records: list[Record]) -> Tables:
    """Return the moments of `Fit.refine` by quantity, and the speed by sampler."""
    quantities = pd.DataFrame.from_dict(records[0]["quantities"], orient="index").rename_axis("quantity")
    columns = ["sampler", "effective draws", "seconds", "a second"]
    return {"quantities": quantities, "samplers": pd.DataFrame(records, columns=columns).set_index("sampler")}


def show(tables: Tables) -> dict[str, pd.DataFrame]:
    """Return both tables."""
    title = "Errors over the reference's standard deviations; standard deviations over its own"
    return {title: tables["quantities"], "Samplers": tables["samplers"]}


HUDSON_BAY = Benchmark(
    "hudson-bay",
    "compares the exact trajectory posterior with a reference, and with the model written by hand.",
    {"seed": 0},
    cases,
    sampled,
    score,
    show,
    threads=1,
)
