"""PyMC's HSGP, drawn by nutpie, θ sampled: priors, features' number and domain as in `by_hand`."""

import importlib
import os
import time
from typing import Any

import numpy as np

from bayes_greybox.running.errors import InputError
from benchmarks.speed.drawn import BOUNDARY, FLOOR, Clock, Drawn, Settings, tensor_features
from benchmarks.speed.problems import Data, Scaled

ETA = ("tau", "amplitude", "length", "noise")
"""Variables of η."""

PATIENCE, GROWTH = 0.5, 1.25
"""Seconds to the first look at what nutpie has drawn, and by how much the next gap is longer."""


def plain(data: Data, settings: Settings, clock: Clock) -> Drawn:
    """PyMC's HSGP as it is, which is not orthogonal to the dictionary: another posterior of θ.

    Args:
        data: Data.
        settings: Settings.
        clock: Seconds since the process started.
    """
    return _sampled(data, settings, clock, projected=False)


def projected(data: Data, settings: Settings, clock: Clock) -> Drawn:
    """The dictionary projected out of PyMC's features, once: the posterior of the others, but for sines.

    Args:
        data: Data.
        settings: Settings.
        clock: Seconds since the process started.
    """
    return _sampled(data, settings, clock, projected=True)


def require() -> tuple[Any, Any]:
    """PyMC and nutpie, imported on first use.

    Raises:
        InputError: One is not installed.
    """
    try:
        return importlib.import_module("pymc"), importlib.import_module("nutpie")
    except ImportError as error:
        raise InputError(f"This needs {error.name}: pip install 'bayes-greybox[peers]'.") from error


def _model(pm: Any, scaled: Scaled, projected: bool) -> Any:
    Phi, x, y = scaled
    d = x.shape[1]
    m = tensor_features(d)
    with pm.Model() as model:
        tau = pm.HalfNormal("tau", 1.0)
        theta = pm.Laplace("theta", 0.0, tau, shape=Phi.shape[1])
        amplitude = pm.HalfNormal("amplitude", 1.0)
        length = pm.LogNormal("length", 0.0, 0.5, shape=d)
        noise = pm.HalfNormal("noise", 1.0)
        kernel = amplitude**2 * pm.gp.cov.ExpQuad(d, ls=length)
        psi, root = pm.gp.HSGP(m=[m] * d, L=[BOUNDARY] * d, cov_func=kernel).prior_linearized(x)
        if projected:
            psi = np.asarray(psi.eval())
            psi = psi - Phi @ np.linalg.lstsq(Phi, psi, rcond=None)[0]
        z = pm.Normal("z", 0.0, 1.0, shape=m**d)
        mean = pm.math.dot(Phi, theta) + pm.math.dot(psi, z * root)
        pm.Normal("y", mean, pm.math.sqrt(FLOOR**2 + noise**2), observed=y)
    return model


def _sampled(data: Data, settings: Settings, clock: Clock, projected: bool) -> Drawn:
    pm, nutpie = require()
    model = _model(pm, data.scaled(), projected)
    start = time.perf_counter()
    compiled = nutpie.compile_pymc_model(model)
    compiling = time.perf_counter() - start
    cores = min(settings.chains, os.cpu_count() or 1)
    sampler = nutpie.sample(
        compiled, draws=settings.draws, tune=settings.tune, chains=settings.chains, cores=cores, seed=settings.seed,
        target_accept=settings.target_accept, progress_bar=False, blocking=False, save_warmup=False,
    )  # fmt: skip
    looks, gap, again = [], PATIENCE, clock() + PATIENCE
    while not _finished(sampler) and clock() < settings.cap:
        time.sleep(0.05)
        if clock() >= again:
            gap *= GROWTH
            again = clock() + gap
            looks.append((clock(), _whole(sampler.inspect())))
    found = sampler.wait() if _finished(sampler) else sampler.abort()
    n = _whole(found)
    looks = (*(each for each in looks if 0 < each[1] < n), (clock(), n))
    posterior, stats = found.posterior, found.sample_stats
    eta = [posterior[name].to_numpy()[:, :n] for name in ETA]
    return Drawn(
        posterior["theta"].to_numpy()[:, :n],
        np.concatenate([each[..., None] if each.ndim == 2 else each for each in eta], axis=2),
        looks,
        float(np.sum(stats["n_steps"].to_numpy()[:, :n])),
        int(np.sum(stats["diverging"].to_numpy()[:, :n].astype(bool))),
        compiling,
    )


def _finished(sampler: Any) -> bool:
    """Whether all is drawn; nutpie 0.16 raises where it is not."""
    try:
        return bool(sampler.is_finished)
    except TimeoutError:
        return False


def _whole(found: Any) -> int:
    """Draws that every chain has: those of one that is behind are filled up with NaN."""
    if "posterior" not in found or "theta" not in found.posterior:
        return 0
    there = np.isfinite(found.posterior["theta"].to_numpy()).all(axis=2)
    return int(there.sum(axis=1).min()) if len(there) else 0
