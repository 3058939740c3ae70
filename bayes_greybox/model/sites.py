"""Random sites of the NumPyro program, and the one place where the variables of an equation get their names."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpyro
import numpyro.distributions as dist
from jaxtyping import Array

DRAWN = ("theta", "theta_sd", "prior_sd", "gamma", "inclusion", "weight", "f")
"""What is drawn exactly given the sites of the model; no site of a user's own prior can be called so."""

LABELS = ("term", "variable", "basis")
"""Coordinates of results: a site of a user's own prior that is called so would vanish beside them."""


QUANTITIES = frozenset(
    (*DRAWN, "y", "rate", "noise", "sigma", "amplitude", "length_scale", "pi", "tau", "tau_unit", "log_odds")
    + ("v", "lambda", "slab", "placement")
)
"""Quantities that the package itself names."""

VECTOR = "eta"
"""The only site of a `density_model`."""


def site(name: str, distribution: dist.Distribution) -> Array:
    """`numpyro.sample` of an array-valued site."""
    return jnp.asarray(numpyro.sample(name, distribution))


def density_model(log_density: Callable[[Array, Any], Array], size: int) -> Callable[[Any], None]:
    """A model of one real vector whose log density, up to a constant, is the given function.

    Args:
        log_density: Of the vector and of the model's argument.
        size: Length of the vector.
    """

    def model(argument: Any) -> None:
        eta = site(VECTOR, dist.ImproperUniform(dist.constraints.real_vector, (), (size,)))
        numpyro.factor("log_density", log_density(eta, argument))

    return model


@dataclass(frozen=True)
class EquationSites:
    """Names of one equation's variables in the model and in results: `sites["ydot"].tau` is "ydot_tau".

    A quantity of another name, such as a site of a user's own prior, is `sites["ydot"]["its_name"]`.

    Attributes:
        equation: The learned state.
    """

    equation: str

    def __getitem__(self, quantity: str) -> str:
        # As numpyro.handlers.scope(prefix=equation, divider="_") names them.
        return f"{self.equation}_{quantity}"

    @property
    def y(self) -> str:
        """The target, the observed site."""
        return self["y"]

    @property
    def rate(self) -> str:
        """The measured rate, user's units."""
        return self["rate"]

    @property
    def noise(self) -> str:
        """s, the coordinate that σ is sampled by."""
        return self["noise"]

    @property
    def sigma(self) -> str:
        """Noise standard deviation."""
        return self["sigma"]

    @property
    def amplitude(self) -> str:
        """Standard deviation of f."""
        return self["amplitude"]

    @property
    def length_scale(self) -> str:
        """Length scales of f."""
        return self["length_scale"]

    @property
    def tau(self) -> str:
        """Scale of the coefficients, or of the slab."""
        return self["tau"]

    @property
    def tau_unit(self) -> str:
        """The coordinate that the horseshoe's global scale is sampled by."""
        return self["tau_unit"]

    @property
    def pi(self) -> str:
        """Inclusion probability a priori."""
        return self["pi"]

    @property
    def gamma(self) -> str:
        """Inclusion pattern."""
        return self["gamma"]

    @property
    def inclusion(self) -> str:
        """P(γ = 1) given the hyperparameters."""
        return self["inclusion"]

    @property
    def theta(self) -> str:
        """Coefficients."""
        return self["theta"]

    @property
    def theta_sd(self) -> str:
        """Prior standard deviations of the coefficients, scaled units, as they are drawn."""
        return self["theta_sd"]

    @property
    def prior_sd(self) -> str:
        """The same in results."""
        return self["prior_sd"]

    @property
    def log_odds(self) -> str:
        """Log prior odds of inclusion where the sampler sums over the patterns."""
        return self["log_odds"]

    @property
    def weight(self) -> str:
        """Weights of the features of f."""
        return self["weight"]

    @property
    def f(self) -> str:
        """Values of f at the rows."""
        return self["f"]

    @property
    def placement(self) -> str:
        """Numbers that place the coefficients with bounds."""
        return self["placement"]

    @property
    def raw(self) -> tuple[str, str, str]:
        """Coordinates of the sampler that another quantity tells: s by σ, the horseshoe's by τ, bounded ones by θ."""
        return self.noise, self.tau_unit, self.placement


class Sites(Mapping[str, EquationSites]):
    """Names of the variables of several equations, and whose a variable is.

    Args:
        equations: Learned states.
    """

    def __init__(self, equations: Iterable[str]) -> None:
        """Name nothing yet."""
        self._equations = {name: EquationSites(name) for name in equations}

    def __getitem__(self, equation: str) -> EquationSites:
        return self._equations[equation]

    def __iter__(self) -> Iterator[str]:
        return iter(self._equations)

    def __len__(self) -> int:
        return len(self._equations)

    def owner(self, variable: str) -> str | None:
        """The equation that a variable belongs to.

        Of two equations `y` and `y_dot` the variable `y_dot_tau` belongs to the one with the longer name, unless what
        follows the shorter one is a quantity of the package: `y_length_scale` is of `y`, also beside `y_length`. A
        model whose sites would break this rule is refused (see `SamplingProgram.require_own_sites`).
        """
        fitting = sorted((name for name in self if variable.startswith(self[name][""])), key=len, reverse=True)
        exact = [name for name in fitting if variable.removeprefix(self[name][""]) in QUANTITIES]
        return next(iter((*exact, *fitting)), None)

    def owned(self, equation: str, variables: Iterable[str]) -> dict[str, str]:
        """Those variables that belong to an equation, by quantity: {"tau": "ydot_tau", ...}.

        Args:
            equation: One of the equations.
            variables: Names of sites or results.
        """
        own = [name for name in variables if self.owner(name) == equation]
        return {name.removeprefix(self[equation][""]): name for name in own}
