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
    """NumPyro's kernel for the posterior of a model.

    Args:
        model: Model.
        designs: Its argument, which may be traced.
        target_accept: Target acceptance probability of NUTS.
    """
    # log σ is known to 1/√(2n): a warm-up that starts from unit scales, or NumPyro's pull of every scale towards 1e-3,
    # would make a million rows cost three times the steps of a thousand.
    sites = Sites(designs)
    scales = {(sites[name].noise,): jnp.reshape(0.5 / design.n_obs, 1) for name, design in designs.items()}
    kernel: Any = NUTS(
        model.numpyro_model,
        target_accept_prob=target_accept,
        inverse_mass_matrix=scales,
        regularize_mass_matrix=False,
    )
    with_gamma = model.gibbs_equations(designs)
    if not with_gamma:
        return kernel
    move = gamma_move(model.numpyro_model, designs, with_gamma)
    return HMCGibbs(kernel, gibbs_fn=move, gibbs_sites=[sites[name].gamma for name in with_gamma])
