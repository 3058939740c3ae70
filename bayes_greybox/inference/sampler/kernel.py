"""The MCMC kernel of a fit: NUTS on the hyperparameters, with Gibbs moves on γ where it is a site."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
from numpyro.infer import NUTS, HMCGibbs

from bayes_greybox.model.design import Design
from bayes_greybox.model.sampling_program import SamplingProgram
from bayes_greybox.model.sites import Sites

from .gibbs import gamma_move


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
