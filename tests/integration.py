"""One run put together from the pieces that free runs are integrated in."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from bayes_greybox.physics.integration.adaptive_steps import StepSettings, cut, follow_piece, joined, limits_of


class Path(NamedTuple):
    """States at the requested times, NaN after a failure; and the time of that, NaN if the run reached its end."""

    states: jax.Array
    failed_at: jax.Array


def integrate(rhs, t, x0, inputs=None, args=None, *, scale=None, interpolation="linear", **options):
    """Integrate from x0 at t[0]; the states' sizes are those of the start unless they are given."""
    inputs = np.zeros((len(t), 0)) if inputs is None else inputs
    samples, kinds = cut(np.asarray(t, dtype=float), inputs, interpolation)
    return _followed(rhs, jnp.asarray(t), jnp.asarray(x0), samples, args, scale, kinds, tuple(options.items()))


@partial(jax.jit, static_argnames=("rhs", "kinds", "options"))
def _followed(rhs, t, x0, samples, args, scale, kinds, options):
    largest = jnp.max(jnp.abs(x0))
    own = jnp.where(largest > 0.0, jnp.maximum(jnp.abs(x0), 1e-3 * largest), 1.0)
    limits = limits_of(t, x0, own if scale is None else scale)

    def follow(start, piece):
        return follow_piece(rhs, start, piece, limits, args, kinds, StepSettings(**dict(options)))

    _, found = jax.lax.scan(follow, (x0, jnp.asarray(True)), samples)
    return Path(*joined(x0, t, *found[:2]))
