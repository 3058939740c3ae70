"""Random sites of the NumPyro program."""

import jax.numpy as jnp
import numpyro
import numpyro.distributions as dist
from jaxtyping import Array


def site(name: str, distribution: dist.Distribution) -> Array:
    """`numpyro.sample` of an array-valued site."""
    return jnp.asarray(numpyro.sample(name, distribution))
