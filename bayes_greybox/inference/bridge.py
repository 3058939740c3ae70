"""Bridge sampling: the integral of a density from NUTS draws, where importance sampling is not sure of it."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpyro.infer import NUTS

from bayes_greybox.inference.sampler.nuts import Sampler
from bayes_greybox.model.sites import VECTOR, density_model
from bayes_greybox.running.compiling import compiled

ITERATIONS, TOLERANCE = 200, 1e-8
"""Of the fixed point; it converges in about ten iterations."""


class Bridged(NamedTuple):
    """Log evidence and its standard error, both in nats."""

    log_evidence: float
    se: float


def bridge(
    log_density: Callable[[Array, Any], Array],
    argument: Any,
    size: int,
    *,
    draws: int = 500,
    tune: int = 300,
    chains: int = 2,
    seed: int = 0,
) -> Bridged:
    """Log of the integral of a density over a real vector, from NUTS draws.

    The optimal bridge of Meng & Wong (1996), Eq. 4.1, between the posterior and a normal fitted to the first half of
    each chain; the second half is bridged (Gronau et al. 2017, Eq. 15). The error follows Frühwirth-Schnatter (2004),
    draws of a chain counted as independent.

    Args:
        log_density: Log of the unnormalised density of the vector, given an argument.
        argument: Its argument, a pytree of arrays.
        size: Length of the vector.
        draws: Draws of each chain.
        tune: Warm-up of each chain.
        chains: Chains.
        seed: Seed of everything random.
    """
    model = density_model(log_density, size)
    key, other = jax.random.split(jax.random.PRNGKey(seed))
    sampler = Sampler(lambda _: NUTS(model, target_accept_prob=0.9), tune)
    chained = sampler.run(argument, draws=draws, chains=chains, key=key, progress=False)
    eta = chained.samples[VECTOR]
    fitted = eta[:, : draws // 2].reshape(-1, size)
    kept = eta[:, draws // 2 :].reshape(-1, size)
    mean, root = fitted.mean(axis=0), np.linalg.cholesky(np.cov(fitted.T) + 1e-10 * np.eye(size))
    z = np.asarray(jax.random.normal(other, kept.shape))
    proposed = mean + z @ root.T
    values = compiled(
        lambda points, argument: jax.lax.map(lambda point: log_density(point, argument), points), once=True
    )
    posterior_at = [np.asarray(values(jnp.asarray(points), argument)) for points in (kept, proposed)]
    proposal_at = [_log_normal(points, mean, root) for points in (kept, proposed)]
    l_kept, l_proposed = (p - q for p, q in zip(posterior_at, proposal_at, strict=True))
    return _fixed_point(l_kept, l_proposed)


def _fixed_point(l_kept: Float[np.ndarray, " n_kept"], l_proposed: Float[np.ndarray, " n_proposed"]) -> Bridged:
    n1, n2 = len(l_kept), len(l_proposed)
    s1, s2 = n1 / (n1 + n2), n2 / (n1 + n2)
    shift = float(np.median(l_kept))
    a, b = l_kept - shift, np.where(np.isfinite(l_proposed), l_proposed - shift, -np.inf)
    log_r = 0.0
    for _ in range(ITERATIONS):
        # r ← mean_q[l/(s₁ l + s₂ r)] / mean_p[1/(s₁ l + s₂ r)]
        upper = np.logaddexp.reduce(b - np.logaddexp(math.log(s1) + b, math.log(s2) + log_r)) - math.log(n2)
        lower = np.logaddexp.reduce(-np.logaddexp(math.log(s1) + a, math.log(s2) + log_r)) - math.log(n1)
        new = float(upper - lower)
        done, log_r = abs(new - log_r) < TOLERANCE, new
        if done:
            break
    f1 = np.exp(b - np.logaddexp(math.log(s1) + b, math.log(s2) + log_r))
    f2 = np.exp(log_r - np.logaddexp(math.log(s1) + a, math.log(s2) + log_r))
    variance = np.var(f1) / (np.mean(f1) ** 2 * n2) + np.var(f2) / (np.mean(f2) ** 2 * n1)
    return Bridged(log_r + shift, float(np.sqrt(variance)))


def _log_normal(x: np.ndarray, mean: np.ndarray, root: np.ndarray) -> np.ndarray:
    z = np.linalg.solve(root, (x - mean).T)
    return -0.5 * np.sum(z**2, axis=0) - np.sum(np.log(np.diag(root))) - 0.5 * len(mean) * math.log(2 * math.pi)
