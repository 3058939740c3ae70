"""The probabilistic program: simulation + sparse dictionary + orthogonal discrepancy, as a NumPyro model."""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import jax.numpy as jnp
import numpyro
import numpyro.distributions as dist
from numpyro.handlers import scope, seed, trace

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.terms import Dictionary
from bayes_greybox.physics.units import check_units

from .assemble import Equation, assemble
from .discrepancy import OrthogonalGP
from .likelihood import CollapsedNormal, Design, FeatureDesign, Hyperparameters
from .priors import Prior, SpikeAndSlab
from .simulation import RightHandSide, Simulation
from .sites import site

RESERVED = ("theta", "theta_sd", "prior_sd", "gamma", "inclusion", "weight", "f")
"""What is drawn exactly given the sites of the model; no site of a user's own prior can be called so."""


@dataclass(frozen=True)
class Program:
    """ẋ_i = g_i(x, u) + Φ_i(x, u)ᵀ θ_i + f_i(x, u) + ε, ε ~ N(0, σ² R), for each learned state i.

    Attributes:
        dictionary: Candidate terms by learned state: strings, `Term`s, `polynomial(...)`, or a mix.
        simulation: The known part: expressions by state, or a callable (t, x, u) -> dx/dt; None: zero.
        prior: Prior on θ.
        discrepancy: The Gaussian process f, or None to leave it out.
        noise_floor: Least σ over the RMS of the target. The data's own rounding is added to it in quadrature;
            it keeps the likelihood of noise-free data finite.
        noise: Prior scale of σ over the RMS of the target: σ² = floor² + s², s ~ HalfNormal(`noise`).
    """

    dictionary: Mapping[str, Any] = field(default_factory=dict)
    simulation: Mapping[str, str] | RightHandSide | None = None
    prior: Prior = field(default_factory=SpikeAndSlab)
    discrepancy: OrthogonalGP | None = field(default_factory=OrthogonalGP)
    noise_floor: float = 1e-4
    noise: float = 1.0

    def __post_init__(self) -> None:
        if not isinstance(self.dictionary, Mapping):
            raise InputError(
                "GreyBox(dictionary=...) must map each learned state to its candidate terms, for example "
                "{'ydot': ['y', 'y**3']}."
            )
        if isinstance(self.prior, type) or not isinstance(self.prior, Prior):
            raise InputError(f"GreyBox(prior={self.prior!r}) is not a prior: give one such as bg.Laplace(scale=0.5).")
        if not (self.discrepancy is None or isinstance(self.discrepancy, OrthogonalGP)):
            raise InputError(
                f"GreyBox(discrepancy={self.discrepancy!r}) must be bg.OrthogonalGP(...), or None to leave f out."
            )
        if not 1e-7 <= self.noise_floor < 1:
            raise InputError(
                f"GreyBox(noise_floor={self.noise_floor:g}) must lie between 1e-7, where rounding takes over, and 1."
            )
        if not self.noise > 0:
            raise InputError(f"GreyBox(noise={self.noise:g}) must be positive.")

    @property
    def equations(self) -> tuple[str, ...]:
        """Learned states."""
        return tuple(self.dictionary)

    def dictionaries(self, data: Trajectories) -> dict[str, Dictionary]:
        """Parsed dictionaries by learned state, checked against the data's names and units.

        Raises:
            InputError: No dictionary; unknown states, names or units; duplicate terms.
        """
        if not self.dictionary:
            raise InputError(
                "The model has no dictionary, so there is nothing to fit: give GreyBox(dictionary={'ydot': ['y']}) "
                "or look for what the simulation misses with bg.find_missing_effects(model, data)."
            )
        for equation in self.equations:
            if equation not in data.state_names:
                near = difflib.get_close_matches(equation, data.state_names, n=1)
                hint = f" (did you mean {near[0]!r}?)" if near else ""
                raise InputError(
                    f"The dictionary has an equation for {equation!r}, which is not a state of the "
                    f"data{hint}; states: {', '.join(data.state_names)}."
                )
        names = (*data.state_names, *data.input_names)
        parsed = {equation: Dictionary.of(terms, names) for equation, terms in self.dictionary.items()}
        terms = {equation: dictionary.terms for equation, dictionary in parsed.items()}
        check_units(terms, data.units, data.derivative_names, data.time_name)
        return parsed

    def assemble(self, data: Trajectories) -> dict[str, Equation]:
        """Read the data into frames and designs by equation: all the work that grows with the rows.

        Raises:
            InputError: See `dictionaries`, `Simulation.of` and `assemble.assemble`; a derivative that is
                missing.
        """
        dictionaries = self.dictionaries(data)
        simulation = Simulation.of(self.simulation, data.state_names, data.input_names)
        return {
            equation: assemble(
                data,
                equation,
                dictionary,
                measured_rate(data, equation) - simulation.on(data, equation),
                self.discrepancy,
                self.noise_floor,
            )
            for equation, dictionary in dictionaries.items()
        }

    def designs(self, data: Trajectories) -> dict[str, Design]:
        """The argument of `numpyro_model`: one design per equation."""
        return {name: equation.design for name, equation in self.assemble(data).items()}

    def numpyro_model(self, designs: Mapping[str, Design], observed: bool = True) -> None:
        """The collapsed model, a plain NumPyro program: θ and f are integrated out of the likelihood.

        Sites carry the equation as a prefix: `ydot_noise`, `ydot_amplitude`, `ydot_length_scale`, those of
        the prior (`ydot_tau`, ...), and the target `ydot_y`.

        Args:
            designs: From `designs(data)`.
            observed: Whether to condition on the target; False for prior predictive draws.
        """
        for equation, design in designs.items():
            with scope(prefix=equation, divider="_"):
                hyper = self._hyperparameters(design)
                scales = self.prior.scales(design.Phi.shape[1], design.n_prior, hyper.sigma)
                numpyro.sample("y", CollapsedNormal(design, hyper, scales), obs=design.y if observed else None)

    def gibbs_equations(self, designs: Mapping[str, Design]) -> tuple[str, ...]:
        """Equations whose inclusion pattern is a site of the model, to be updated by Gibbs moves.

        Raises:
            InputError: A prior of the user's own has a site that is called as something else is in the results.
        """
        sites = trace(seed(self.numpyro_model, 0)).get_trace(designs)
        if isinstance(self.prior, SpikeAndSlab):
            return tuple(name for name in designs if f"{name}_gamma" in sites)
        for taken in (name for equation in designs for name in RESERVED if f"{equation}_{name}" in sites):
            raise InputError(f"The prior has a site called {taken!r}, which the results need: give it another name.")
        return ()

    def uncollapsed_model(self, designs: Mapping[str, Design]) -> None:
        """The same model with θ and the weights of f as sites: the reference for tests.

        It is what one would write by hand. Feature path only; a spike-and-slab prior has no such density (its
        θ are exactly zero).
        """
        for equation, design in designs.items():
            if not isinstance(design, FeatureDesign):
                raise InputError("uncollapsed_model needs OrthogonalGP(path='hsgp').")
            with scope(prefix=equation, divider="_"):
                hyper = self._hyperparameters(design)
                scales = self.prior.scales(design.Phi.shape[1], design.n_prior, hyper.sigma)
                if isinstance(self.prior, SpikeAndSlab):
                    raise InputError("uncollapsed_model has no density for a spike-and-slab prior: use another prior.")
                theta = numpyro.sample("theta", dist.Normal(0.0, scales.sd).to_event(1))
                z = jnp.asarray(numpyro.sample("z", dist.Normal(0.0, 1.0).expand(design.Psi.shape[1:]).to_event(1)))
                weight = design.weights(z, hyper)
                numpyro.deterministic("weight", weight)
                mean = design.Phi @ theta + design.Psi @ weight
                # Rows folded away by compression carry no signal: their share of the density is σ's alone.
                hidden = design.n_obs - design.y.size
                numpyro.factor("hidden", -hidden * (jnp.log(hyper.sigma) + 0.5 * jnp.log(2 * jnp.pi)))
                numpyro.sample("y", dist.Normal(mean, hyper.sigma).to_event(1), obs=design.y)

    def _hyperparameters(self, design: Design) -> Hyperparameters:
        noise = jnp.asarray(numpyro.sample("noise", dist.HalfNormal(self.noise)))
        # σ² = floor² + s²
        sigma = jnp.asarray(numpyro.deterministic("sigma", jnp.sqrt(design.noise_floor**2 + noise**2)))
        gp = self.discrepancy
        if gp is None:
            return Hyperparameters(sigma, jnp.ones(()), jnp.ones(0))
        n_var = design.frequency.shape[1] if isinstance(design, FeatureDesign) else design.points[0].shape[1]
        amplitude = jnp.asarray(numpyro.sample("amplitude", dist.HalfNormal(gp.amplitude)))
        prior = dist.LogNormal(jnp.log(gp.length_scale), gp.length_scale_spread).expand([n_var]).to_event(1)
        return Hyperparameters(sigma, amplitude, jnp.asarray(site("length_scale", prior)))


def measured_rate(data: Trajectories, equation: str) -> Any:
    """The measured derivative of a state.

    Raises:
        InputError: If the data have none.
    """
    if equation not in data.derivatives:
        raise InputError(
            f"The data have no derivative of {equation!r}: give it with derivatives={{{equation!r}: ...}}, "
            f"or compute it with data.differentiate()."
        )
    return data.derivatives[equation]
