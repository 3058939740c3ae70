"""The model as one would write it in NumPyro, with θ sampled: with the exact kernel, or with NumPyro's features.

θ_j ~ Laplace(0, τ), τ, amplitude and s ~ HalfNormal(1), ℓ ~ LogNormal(0, ½), σ² = floor² + s², scaled units; the kernel
squared-exponential with the dictionary projected out at the rows. Features are standardised, as NumPyro advises.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from benchmarks.speed.drawn import BOUNDARY, LEAST_NOISE, Clock, Drawn, Settings, tensor_features
from benchmarks.speed.problems import Data, Scaled

PIECE = 10
"""Iterations of each chain between two looks at the clock; warm-up and draws are multiples of it."""


def exact(data: Data, settings: Settings, clock: Clock) -> Drawn:
    """Draw from one multivariate normal, f marginalised."""
    return _sampled(_with_kernel(data.scaled()), settings, clock)


def features(data: Data, settings: Settings, clock: Clock) -> Drawn:
    """Draw with `numpyro.contrib.hsgp`, its features projected once: the same kernel, but for its sines."""
    return _sampled(_with_features(data.scaled()), settings, clock)


def _with_kernel(scaled: Scaled) -> Callable[[], None]:
    import jax.numpy as jnp
    import numpyro
    import numpyro.distributions as dist

    Phi, x, y = map(jnp.asarray, scaled)
    n = len(y)
    away = jnp.eye(n) - Phi @ jnp.linalg.solve(Phi.T @ Phi, Phi.T)

    def model() -> None:
        theta, amplitude, length, noise = _parameters(Phi.shape[1], x.shape[1])
        squares = jnp.sum(((x[:, None] - x[None]) / length) ** 2, axis=-1)
        K = away @ (amplitude**2 * jnp.exp(-0.5 * squares)) @ away
        covariance = K + (LEAST_NOISE**2 + noise**2) * jnp.eye(n)
        numpyro.sample("y", dist.MultivariateNormal(Phi @ theta, covariance), obs=y)

    return model


def _with_features(scaled: Scaled) -> Callable[[], None]:
    import jax.numpy as jnp
    import numpyro
    import numpyro.distributions as dist
    from numpyro.contrib.hsgp.laplacian import eigenfunctions
    from numpyro.contrib.hsgp.spectral_densities import diag_spectral_density_squared_exponential

    Phi, x, y = map(jnp.asarray, scaled)
    d = x.shape[1]
    m = [tensor_features(d)] * d
    psi = eigenfunctions(x, ell=[BOUNDARY] * d, m=m)
    psi = psi - Phi @ jnp.linalg.lstsq(Phi, psi)[0]

    def model() -> None:
        theta, amplitude, length, noise = _parameters(Phi.shape[1], d)
        z = numpyro.sample("z", dist.Normal().expand([psi.shape[1]]).to_event(1))
        density = diag_spectral_density_squared_exponential(amplitude, length, [BOUNDARY] * d, m, d)
        mean = Phi @ theta + psi @ (jnp.sqrt(density) * z)
        numpyro.sample("y", dist.Normal(mean, jnp.sqrt(LEAST_NOISE**2 + noise**2)).to_event(1), obs=y)

    return model


def _parameters(n_term: int, n_var: int) -> tuple[Any, Any, Any, Any]:
    import numpyro
    import numpyro.distributions as dist

    tau = numpyro.sample("tau", dist.HalfNormal(1.0))
    theta = numpyro.sample("theta", dist.Laplace(0, tau).expand([n_term]).to_event(1))
    amplitude = numpyro.sample("amplitude", dist.HalfNormal(1.0))
    length = numpyro.sample("length", dist.LogNormal(0, 0.5).expand([n_var]).to_event(1))
    return theta, amplitude, length, numpyro.sample("noise", dist.HalfNormal(1.0))


def _sampled(model: Callable[[], None], settings: Settings, clock: Clock) -> Drawn:
    """Draw by NumPyro's NUTS, a few iterations of all chains side by side.

    By the kernel itself: `MCMC` compiles once for each chain and each call, and cannot be stopped at a cap.
    """
    import jax
    from numpyro.infer import NUTS

    kernel = NUTS(model, target_accept_prob=settings.target_accept)
    keys = jax.random.split(jax.random.PRNGKey(settings.seed), settings.chains)
    states = [kernel.init(key, settings.tune, None, (), {}) for key in keys]

    def step(state: Any, _: None) -> tuple[Any, dict[str, Any]]:
        state = kernel.sample(state, (), {})
        return state, {**state.z, "steps": state.num_steps, "diverging": state.diverging}

    # Compiled once, for all chains; XLA lets go of the interpreter while it runs.
    advance = jax.jit(lambda state: jax.lax.scan(step, state, None, length=PIECE)).lower(states[0]).compile()
    kept, looks = [], []
    with ThreadPoolExecutor(settings.chains) as chains:
        for done in range(PIECE, settings.tune + settings.draws + 1, PIECE):
            advanced = list(chains.map(lambda state: jax.block_until_ready(advance(state)), states))
            states = [state for state, _ in advanced]
            if done > settings.tune:
                kept.append(jax.tree.map(lambda *each: np.stack(each), *[record for _, record in advanced]))
                looks.append((clock(), done - settings.tune))
            if clock() > settings.cap:
                break
    if not kept:
        nothing = np.empty((settings.chains, 0, 1))
        return Drawn(nothing, nothing, ((clock(), 0),), float("nan"), 0)
    drawn = jax.tree.map(lambda *each: np.concatenate(each, axis=1), *kept)
    steps, diverging = drawn.pop("steps"), drawn.pop("diverging")
    constrained = jax.vmap(jax.vmap(kernel.postprocess_fn((), {})))(drawn)
    eta = [np.asarray(constrained[name]).reshape(*steps.shape, -1) for name in ("tau", "amplitude", "length", "noise")]
    theta = np.asarray(constrained["theta"])
    return Drawn(theta, np.concatenate(eta, axis=2), tuple(looks), float(steps.sum()), int(diverging.sum()))
