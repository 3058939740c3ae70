"""Exact draws of the quantities that were integrated out: inclusion patterns, coefficients, f."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import logsumexp
from jaxtyping import Array
from numpyro.handlers import seed, substitute, trace

from bayes_greybox.model.algebra.collapsed import patterns, ridge, spike_and_slab
from bayes_greybox.model.algebra.linalg import solve_lower_transposed
from bayes_greybox.model.design import Design
from bayes_greybox.model.likelihood import CollapsedNormal
from bayes_greybox.model.sites import Sites
from bayes_greybox.running.arrays import on_device
from bayes_greybox.running.traces import kept


def conditional_sampler(model: Callable, identity: Any = None) -> Callable[..., dict[str, np.ndarray]]:
    """Return a function (designs, samples, key) that draws γ, θ and f exactly, given each draw of the hyperparameters.

    The argument of the collapsed model is `designs`, and its sites are `samples`, each [n_chain, n_draw, ...]. With an
    `identity` of the model, traces are kept (see `traces.kept`). The function returns for each equation e, in scaled
    units: `e_theta`, `e_theta_sd` (prior standard deviation of each coefficient, zero for an excluded one) and
    `e_weight` (weights of the features) or `e_f` (values at the rows, exact path); under a spike-and-slab prior also
    `e_gamma`, and `e_inclusion`, the probability of γ_j = 1 given the hyperparameters if the patterns are summed, else
    γ_j itself.
    """

    def draw_all(designs: Mapping[str, Design], flat: dict[str, Array], key: Array) -> dict[str, Array]:
        keys = jax.random.split(key, len(next(iter(flat.values()))))
        return jax.lax.map(lambda item: conditional_draw(model, designs, item[0], item[1]), (flat, keys))

    return by_chain(kept(draw_all, identity, "conditional", once=True))


def by_chain(program: Callable[..., dict[str, Array]]) -> Callable[..., dict[str, np.ndarray]]:
    """Return a program (designs, flat draws, ...) as a function of draws [n_chain, n_draw, ...]."""

    def run(designs: Mapping[str, Design], draws: Mapping[str, np.ndarray], *further: Array) -> dict[str, np.ndarray]:
        shape = next(iter(draws.values())).shape[:2]
        # Not −1, which an array without columns leaves open.
        flat = on_device({name: value.reshape(math.prod(shape), *value.shape[2:]) for name, value in draws.items()})
        result = program(designs, flat, *further)
        return {name: np.asarray(value).reshape(*shape, *value.shape[1:]) for name, value in result.items()}

    return run


def conditional_draw(
    model: Callable, designs: Mapping[str, Design], values: Mapping[str, Array], key: Array
) -> dict[str, Array]:
    """Draw γ, θ and f of every equation once, given one draw of the sites; see `conditional_sampler`."""
    sites = trace(seed(substitute(model, data=dict(values)), key)).get_trace(designs)
    drawn = {}
    for own, key_e in zip(Sites(designs).values(), jax.random.split(key, len(designs)), strict=True):
        parts = draw_given(key_e, sites[own.y]["fn"], values.get(own.gamma))
        drawn.update({own[name]: value for name, value in parts.items()})
    return drawn


def draw_given(key: Array, likelihood: CollapsedNormal, gamma: Array | None = None) -> dict[str, Array]:
    """Draw γ, θ and f once, given the likelihood of one equation, which holds η and the prior scales.

    θ | γ, η, y ~ N(sd m, sd (I + sd TᵀT sd)⁻¹ sd), z | θ, η, y ~ N(Z_y − Z_Φ θ, (L Lᵀ)⁻¹), θ less its prior mean.
    The sampler's uniform numbers place coefficients with bounds; the others are drawn given these. The pattern is given
    if it is a site of the model.
    """
    design, hyper, scales = likelihood.design, likelihood.hyper, likelihood.scales
    key_gamma, key_theta, key_f = jax.random.split(key, 3)
    coefficients = design.coefficients
    regression, solve = design.remove_discrepancy(design.y, hyper)
    regression = regression.beside(scales.mean)
    out: dict[str, Array] = {}
    sd = free = scales.sd
    z, held = jnp.zeros(len(sd)), jnp.zeros(len(sd), bool)
    if scales.uniform is not None:
        placed = coefficients.placed(ridge(regression, sd, design.n_obs), scales)
        log_weight, bits = placed.log_weight, jnp.asarray(placed.included)
        pick = jax.random.categorical(key_gamma, log_weight)
        if scales.log_odds is not None:
            log_weight = log_weight - logsumexp(log_weight)
            out["inclusion"], out["gamma"] = _shares(log_weight, bits), bits[pick]
            sd = free = sd * bits[pick]
        index = np.array(coefficients.bounded, int)
        z, held = z.at[index].set(placed.z[pick]), held.at[index].set(True)
        free = jnp.where(held, 0.0, sd)
    elif scales.log_odds is not None:
        log_weight = spike_and_slab(regression, sd, scales.log_odds, design.n_obs, coefficients.certain)[1]
        bits = jnp.asarray(patterns(len(sd), coefficients.certain))
        out["inclusion"] = _shares(log_weight, bits)
        out["gamma"] = bits[jax.random.categorical(key_gamma, log_weight)]
        sd = free = sd * out["gamma"]
    elif gamma is not None:
        out["inclusion"] = gamma.astype(float)
    posterior = ridge(regression.beside(sd * z), free, design.n_obs)
    u = posterior.mean + solve_lower_transposed(posterior.L, jax.random.normal(key_theta, sd.shape))
    away = sd * jnp.where(held, z, u)
    # An excluded term is exactly zero, not minus zero.
    theta = jnp.where(sd > 0, away if scales.mean is None else scales.mean + away, 0.0)
    out |= {"theta": theta, "theta_sd": sd}
    return {**out, **design.draw_discrepancy(key_f, hyper, theta, solve)}


def _shares(log_weight: Array, bits: Array) -> Array:
    """Inclusion probability of each term; rounding may bring a sum over all patterns above one."""
    return jnp.minimum(jnp.exp(log_weight) @ bits, 1.0)
