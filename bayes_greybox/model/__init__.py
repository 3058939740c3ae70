"""The probabilistic program: kernels, features, priors, the collapsed likelihood, GreyBox."""

import jax

# Covariances in single precision are not positive definite.
jax.config.update("jax_enable_x64", True)
