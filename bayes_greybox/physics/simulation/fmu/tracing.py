"""Calls from JAX to an FMU: one traced function for all simulations that give the same."""

from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from bayes_greybox.physics.simulation.code import flat


class Rates:
    """Rates of an `FMUSimulation`, or one of its outputs: equal to those of another that gives the same."""

    def __init__(self, simulation: Any, output: str | None = None) -> None:
        self.simulation, self.output = simulation, output

    def __hash__(self) -> int:
        return hash((self.simulation.facts, self.output))

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Rates) and self.output == other.output and self.simulation.facts == other.simulation.facts
        )


@lru_cache(maxsize=64)
def traced(of: Rates) -> Any:
    """Return a function of one point that JAX may trace: values by a call to the FMU, derivatives by differences."""
    simulation, output = of.simulation, of.output

    # JAX calls these with arrays of its own.
    def slopes(*point: Any) -> np.ndarray:
        t, x, u = map(np.asarray, point)
        differences = simulation.differences(*flat(t, x, u), output=output)
        return differences.reshape(*(x.shape if output is None else t.shape), differences.shape[-1])

    def values(*point: Any) -> np.ndarray:
        t, x, u = map(np.asarray, point)
        return simulation._rates(t, x, u) if output is None else simulation.values_of(output, t, x, u)

    def shape(x: Array, *more: int) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct((*(x.shape if output is None else x.shape[:-1]), *more), x.dtype)

    @jax.custom_jvp
    def rate(t: Array, x: Array, u: Array) -> Array:
        return jax.pure_callback(values, shape(x), t, x, u, vmap_method="broadcast_all")

    @rate.defjvp
    def _(point: tuple[Array, ...], along: tuple[Array, ...]) -> tuple[Array, Array]:
        t, x, u = point
        J = jax.pure_callback(slopes, shape(x, 1 + x.shape[-1] + u.shape[-1]), t, x, u, vmap_method="broadcast_all")
        return rate(t, x, u), J @ jnp.concatenate([jnp.atleast_1d(along[0]), *along[1:]])

    return rate
