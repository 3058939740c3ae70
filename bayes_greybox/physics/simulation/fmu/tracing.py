"""How JAX calls an FMU: one traced function for all simulations that give the same."""

from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array


class Rates:
    """An FMU's rates, or one of its outputs: equal to another's that gives the same.

    Args:
        simulation: An `FMUSimulation`.
        output: Name of the output; None for rates.
    """

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
    """A function of one point that JAX may trace: values by a call to the FMU, derivatives by differences.

    Args:
        of: What it gives.
    """
    simulation, output = of.simulation, of.output

    # JAX calls these with arrays of its own.
    def slopes(*point: Any) -> np.ndarray:
        t, x, u = map(np.asarray, point)
        found = simulation.differences(*flat(t, x, u), output=output)
        return found.reshape(*(x.shape if output is None else t.shape), found.shape[-1])

    def values(*point: Any) -> np.ndarray:
        t, x, u = map(np.asarray, point)
        return simulation.rates(t, x, u) if output is None else simulation.values_of(output, t, x, u)

    @jax.custom_jvp
    def rate(t: Array, x: Array, u: Array) -> Array:
        shape = jax.ShapeDtypeStruct(x.shape if output is None else x.shape[:-1], x.dtype)
        return jax.pure_callback(values, shape, t, x, u, vmap_method="broadcast_all")

    @rate.defjvp
    def _(point: tuple[Array, ...], along: tuple[Array, ...]) -> tuple[Array, Array]:
        t, x, u = point
        made = x.shape if output is None else x.shape[:-1]
        shape = jax.ShapeDtypeStruct((*made, 1 + x.shape[-1] + u.shape[-1]), x.dtype)
        J = jax.pure_callback(slopes, shape, t, x, u, vmap_method="broadcast_all")
        return rate(t, x, u), J @ jnp.concatenate([jnp.atleast_1d(along[0]), *along[1:]])

    return rate


def flat(t: np.ndarray, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points along one axis."""
    return t.ravel(), x.reshape(-1, x.shape[-1]), u.reshape(t.size, u.shape[-1])
