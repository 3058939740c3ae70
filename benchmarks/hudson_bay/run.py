"""`Fit.refine` on the pelts of Hudson Bay, against the reference, and against the model written by hand."""

import os
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from bayes_greybox.data.datasets import load_hudson_bay
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.plain_values import plain_rows
from benchmarks.files import unwritable, write_tables

from .reference import INTERACTION, NOISE, RATE, REFERENCE, START

DRAWS, CHAINS = 1000, 4
"""Kept of each chain, and chains."""

BY_HAND = 500
"""Draws of the one chain of the model written by hand, which takes minutes, after as many of warm-up."""


def run(output: str | os.PathLike[str], *, seed: int = 1, progress: bool = True) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Sample the posterior both ways, and write the tables.

    Args:
        output: Folder for quantities.csv, samplers.csv and summary.json.
        seed: Of both samplers.
        progress: Whether to show progress bars.

    Returns:
        By quantity: the reference's mean and sd; of `refine`, the error of its mean and of its quantiles at 5, 50 and
        95 % over that sd, and its sd over that sd. By sampler: least bulk effective sample size of all quantities,
        seconds, and the one over the other.

    Raises:
        InputError: The data are not there; a folder that cannot be written to.
    """
    # Imported here: it brings NumPyro and diffrax.
    from .plain import sampled

    pelts, folder = load_hudson_bay(), Path(output)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(folder, error) from error
    years = pelts.time - pelts.time[0]
    with threadpool_limits(1):
        start = time.perf_counter()
        ours = refined(pelts, seed, progress)
        middle = time.perf_counter()
        plain = sampled(years, pelts.matrix(("hare", "lynx")), BY_HAND, 1, seed, progress)
        seconds = middle - start, time.perf_counter() - middle
    quantities = compared(ours)
    samplers = pd.DataFrame(
        [speed(ours, seconds[0]), speed(plain, seconds[1])],
        index=pd.Index(["fit and refine", "NumPyro and diffrax"], name="sampler"),
    )
    tables = {"quantities": quantities, "samplers": samplers}
    try:
        write_tables(folder, tables, {"seed": seed, **{name: plain_rows(table) for name, table in tables.items()}})
    except OSError as error:
        raise unwritable(folder, error) from error
    return quantities, samplers


def refined(pelts: Trajectories, seed: int, progress: bool) -> dict[str, np.ndarray]:
    """Draws of `Fit.refine` under the reference's priors, [n_chain, n_draw] by quantity.

    Of the logarithms of the populations the equations are linear in the coefficients, and errors are normal.

    Args:
        pelts: Hares and lynxes in thousands.
        seed: Of everything random.
        progress: Whether to show progress bars.
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
    fit = model.fit(data, draws=500, tune=300, chains=CHAINS, seed=seed, progress=progress)
    median, spread = NOISE
    start, error = (float(np.log(START[0])), START[1]), (float(np.exp(median)), spread)
    exact = fit.refine(
        draws=DRAWS, tune=300, chains=CHAINS, seed=seed, progress=progress,
        starts={"hare": start, "lynx": start}, noise={"hare": error, "lynx": error},
    )  # fmt: skip
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


def compared(draws: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """Draws against the reference, by quantity; see `run`."""
    rows = {}
    for name, (mean, sd, *quantiles) in REFERENCE.items():
        own = draws[name]
        off = (np.quantile(own, [0.05, 0.5, 0.95]) - quantiles) / sd
        rows[name] = {
            "reference mean": mean,
            "reference sd": sd,
            "mean": (float(own.mean()) - mean) / sd,
            "sd": float(own.std()) / sd,
            **dict(zip(("5 %", "50 %", "95 %"), map(float, off), strict=True)),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("quantity")


def speed(draws: Mapping[str, np.ndarray], seconds: float) -> dict[str, float]:
    """Least bulk effective sample size, seconds, and effective draws a second.

    Args:
        draws: By quantity.
        seconds: That they took, compilation included.
    """
    from bayes_greybox.criticism.convergence import array_stats

    least = min(float(array_stats().ess(value, method="bulk")) for value in draws.values())
    return {"effective draws": least, "seconds": seconds, "a second": least / seconds}
