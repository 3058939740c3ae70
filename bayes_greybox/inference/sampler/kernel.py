"""The MCMC kernel of a fit: NUTS, and exact Gibbs moves on the inclusion pattern γ where it is a site of the model."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int
from numpyro.handlers import seed, substitute, trace
from numpyro.infer import NUTS, HMCGibbs

from bayes_greybox.model.design import Design
from bayes_greybox.model.sampling_program import SamplingProgram
from bayes_greybox.model.sites import Sites


def posterior_kernel(model: SamplingProgram, designs: Mapping[str, Design], target_accept: float) -> Any:
    """Return NumPyro's kernel for the posterior of a model whose argument is `designs`, which may be traced."""
    # log σ has a posterior standard deviation of 1/√(2n). A warm-up from unit scales, or with NumPyro's pull of every
    # scale towards 1e-3, would take three times the steps for a million rows as for a thousand.
    sites = Sites(designs)
    scales = {(sites[name].noise,): jnp.reshape(0.5 / design.n_obs, 1) for name, design in designs.items()}
    kernel: Any = NUTS(
        model.numpyro_model, target_accept_prob=target_accept, inverse_mass_matrix=scales, regularize_mass_matrix=False
    )
    with_gamma = model.gibbs_equations(designs)
    if not with_gamma:
        return kernel
    move = gamma_move(model.numpyro_model, designs, with_gamma)
    return HMCGibbs(kernel, gibbs_fn=move, gibbs_sites=[sites[name].gamma for name in with_gamma])


def gamma_move(model: Callable, designs: Any, equations: tuple[str, ...]) -> Callable:
    """Return a `gibbs_fn` for `numpyro.infer.HMCGibbs`: a sweep over γ of each of these equations, and swaps.

    Given η, τ and π the posterior of γ is p(γ | ·) ∝ Π π^γ (1 − π)^(1−γ) p(y | γ, ·), and p(y | γ, ·) is
    Gaussian with θ and f integrated out. In terms of A = TᵀT and b = Tᵀq of the remaining regression (see
    `model.algebra.collapsed`), bringing term j into the set γ multiplies the evidence by

        (1 + τ² r)^{-1/2} exp(½ s²/(r + τ⁻²)),
        r = A_jj − A_jγ (A_γγ + τ⁻² I)⁻¹ A_γj,   s = b_j − A_jγ (A_γγ + τ⁻² I)⁻¹ b_γ,

    which the sweep operator (Goodnight 1979) keeps up to date in K² operations a flip. Swapping a term that
    is in for one that is out (Metropolis) lets near-collinear terms change places.
    """
    names = Sites(designs)

    def move(rng_key: Array, gibbs_sites: Mapping[str, Array], hmc_sites: Mapping[str, Array]) -> dict[str, Array]:
        values = {**hmc_sites, **gibbs_sites}
        sites = trace(seed(substitute(model, data=values), rng_key)).get_trace(designs)
        new = {}
        for equation, key in zip(equations, jax.random.split(rng_key, len(equations)), strict=True):
            own, design = names[equation], designs[equation]
            likelihood = sites[own.y]["fn"]
            regression, _ = design.remove_discrepancy(design.y, likelihood.hyper)
            A, b = regression.T.T @ regression.T, regression.T.T @ regression.q
            gamma = resample_pattern(key, values[own.gamma], A, b, values[own.tau], values[own.pi])
            new[own.gamma] = gamma.astype(values[own.gamma].dtype)
        return new

    return move


def resample_pattern(
    key: Array, gamma: Int[Array, " n_term"], A: Float[Array, "n_term n_term"], b: Float[Array, " n_term"],
    tau: Float[Array, ""], pi: Float[Array, ""],
) -> Int[Array, " n_term"]:  # fmt: skip
    """Sweep over all terms of the pattern γ once in random order, then propose n_term swaps.

    A is the information of the data about θ, scaled units, and b = A θ̂; tau and pi are the slab's standard deviation
    and the prior inclusion probability.
    """
    n_term = len(b)
    order_key, flip_key, swap_key = jax.random.split(key, 3)
    log_odds = jnp.log(pi) - jnp.log1p(-pi)
    augmented = jnp.block([[A + jnp.eye(n_term) / tau**2, b[:, None]], [b[None, :], jnp.zeros((1, 1))]])
    gamma = gamma.astype(int)
    augmented = jax.lax.fori_loop(0, n_term, lambda j, M: jnp.where(gamma[j] == 1, _sweep(M, j), M), augmented)

    def log_factor(M: Array, j: Array) -> Array:
        # For an excluded term: log BF = −½ log(τ² pivot) + ½ s²/pivot, pivot = r + τ⁻²
        pivot = M[j, j]
        return -0.5 * jnp.log(tau**2 * pivot) + 0.5 * M[j, -1] ** 2 / pivot

    def flip(i: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        M, gamma = carry
        j = order[i]
        out = jnp.where(gamma[j] == 1, _sweep(M, j, -1.0), M)
        included = jax.random.bernoulli(flip_keys[i], jax.nn.sigmoid(log_odds + log_factor(out, j)))
        return jnp.where(included, _sweep(out, j), out), gamma.at[j].set(included.astype(int))

    def swap(i: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        M, gamma = carry
        pick_key, accept_key = jax.random.split(swap_keys[i])
        score = jax.random.gumbel(pick_key, (n_term,))
        leaves = jnp.argmax(jnp.where(gamma == 1, score, -jnp.inf))
        enters = jnp.argmax(jnp.where(gamma == 0, score, -jnp.inf))
        possible = (gamma.sum() > 0) & (gamma.sum() < n_term)
        without = _sweep(M, leaves, -1.0)
        # Both sets have the same size, so prior and proposal cancel.
        log_ratio = log_factor(without, enters) - log_factor(without, leaves)
        accept = possible & (jnp.log(jax.random.uniform(accept_key)) < log_ratio)
        swapped = gamma.at[leaves].set(0).at[enters].set(1)
        return jnp.where(accept, _sweep(without, enters), M), jnp.where(accept, swapped, gamma)

    order = jax.random.permutation(order_key, n_term)
    flip_keys, swap_keys = jax.random.split(flip_key, n_term), jax.random.split(swap_key, n_term)
    carry = jax.lax.fori_loop(0, n_term, flip, (augmented, gamma))
    return jax.lax.fori_loop(0, n_term, swap, carry)[1]


def _sweep(M: Float[Array, "n n"], j: Array | int, sign: float = 1.0) -> Float[Array, "n n"]:
    """Sweep in pivot j, so that the other entries become those of the regression with term j; sign −1 inverts it."""
    pivot, row = M[j, j], M[j]
    swept, scaled = M - jnp.outer(row, row) / pivot, sign * row / pivot
    return swept.at[j].set(scaled).at[:, j].set(scaled).at[j, j].set(-1 / pivot)
