"""Draws from the prior, θ, γ and f among them, and the log prior density of every posterior draw."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpyro.handlers import seed, substitute, trace

from bayes_greybox.model.design import Design
from bayes_greybox.model.sites import Sites
from bayes_greybox.running.traces import kept

from .draws import by_chain


def prior_sampler(model: Callable, n_draw: int, identity: Any = None) -> Callable[..., dict[str, np.ndarray]]:
    """Return a function (designs, key) that draws θ, γ, f and every site of the model but the target from the prior.

    It returns scaled variables under the names that posterior draws have, each [1, n_draw, ...]. With an `identity` of
    the model, traces are kept (see `traces.kept`).
    """

    def one(designs: Mapping[str, Design], key: Array) -> dict[str, Array]:
        site_key, own_key = jax.random.split(key)
        sites = trace(seed(model, site_key)).get_trace(designs)
        kinds = ("sample", "deterministic")
        drawn = {n: s["value"] for n, s in sites.items() if s["type"] in kinds and not s.get("is_observed")}
        for own, key_e in zip(Sites(designs).values(), jax.random.split(own_key, len(designs)), strict=True):
            likelihood = sites[own.y]["fn"]
            design, scales = likelihood.design, likelihood.scales
            key_gamma, key_theta, key_f = jax.random.split(key_e, 3)
            theta, sd = design.coefficients.draw(scales, key_gamma, key_theta)
            parts = {"theta": theta, "theta_sd": sd, **design.prior_discrepancy(key_f, likelihood.hyper)}
            if scales.log_odds is not None:
                parts["gamma"] = (sd > 0).astype(float)
            drawn |= {own[name]: value for name, value in parts.items()}
        return drawn

    # One after another: a batch would hold a covariance matrix for each draw on the exact path.
    def draw_all(designs: Mapping[str, Design], key: Array) -> dict[str, Array]:
        return jax.lax.map(lambda each: one(designs, each), jax.random.split(key, n_draw))

    program = kept(draw_all, None if identity is None else (identity, n_draw), "prior", once=True)
    return lambda designs, key: {name: np.asarray(value)[None] for name, value in program(designs, key).items()}


def log_prior(model: Callable, identity: Any = None) -> Callable[..., dict[str, np.ndarray]]:
    """Return a function (designs, draws) that gives log p of each site at each draw, and of θ given its scales.

    Draws are those of the sites, and `e_theta` and `e_theta_sd` of each equation in scaled units, each
    [n_chain, n_draw, ...]. Densities are [n_chain, n_draw] for each site (events summed); `e_theta` is
    Σ_j log N(θ_j; m_j, sd_j²) over the included terms, each normalised between its bounds, and `e_gamma` is
    log p(γ | π) even if the patterns are summed and γ is no site. The `identity` is that of `prior_sampler`.
    """

    def one(designs: Mapping[str, Design], values: dict[str, Array]) -> dict[str, Array]:
        sites = trace(seed(substitute(model, data=values), jax.random.PRNGKey(0))).get_trace(designs)
        out = {
            name: jnp.sum(site["fn"].log_prob(site["value"]))
            for name, site in sites.items()
            if site["type"] == "sample" and not site["is_observed"]
        }
        for own in Sites(designs).values():
            theta, sd = values[own.theta], values[own.theta_sd]
            inside = sd > 0
            scale = jnp.where(inside, sd, 1.0)
            likelihood = sites[own.y]["fn"]
            coefficients, log_odds = likelihood.design.coefficients, likelihood.scales.log_odds
            density = jax.scipy.stats.norm.logpdf(theta, coefficients.mean, scale)
            out[own.theta] = jnp.sum(jnp.where(inside, density, 0.0)) + coefficients.log_restriction(sd)
            if log_odds is not None:
                # log π for an included term, log(1 − π) for an excluded one
                out[own.gamma] = -jnp.sum(jnp.logaddexp(0.0, jnp.where(inside, -log_odds, log_odds)))
        return out

    return by_chain(kept(jax.vmap(one, in_axes=(None, 0)), identity, "log_prior", once=True))
