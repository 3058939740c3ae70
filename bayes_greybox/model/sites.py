"""Random sites of the NumPyro program, and the one place where the variables of an equation get their names."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpyro
import numpyro.distributions as dist
from jaxtyping import Array

DRAWN = ("theta", "theta_sd", "prior_sd", "gamma", "inclusion", "weight", "f")
"""Quantities that are drawn exactly given the sites of the model; no site of a user's prior may have their names."""

LABELS = ("term", "variable", "basis")
"""Coordinates of results: a site of a user's own prior with one of these names would vanish beside them."""

VECTOR = "eta"
"""The only site of a `density_model`."""


def site(name: str, distribution: dist.Distribution) -> Array:
    """Sample an array-valued site with `numpyro.sample`."""
    return jnp.asarray(numpyro.sample(name, distribution))


def density_model(log_density: Callable[[Array, Any], Array], size: int) -> Callable[[Any], None]:
    """Return a model of one real vector whose log density, up to a constant, is the given function."""

    def model(argument: Any) -> None:
        eta = site(VECTOR, dist.ImproperUniform(dist.constraints.real_vector, (), (size,)))
        numpyro.factor("log_density", log_density(eta, argument))

    return model


class _Name:
    """A variable of an equation, by the name of the attribute."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.quantity = name

    def __get__(self, sites: "EquationSites", owner: type) -> str:
        return sites[self.quantity]


@dataclass(frozen=True)
class EquationSites:
    """Names of one equation's variables in the model and in results: `sites["ydot"].tau` is "ydot_tau".

    A quantity of another name, such as a site of a user's own prior, is `sites["ydot"]["its_name"]`. The observed site
    is `y`; `noise` is s, by which σ is sampled, `tau_unit` the same of the horseshoe's τ, `inclusion` P(γ = 1 | η),
    `theta_sd` has the prior standard deviations of θ as drawn (`prior_sd` in results), and `placement` the numbers that
    place coefficients with bounds.
    """

    equation: str
    y, rate, noise, sigma, amplitude, length_scale = (_Name() for _ in range(6))
    tau, tau_unit, pi, gamma, inclusion, log_odds = (_Name() for _ in range(6))
    theta, theta_sd, prior_sd, weight, f, placement = (_Name() for _ in range(6))

    def __getitem__(self, quantity: str) -> str:
        # As numpyro.handlers.scope(prefix=equation, divider="_") names them.
        return f"{self.equation}_{quantity}"

    @property
    def raw(self) -> tuple[str, str, str]:
        """Coordinates of the sampler that follow from σ, τ and θ."""
        return self.noise, self.tau_unit, self.placement


PACKAGE_QUANTITIES = frozenset(
    ("v", "lambda", "slab", *(name for name, each in vars(EquationSites).items() if isinstance(each, _Name)))
)
"""Quantities that the package itself names."""


class Sites(dict[str, EquationSites]):
    """Names of the variables of several equations, and the equation that a variable belongs to."""

    def __init__(self, equations: Iterable[str]) -> None:
        super().__init__((name, EquationSites(name)) for name in equations)

    def owner(self, variable: str) -> str | None:
        """Return the equation that a variable belongs to.

        Of `y` and `y_dot`, `y_dot_tau` belongs to the longer name, unless what follows the shorter one is a quantity of
        the package: `y_length_scale` is of `y`, also beside `y_length`. `require_own_sites` holds models to it.
        """
        fitting = sorted((name for name in self if variable.startswith(self[name][""])), key=len, reverse=True)
        exact = [name for name in fitting if variable.removeprefix(self[name][""]) in PACKAGE_QUANTITIES]
        return next(iter((*exact, *fitting)), None)

    def owned(self, equation: str, variables: Iterable[str]) -> dict[str, str]:
        """Return the variables of an equation, by quantity: {"tau": "ydot_tau", ...}."""
        owned = [name for name in variables if self.owner(name) == equation]
        return {name.removeprefix(self[equation][""]): name for name in owned}
