"""Arrays of NumPy's on their way to JAX."""

from typing import Any

import jax
import numpy as np


def on_device(values: Any) -> Any:
    """A pytree of numbers as arrays of JAX's.

    As `jnp.asarray`, which newer versions of JAX have compile a program for each shape that they meet; this compiles
    none.

    Args:
        values: Arrays of NumPy's, which are copied, numbers, or a pytree of such; arrays of JAX's stay.
    """
    # JAX may take the memory of an array as its own, and ours may change.
    return jax.device_put(jax.tree.map(lambda each: each if isinstance(each, jax.Array) else np.array(each), values))
