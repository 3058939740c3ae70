"""Draws from the prior, and the log prior density of every posterior draw (for power-scaling sensitivity)."""

from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpyro.handlers import seed, substitute, trace

from bayes_greybox.model.likelihood import Design


def prior_draws(model: Callable, designs: Mapping[str, Design], n_draw: int, key: Array) -> dict[str, np.ndarray]:
    """Draw every site of the model but the target from the prior, each [1, n_draw, ...], scaled units.

    Args:
        model: The collapsed NumPyro model.
        designs: Its argument.
        n_draw: Number of draws.
        key: Random key.
    """

    def one(key: Array) -> dict[str, Array]:
        sites = trace(seed(model, key)).get_trace(designs)
        kinds = ("sample", "deterministic")
        return {n: s["value"] for n, s in sites.items() if s["type"] in kinds and not s.get("is_observed")}

    drawn = jax.jit(jax.vmap(one))(jax.random.split(key, n_draw))
    return {name: np.asarray(value)[None] for name, value in drawn.items()}


def log_prior_densities(
    model: Callable, designs: Mapping[str, Design], draws: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Log p of each site at each posterior draw, and of θ given its scales, in scaled units.

    Args:
        model: The collapsed NumPyro model.
        designs: Its argument.
        draws: Sites, and `e_theta`, `e_theta_sd` of each equation, each [n_chain, n_draw, ...].

    Returns:
        One array [n_chain, n_draw] for each site (events summed); `e_theta` is Σ_j log N(θ_j; 0, sd_j²) over the terms
        that are in the model.
    """
    shape = next(iter(draws.values())).shape[:2]
    flat = {name: jnp.asarray(value.reshape(shape[0] * shape[1], *value.shape[2:])) for name, value in draws.items()}

    def one(values: dict[str, Array]) -> dict[str, Array]:
        sites = trace(seed(substitute(model, data=values), jax.random.PRNGKey(0))).get_trace(designs)
        out = {
            name: jnp.sum(site["fn"].log_prob(site["value"]))
            for name, site in sites.items()
            if site["type"] == "sample" and not site["is_observed"]
        }
        for equation in designs:
            theta, sd = values[f"{equation}_theta"], values[f"{equation}_theta_sd"]
            inside = sd > 0
            scale = jnp.where(inside, sd, 1.0)
            density = jax.scipy.stats.norm.logpdf(theta, 0.0, scale)
            out[f"{equation}_theta"] = jnp.sum(jnp.where(inside, density, 0.0))
        return out

    out = jax.jit(jax.vmap(one))(flat)
    return {name: np.asarray(value).reshape(shape) for name, value in out.items()}
