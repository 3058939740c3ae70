"""Known physics: expressions, terms and dictionaries, units, simulated systems, integration in time."""

import jax

# This room is the first that uses JAX and everything downstream passes through it: 64-bit from here on.
jax.config.update("jax_enable_x64", True)
