"""The NumPyro program of designs: the sampled sites, and the quantities that follow from them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jaxtyping import Float
from numpyro.handlers import scope, seed, substitute, trace

from bayes_greybox.running.arrays import on_device
from bayes_greybox.running.compiling import compiled
from bayes_greybox.running.errors import InputError

from .design import Design
from .gp.discrepancy import OrthogonalGP
from .gp.hyper import Hyperparameters, HyperPrior, NoisePrior
from .likelihood import CollapsedNormal
from .noise.asked import Noise
from .priors import Prior, Scales
from .sites import DRAWN, LABELS, Sites, site


class SamplingProgram:
    """y ~ N(Φθ + f, σ² R) for each equation, by its design; see `Program` for the attributes."""

    prior: Prior
    discrepancy: OrthogonalGP | None
    noise: float | Noise

    @property
    def bare(self) -> "Bare":
        """The program by itself, without the dictionary, the simulation and the rows that designs are made of."""
        gp = self.discrepancy
        # Of f only what its hyperparameters are drawn from: the rest is in the designs.
        drawn = gp and OrthogonalGP(
            amplitude=gp.amplitude, length_scale=gp.length_scale, length_scale_spread=gp.length_scale_spread
        )
        return Bare(self.prior, drawn, self._noise_scale)

    def numpyro_model(self, designs: Mapping[str, Design], observed: bool = True) -> None:
        """Run the collapsed model, a plain NumPyro program: θ and f are integrated out of the likelihood.

        Sites carry the equation as a prefix: `ydot_noise`, `ydot_amplitude`, `ydot_length_scale`, those of
        the prior (`ydot_tau`, ...), and the target `ydot_y`.

        Args:
            designs: Designs from `designs(data)`.
            observed: If true, condition on the target; else draw from the prior predictive distribution.
        """
        for equation, design in designs.items():
            with scope(prefix=equation, divider="_"):
                hyper, scales = self._sample(design)
                numpyro.sample("y", CollapsedNormal(design, hyper, scales), obs=design.y if observed else None)

    def gibbs_equations(self, designs: Mapping[str, Design]) -> tuple[str, ...]:
        """Return the equations whose inclusion pattern is a site of the model, to be updated by Gibbs moves."""
        sites = self.require_own_sites(designs)
        sampled = tuple(name for name in designs if "gamma" in sites[name])
        for name in sampled:
            if designs[name].coefficients.stated:
                raise InputError(
                    f"The equation of {name!r} has too many terms for a sum over their inclusion patterns, and the "
                    "Gibbs moves on them know no priors of single coefficients: raise "
                    "SpikeAndSlab(enumerate_up_to=...), take another prior, such as bg.RegularisedHorseshoe(), leave "
                    "terms out, or fix coefficients."
                )
        return sampled

    def require_own_sites(self, designs: Mapping[str, Design]) -> dict[str, dict[str, str]]:
        """Return the sites of each equation by quantity, none of which may have the name of something in results."""
        names, by_equation = Sites(designs), {}
        # Priors of the user's own need not say that they sample no patterns.
        drawn = () if getattr(self.prior, "samples_patterns", False) else DRAWN
        for equation, design in designs.items():
            traced = [str(name) for name in trace(seed(self.numpyro_model, 0)).get_trace({equation: design})]
            by_equation[equation] = names.owned(equation, traced)
            strange = [name for name in traced if name not in by_equation[equation].values()]
            if strange:
                raise InputError(
                    f"The prior has a site that is called {strange[0]!r} in the equation of {equation!r}, as if it "
                    "were one of another equation: give it another name."
                )
            for taken in (name for name in (*LABELS, *drawn) if name in by_equation[equation]):
                raise InputError(
                    f"The prior has a site called {taken!r}, which the results need: give it another name."
                )
        return by_equation

    def hyper_prior(self, floor: Any, n_var: int) -> HyperPrior:
        """Return the prior of η of an equation with a least σ, scaled units."""
        noise, gp = NoisePrior(floor, self._noise_scale), self.discrepancy
        if gp is None:
            return HyperPrior(noise)
        return HyperPrior(noise, gp.amplitude, gp.length_scale, gp.length_scale_spread, n_var)

    def scales(self, design: Design, sigma: Any) -> Scales:
        """Sample the scales of all terms: those of the prior, and those that are stated; σ in scaled units."""
        n_shared = len(design.coefficients.shared)
        shared = self.prior.scales(n_shared, design.n_prior, sigma) if n_shared else None
        return design.coefficients.complete(shared)

    def slab(self, design: Design, values: Mapping[str, Any], sigma: Float[np.ndarray, " n_draw"]) -> Scales | None:
        """Return scales and odds of θ at given draws; None where the prior leaves no inclusion patterns to be summed.

        Draws of the prior's sites are by quantity, each [n_draw, ...], those of σ in scaled units.
        """

        def program(sigma: Any) -> Scales:
            return self.scales(design, sigma)

        with seed(rng_seed=0), trace() as sites:
            # Whether there are odds, and of what: for that nothing needs to be computed.
            if jax.eval_shape(program, 1.0).log_odds is None:
                return None
        drawn = [str(name) for name, site in sites.items() if site["type"] == "sample" and not site["is_observed"]]
        missing = [name for name in drawn if name not in values]
        if missing:
            raise InputError(
                f"The prior's odds of inclusion cannot be told from these draws, which have no {missing[0]!r}: give "
                "that site of the prior another name and fit again."
            )

        def one(item: tuple[dict[str, Any], Any]) -> tuple[Any, Any]:
            with seed(rng_seed=0), substitute(data=item[0]):
                scales = program(item[1])
            return scales.sd, jnp.broadcast_to(jnp.asarray(scales.log_odds), scales.sd.shape)

        # One program: step by step it would be one for each operation.
        sd, odds = compiled(jax.vmap(one), once=True)(({name: values[name] for name in drawn}, np.asarray(sigma)))
        return Scales(sd, odds, on_device(np.broadcast_to(design.coefficients.mean, sd.shape)))

    @property
    def _noise_scale(self) -> float:
        return self.noise.scale if isinstance(self.noise, Noise) else self.noise

    def _sample(self, design: Design) -> tuple[Hyperparameters, Scales]:
        """Sample η and the prior scales of one equation."""
        hyper = self.hyper_prior(design.noise_floor, design.n_var).sample()
        scales, n_bounded = self.scales(design, hyper.sigma), len(design.coefficients.bounded)
        if n_bounded:
            uniform = site("placement", dist.Uniform(0.0, 1.0).expand([n_bounded]).to_event(1))
            scales = scales._replace(uniform=uniform)
        return hyper, scales


@dataclass(frozen=True)
class Bare(SamplingProgram):
    """The part of a model that programs are compiled for, which models with the same share, given equal shapes."""

    prior: Prior
    discrepancy: OrthogonalGP | None
    noise: float | Noise
