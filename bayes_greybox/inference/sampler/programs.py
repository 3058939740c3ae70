"""Compiled programs of a fit, which the next fit of the same kind uses again."""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import jax

from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.design import Design
from bayes_greybox.model.priors import PRIORS
from bayes_greybox.model.sampling_program import Bare, SamplingProgram

from .draws import conditional_sampler
from .kernel import posterior_kernel
from .nuts import Sampler
from .prior import log_prior, prior_sampler

PRIOR_DRAWS, SHARED = 500, 4
"""Draws in the `prior` group; most kinds or shapes of fits whose programs are kept at a time, some 100 MB each."""


class Programs:
    """Compiled programs of a fit. Designs are arguments, so that others of the same shapes need no compilation."""

    def __init__(self, model: SamplingProgram, tune: int, target_accept: float, *, keep: bool = False) -> None:
        """Compile nothing yet; `keep` traces if the programs depend on nothing else but the designs."""
        identity = (model, tune, target_accept) if keep else None
        self.chains = Sampler(lambda designs: posterior_kernel(model, designs, target_accept), tune, identity)
        self.conditional = conditional_sampler(model.numpyro_model, model if keep else None)
        self.prior = prior_sampler(model.numpyro_model, PRIOR_DRAWS, model if keep else None)
        self.log_prior = log_prior(model.numpyro_model, model if keep else None)


def programs_for(model: SamplingProgram, designs: Mapping[str, Design], sampling: Sampling) -> Programs:
    """Return programs for designs of these shapes, those of an earlier fit with equal priors if there was one."""
    bare, tune, accept = model.bare, sampling.tune, sampling.target_accept
    if type(bare.prior) not in PRIORS.values():
        # A user-defined prior may depend on things that changed since, even if it compares equal.
        return Programs(bare, tune, accept)
    leaves, tree = jax.tree.flatten(designs)
    return _shared(bare, tune, accept, tree, tuple(map(jax.typeof, leaves)))


@lru_cache(SHARED)
def _shared(bare: Bare, tune: int, target_accept: float, tree: Any, shapes: tuple) -> Programs:
    return Programs(bare, tune, target_accept, keep=True)
