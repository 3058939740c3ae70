"""What is compiled for a fit, and kept for the next fit of its kind."""

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

PRIOR_DRAWS = 500
"""Draws in the `prior` group."""

SHARED = 4
"""Fits of different kinds or shapes whose compiled programs are kept for the next of the same: some 100 MB each."""


class Programs:
    """What is compiled for a fit. Designs are arguments, so that others of the same shapes are not compiled again."""

    def __init__(self, model: SamplingProgram, tune: int, target_accept: float, *, keep: bool = False) -> None:
        """Compile nothing yet.

        Args:
            model: Model.
            tune: Iterations of warm-up.
            target_accept: Target acceptance probability of NUTS.
            keep: Whether these three are all that the programs depend on beside designs, so that traces can be kept.
        """
        identity = (model, tune, target_accept) if keep else None
        self.chains = Sampler(lambda designs: posterior_kernel(model, designs, target_accept), tune, identity)
        self.conditional = conditional_sampler(model.numpyro_model, model if keep else None)
        self.prior = prior_sampler(model.numpyro_model, PRIOR_DRAWS, model if keep else None)
        self.log_prior = log_prior(model.numpyro_model, model if keep else None)


def programs_for(model: SamplingProgram, designs: Mapping[str, Design], sampling: Sampling) -> Programs:
    """Programs for designs of these shapes: those of an earlier fit whose priors were equal, if there was one.

    Args:
        model: Model.
        designs: Its argument.
        sampling: Settings of the run.
    """
    bare, tune, accept = model.bare, sampling.tune, sampling.target_accept
    if type(bare.prior) not in PRIORS.values():
        # What a prior of the user's own reads may have changed since, whatever it says of being equal.
        return Programs(bare, tune, accept)
    leaves, tree = jax.tree.flatten(designs)
    return _shared(bare, tune, accept, tree, tuple(map(jax.typeof, leaves)))


@lru_cache(SHARED)
def _shared(bare: Bare, tune: int, target_accept: float, tree: Any, shapes: tuple) -> Programs:
    return Programs(bare, tune, target_accept, keep=True)
