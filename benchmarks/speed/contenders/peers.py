"""Samplers of others: PyMC's HSGP, drawn by nutpie, and PySINDy's sparse Bayesian regression.

Priors, number and domain of PyMC's features are as in `by_hand`, and θ is sampled. PySINDy has θ under a regularised
horseshoe, no f, and draws by NumPyro's NUTS.
"""

import importlib
import os
import time
from typing import Any

import numpy as np

from bayes_greybox.running.errors import InputError
from benchmarks.speed.drawn import BOUNDARY, LEAST_NOISE, Clock, Drawn, Settings, tensor_features
from benchmarks.speed.problems import Data, Scaled

PATIENCE, PATIENCE_GROWTH = 0.5, 1.25
"""Seconds to the first look at the draws of nutpie, and the factor by which the next gap is longer."""


def plain(data: Data, settings: Settings, clock: Clock) -> Drawn:
    """Draw from PyMC's HSGP as it is, which is not orthogonal to the dictionary: another posterior of θ."""
    return _sampled(data, settings, clock, projected=False)


def projected(data: Data, settings: Settings, clock: Clock) -> Drawn:
    """Draw with the dictionary projected out of PyMC's features, once: the posterior of the others, but for sines."""
    return _sampled(data, settings, clock, projected=True)


def sbr(data: Data, settings: Settings, clock: Clock) -> Drawn:
    """Draw from PySINDy's `SBR` with its own priors; it does not look at the cap."""
    (pysindy,) = require("pysindy")
    scaled = data.scaled()
    chains = {"num_chains": settings.chains, "chain_method": "sequential", "progress_bar": False}
    # Given whole: SBR takes the seed out of the dictionary that it is handed.
    regression = pysindy.SBR(
        num_warmup=settings.tune, num_samples=settings.draws, mcmc_kwargs={**chains, "seed": settings.seed},
        nuts_kwargs={"target_accept_prob": settings.target_accept},
    )  # fmt: skip
    regression.fit(scaled.Phi, scaled.y[:, None])
    drawn = regression.mcmc_.get_samples(group_by_chain=True)
    looks = ((clock(), settings.draws),)
    eta = np.stack([np.asarray(drawn["sigma"]), np.asarray(drawn["tau"])], axis=2)
    diverging = regression.mcmc_.get_extra_fields()["diverging"]
    return Drawn(np.asarray(drawn["beta"])[:, :, 0], eta, looks, float("nan"), int(np.sum(diverging)))


def require(*names: str) -> tuple[Any, ...]:
    """Import packages on first use.

    Raises:
        InputError: One is not installed.
    """
    try:
        return tuple(importlib.import_module(name) for name in names)
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
        pm.Normal("y", mean, pm.math.sqrt(LEAST_NOISE**2 + noise**2), observed=y)
    return model


def _sampled(data: Data, settings: Settings, clock: Clock, projected: bool) -> Drawn:
    pm, nutpie = require("pymc", "nutpie")
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
    while not _is_finished(sampler) and clock() < settings.cap:
        time.sleep(0.05)
        if clock() >= again:
            gap *= PATIENCE_GROWTH
            again = clock() + gap
            looks.append((clock(), _whole(sampler.inspect())))
    found = sampler.wait() if _is_finished(sampler) else sampler.abort()
    n = _whole(found)
    looks = (*(each for each in looks if 0 < each[1] < n), (clock(), n))
    posterior, stats = found.posterior, found.sample_stats
    eta = [posterior[name].to_numpy()[:, :n] for name in ("tau", "amplitude", "length", "noise")]
    return Drawn(
        posterior["theta"].to_numpy()[:, :n],
        np.concatenate([each[..., None] if each.ndim == 2 else each for each in eta], axis=2),
        looks,
        float(np.sum(stats["n_steps"].to_numpy()[:, :n])),
        int(np.sum(stats["diverging"].to_numpy()[:, :n].astype(bool))),
        compiling,
    )


def _is_finished(sampler: Any) -> bool:
    """Return True if all is drawn; nutpie 0.16 raises where it is not."""
    try:
        return bool(sampler.is_finished)
    except TimeoutError:
        return False


def _whole(found: Any) -> int:
    """Count the draws that every chain has: those of one that is behind are filled up with NaN."""
    if "posterior" not in found or "theta" not in found.posterior:
        return 0
    there = np.isfinite(found.posterior["theta"].to_numpy()).all(axis=2)
    return int(there.sum(axis=1).min()) if len(there) else 0
