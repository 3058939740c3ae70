"""What is compiled to sample exact paths. Data are arguments, so that others of the same shapes compile nothing."""

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

TOGETHER = 32
"""Draws whose paths are followed together."""


class Known(NamedTuple):
    """The argument of the compiled model.

    Attributes:
        design: Of the rows, for its priors.
        likelihood: Of the samples.
    """

    design: Design
    likelihood: ExactLikelihood

    def on(self, grid: Any) -> "Known":
        """The same on another grid of the method."""
        along = self.likelihood.along._replace(grid=grid)
        return self._replace(likelihood=replace(self.likelihood, along=along))


@dataclass(frozen=True)
class Asked:
    """What programs are compiled for, beside the shapes of their arguments.

    Attributes:
        bare: Priors.
        block: What the equations are called that share the rows.
        terms: That are in.
        tune: Warm-up iterations.
        target_accept: Target acceptance probability of NUTS.
    """

    bare: Bare
    block: str
    terms: GivenTerms
    tune: int
    target_accept: float

    def model(self, known: Known) -> Any:
        """The NumPyro model."""
        return exact_model(self.bare, self.block, known.design, self.terms, known.likelihood)


class ExactPrograms:
    """Compiled programs of one question; arguments may be others of the same shapes.

    Coordinates are u, all sites on the real line, and of the sampler η, u = m + L η.

    Args:
        asked: The question.
        known: An argument, for its shapes.
    """

    def __init__(self, asked: Asked, known: Known) -> None:
        self._asked = asked
        shapes = jax.eval_shape(lambda known: {n: jnp.zeros(s) for n, (_, s) in self._sites(known).items()}, known)
        zeros = {name: np.zeros(each.shape) for name, each in shapes.items()}
        flat, self._unravel = ravel_pytree(zeros)
        self.size = len(flat)

        # Paths are traced once, for all the times that the sampler traces their density.
        @jax.jit
        def log_density(eta: Array, argument: tuple[Array, Array, Known]) -> Array:
            center, L, known = argument
            # The sampler's own handlers would take the sites of the model for theirs.
            with block():
                return -jnp.asarray(potential_energy(asked.model(known), (), {}, self._unravel(center + L @ eta)))

        kernel = NUTS(density_model(log_density, self.size), target_accept_prob=asked.target_accept)
        self.chains = Sampler(lambda _: kernel, asked.tune)

        def told(u: Array, known: Known) -> dict[str, Array]:
            # Nobody differentiates here.
            paths: Any = known.likelihood.predict
            known = known._replace(likelihood=replace(known.likelihood, predict=paths.samples))
            return constrain_fn(asked.model(known), (), {}, self._unravel(u), return_deterministic=True)

        self._told = compiled(jax.vmap(told, in_axes=(0, None)))
        self._placed = compiled(self._place, once=True)

    def tell(self, points: Float[np.ndarray, "n_draw n"], known: Known) -> dict[str, np.ndarray]:
        """Sites and what follows from them at points on the real line, each [n_draw, ...].

        Args:
            points: u.
            known: The argument.
        """
        found = []
        for first in range(0, len(points), TOGETHER):
            part = points[first : first + TOGETHER]
            filled = np.pad(part, ((0, TOGETHER - len(part)), (0, 0)), "edge")
            found.append(
                {str(k): np.asarray(v)[: len(part)] for k, v in self._told(jnp.asarray(filled), known).items()}
            )
        return {name: np.concatenate([part[name] for part in found]) for name in found[0]}

    def place(self, first: Mapping[str, np.ndarray], known: Known) -> Float[np.ndarray, "n_draw n"]:
        """Draws on the real line; sites that have none are zero.

        Args:
            first: Draws by site, each [n_draw, ...].
            known: The argument.
        """
        return np.asarray(self._placed({name: jnp.asarray(value) for name, value in first.items()}, known))

    def _place(self, first: dict[str, Array], known: Known) -> Array:
        n_draw = len(next(iter(first.values())))
        real = {}
        for name, (fn, shape) in self._sites(known).items():
            real[name] = jnp.zeros((n_draw, *shape))
            if name in first:
                real[name] = biject_to(fn.support).inv(jnp.asarray(first[name]))
        return jax.vmap(lambda each: ravel_pytree(each)[0])(real)

    def _sites(self, known: Known) -> dict[str, tuple[Any, tuple[int, ...]]]:
        """Distribution of each latent site, and its shape."""
        traced = trace(seed(self._asked.model(known), 0)).get_trace()
        return {
            str(name): (site["fn"], np.shape(site["value"]))
            for name, site in traced.items()
            if site["type"] == "sample" and not site["is_observed"]
        }


def exact_programs(asked: Asked, known: Known) -> ExactPrograms:
    """Programs for arguments of these shapes: those of an earlier question that was equal, if there was one.

    Args:
        asked: The question.
        known: The argument.
    """
    if type(asked.bare.prior) not in PRIORS.values():
        # As for a fit: what a prior of the user's own reads may have changed since.
        return ExactPrograms(asked, known)
    leaves, tree = jax.tree.flatten(known)
    return _shared(asked, tree, tuple(map(jax.typeof, leaves)))


@lru_cache(SHARED)
def _shared(asked: Asked, tree: Any, shapes: tuple) -> ExactPrograms:
    known = jax.tree.unflatten(tree, [jnp.asarray(np.zeros(each.shape, each.dtype)) for each in shapes])
    return ExactPrograms(asked, known)
