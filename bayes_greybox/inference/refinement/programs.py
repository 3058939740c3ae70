"""Compiled programs that sample exact paths. Data are arguments: others of the same shapes need no compilation."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float
from numpyro.distributions import biject_to
from numpyro.handlers import block, seed, trace
from numpyro.infer import NUTS
from numpyro.infer.util import constrain_fn, potential_energy

from bayes_greybox.inference.sampler.nuts import Sampler
from bayes_greybox.inference.sampler.programs import SHARED
from bayes_greybox.model.design import Design
from bayes_greybox.model.exact_program import ExactLikelihood, GivenTerms, exact_model
from bayes_greybox.model.priors import PRIORS
from bayes_greybox.model.sampling_program import Bare
from bayes_greybox.model.sites import density_model
from bayes_greybox.running.compiling import compiled

PATHS_TOGETHER = 32
"""Draws whose paths are followed together."""


class Argument(NamedTuple):
    """The argument of the compiled model: the design of the rows, for its priors, and the likelihood of the samples."""

    design: Design
    likelihood: ExactLikelihood

    def on(self, grid: Any) -> "Argument":
        """Return the same argument on another grid of the method."""
        along = self.likelihood.along._replace(grid=grid)
        return self._replace(likelihood=replace(self.likelihood, along=along))


@dataclass(frozen=True)
class ProgramKey:
    """Key of compiled programs, beside the shapes of their arguments: priors, included terms and settings of NUTS.

    `block` is the name of the equations that share the rows.
    """

    bare: Bare
    block: str
    terms: GivenTerms
    tune: int
    target_accept: float

    def model(self, argument: Argument) -> Any:
        """Return the NumPyro model."""
        return exact_model(self.bare, self.block, argument.design, self.terms, argument.likelihood)


class ExactPrograms:
    """Compiled programs for arguments of the same shapes as `argument`.

    Coordinates are u, all sites on the real line; the sampler's are η, with u = m + L η.
    """

    def __init__(self, key: ProgramKey, argument: Argument) -> None:
        self._key = key
        shapes = jax.eval_shape(lambda each: {n: jnp.zeros(s) for n, (_, s) in self._sites(each).items()}, argument)
        flat, self._unravel = ravel_pytree({name: np.zeros(each.shape) for name, each in shapes.items()})
        self.size = len(flat)

        # Compiled, so that paths are traced once however often the sampler traces their density.
        @jax.jit
        def log_density(eta: Array, inputs: tuple[Array, Array, Argument]) -> Array:
            center, L, argument = inputs
            # Otherwise the sampler's handlers would see the sites of the model.
            with block():
                return -jnp.asarray(potential_energy(key.model(argument), (), {}, self._unravel(center + L @ eta)))

        kernel = NUTS(density_model(log_density, self.size), target_accept_prob=key.target_accept)
        self.chains = Sampler(lambda _: kernel, key.tune)

        def evaluated(u: Array, argument: Argument) -> dict[str, Array]:
            # No derivatives are needed here.
            paths: Any = argument.likelihood.predict
            argument = argument._replace(likelihood=replace(argument.likelihood, predict=paths.samples))
            return constrain_fn(key.model(argument), (), {}, self._unravel(u), return_deterministic=True)

        self._evaluated = compiled(jax.vmap(evaluated, in_axes=(0, None)))
        self._placed = compiled(self._place, once=True)

    def evaluate(self, points: Float[np.ndarray, "n_draw n"], argument: Argument) -> dict[str, np.ndarray]:
        """Return sites and deterministics at points u on the real line, each [n_draw, ...]."""
        parts = []
        for first in range(0, len(points), PATHS_TOGETHER):
            part = points[first : first + PATHS_TOGETHER]
            filled = np.pad(part, ((0, PATHS_TOGETHER - len(part)), (0, 0)), "edge")
            values = self._evaluated(jnp.asarray(filled), argument)
            parts.append({str(name): np.asarray(value)[: len(part)] for name, value in values.items()})
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def place(self, first: Mapping[str, np.ndarray], argument: Argument) -> Float[np.ndarray, "n_draw n"]:
        """Return draws by site, each [n_draw, ...], as points on the real line; sites without draws are zero."""
        return np.asarray(self._placed({name: jnp.asarray(value) for name, value in first.items()}, argument))

    def _place(self, first: dict[str, Array], argument: Argument) -> Array:
        n_draw = len(next(iter(first.values())))
        real = {
            name: biject_to(fn.support).inv(first[name]) if name in first else jnp.zeros((n_draw, *shape))
            for name, (fn, shape) in self._sites(argument).items()
        }
        return jax.vmap(lambda each: ravel_pytree(each)[0])(real)

    def _sites(self, argument: Argument) -> dict[str, tuple[Any, tuple[int, ...]]]:
        """Return distribution and shape of each latent site."""
        traced = trace(seed(self._key.model(argument), 0)).get_trace()
        return {
            str(name): (site["fn"], np.shape(site["value"]))
            for name, site in traced.items()
            if site["type"] == "sample" and not site["is_observed"]
        }


def exact_programs(key: ProgramKey, argument: Argument) -> ExactPrograms:
    """Return programs for arguments of these shapes, those of an earlier equal key if there was one."""
    if type(key.bare.prior) not in PRIORS.values():
        # As for a fit: a user-defined prior may depend on things that changed since.
        return ExactPrograms(key, argument)
    leaves, tree = jax.tree.flatten(argument)
    return _shared(key, tree, tuple(map(jax.typeof, leaves)))


@lru_cache(SHARED)
def _shared(key: ProgramKey, tree: Any, shapes: tuple) -> ExactPrograms:
    argument = jax.tree.unflatten(tree, [jnp.asarray(np.zeros(each.shape, each.dtype)) for each in shapes])
    return ExactPrograms(key, argument)
