"""Any log density as a NumPyro model, for samplers that want one."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpyro
import numpyro.distributions as dist
from jaxtyping import Array

SITE = "eta"
"""The model's only site."""


def density_model(log_density: Callable[[Array, Any], Array], size: int) -> Callable[[Any], None]:
    """A model of one real vector whose log density, up to a constant, is the given function.

    Args:
        log_density: Of the vector and of the model's argument.
        size: Length of the vector.
    """

    def model(argument: Any) -> None:
        eta = jnp.asarray(numpyro.sample(SITE, dist.ImproperUniform(dist.constraints.real_vector, (), (size,))))
        numpyro.factor("log_density", log_density(eta, argument))

    return model
