"""NumPy's arrays on their way to JAX."""

from typing import Any

import jax
import numpy as np


def on_device(values: Any) -> Any:
    """Return a pytree of numbers as arrays of JAX; NumPy's arrays are copied, JAX's stay.

    It is `jnp.asarray`, but newer versions of that compile a program for each shape that they meet; this compiles none.
    """
    # JAX may keep using the memory of an array, and ours may change.
    return jax.device_put(jax.tree.map(lambda each: each if isinstance(each, jax.Array) else np.array(each), values))
