"""What the rest of the package asks of a simulation; expressions and callables answer it, each in its way."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import sympy
from jaxtyping import Array, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.formula.derivatives import gradient
from bayes_greybox.physics.formula.expressions import evaluate
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

RightHandSide = Callable[[Array, Array, Array], Array]
"""(t, x [n_state], u [n_input]) -> dx/dt [n_state]."""


@dataclass(frozen=True)
class Simulation(ABC):
    """g(x, u), the known rates of the states, and what is known of outputs.

    Attributes:
        states: State names, in the order of x.
        inputs: Input names, in the order of u.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]

    @property
    def differentiable(self) -> bool:
        """Whether an integrated path has exact derivatives by its start and coefficients, as NUTS needs them."""
        return True

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was found of the simulation since it was used, and its user has to know; sentences."""
        return ()

    @property
    def code(self) -> str:
        """What it is in words if it is code, which no formula says; "" of formulas."""
        return ""

    @property
    @abstractmethod
    def equations(self) -> tuple[str, ...]:
        """States whose rate the simulation gives, that of the others is zero; and outputs that it gives."""

    @abstractmethod
    def rate(self, t: Array, x: Float[Array, " n_state"], u: Float[Array, " n_input"]) -> Float[Array, " n_state"]:
        """Value of g at one point, inside an integrator."""

    @abstractmethod
    def on(self, data: Trajectories, state: str) -> Float[np.ndarray, " n_obs"]:
        """Values of g for one state or output on the rows of the data, user's units.

        Raises:
            InputError: A simulation that fails, that is not finite, or that returns the wrong number of rates; an
                output of a function.
        """

    @abstractmethod
    def rates(
        self, t: Float[np.ndarray, "*n"], x: Float[np.ndarray, "*n n_state"], u: Float[np.ndarray, "*n n_input"]
    ) -> Float[np.ndarray, "*n n_state"]:
        """Values of g at many points."""

    @abstractmethod
    def jacobian(
        self, t: Float[np.ndarray, "*n"], x: Float[np.ndarray, "*n n_state"], u: Float[np.ndarray, "*n n_input"]
    ) -> Float[np.ndarray, "*n n_state n_state"]:
        """∂g/∂x at points along paths, neighbours along the last axis of t."""

    def output(self, name: str, t: Array | np.ndarray, x: Array | np.ndarray, u: Array | np.ndarray) -> Any:
        """Values of an output at many points along the first axis, by NumPy on its arrays, else by JAX.

        Args:
            name: The output.
            t: Times.
            x: States.
            u: Inputs.
        """
        columns = dict(zip((*self.states, *self.inputs), (*x.T, *u.T), strict=True))
        return evaluate(self.formula(name), columns)

    @abstractmethod
    def formula(self, name: str) -> sympy.Expr:
        """What is known of the rate of a state, or of an output, as a formula; code is an undefined function g_name."""

    def own_formula(self, name: str) -> sympy.Expr:
        """The formula without terms beside the simulation (see `beside`)."""
        return self.formula(name)

    @abstractmethod
    def additive_terms(self, state: str) -> list[tuple[Term, float]]:
        """The terms of a state's rate, or of an output, with coefficients; none where the simulation cannot be read."""

    def readable_terms(self, state: str) -> list[tuple[Term, float]]:
        """The terms of `additive_terms`, and those whose coefficients are known besides."""
        return self.additive_terms(state)

    def kinematic(self, state: str) -> bool:
        """Whether the rate of a state is known to be another state, as position and velocity are."""
        return self.rate_name(state) is not None

    @abstractmethod
    def rate_name(self, state: str) -> str | None:
        """The state that is the rate of a state; None where its rate is anything else, or cannot be read."""

    @property
    @abstractmethod
    def key(self) -> Hashable:
        """What two simulations that do the same have in common: programs are compiled once for it."""

    def rounded(self, columns: Mapping[str, Float[np.ndarray, " n"]]) -> "Simulation":
        """The simulation with jumps of its formulas rounded, as an integrator needs them; code as it is.

        Args:
            columns: States and inputs that it is used on.
        """
        return self

    def without_numbers(self) -> tuple["Simulation", tuple[float, ...]]:
        """The simulation with decimal numbers of its formulas as further inputs, and these; code has none."""
        return self, ()

    def beside(self, known: Mapping[str, Sequence[tuple[Term, float]]]) -> "Simulation":
        """The simulation with more terms in its rates, whose coefficients are known.

        Args:
            known: Terms with coefficients by state; a state may have none.
        """
        added = {state: tuple(terms) for state, terms in known.items() if terms}
        return _WithTerms(self.states, self.inputs, self, added) if added else self

    def _columns(self, x: np.ndarray, u: np.ndarray) -> dict[str, np.ndarray]:
        """Values at many points by name."""
        values = (*np.moveaxis(x, -1, 0), *np.moveaxis(u, -1, 0))
        return dict(zip((*self.states, *self.inputs), values, strict=True))


def finite(value: np.ndarray, state: str) -> np.ndarray:
    """Values of a rate that are finite.

    Args:
        value: Values.
        state: Whose rate they are.

    Raises:
        InputError: Some are not.
    """
    if not np.all(np.isfinite(value)):
        raise InputError(f"The simulation of {state!r} is not finite on all the data: check its domain.")
    return value


@dataclass(frozen=True)
class _WithTerms(Simulation):
    """A simulation, and terms beside it whose coefficients are known.

    Attributes:
        given: The simulation.
        known: Terms with coefficients by state or output.
    """

    given: Simulation
    known: Mapping[str, tuple[tuple[Term, float], ...]]

    @property
    def differentiable(self) -> bool:
        """As of the simulation."""
        return self.given.differentiable

    @property
    def warnings(self) -> tuple[str, ...]:
        """Those of the simulation."""
        return self.given.warnings

    @property
    def code(self) -> str:
        """As of the simulation."""
        return self.given.code

    @property
    def _of_states(self) -> list[tuple[int, tuple[tuple[Term, float], ...]]]:
        """Terms that add to rates, by the number of the state."""
        return [(self.states.index(name), terms) for name, terms in self.known.items() if name in self.states]

    @property
    def equations(self) -> tuple[str, ...]:
        """Those of the simulation, and those of the terms."""
        return tuple(dict.fromkeys((*self.given.equations, *self.known)))

    def rate(self, t: Array, x: Float[Array, " n_state"], u: Float[Array, " n_input"]) -> Float[Array, " n_state"]:
        """Value of g at one point, inside an integrator."""
        columns = dict(zip((*self.states, *self.inputs), (*x, *u), strict=True))
        rate = jnp.asarray(self.given.rate(t, x, u), float)
        for k, terms in self._of_states:
            for term, value in terms:
                rate = rate.at[k].add(value * term.evaluate(columns))
        return rate

    def on(self, data: Trajectories, state: str) -> Float[np.ndarray, " n_obs"]:
        """Values of g for one state on the rows of the data, user's units."""
        rate = np.array(self.given.on(data, state), float)
        for term, value in self.known.get(state, ()):
            rate = rate + value * np.asarray(term.evaluate(data.columns))
        return finite(rate, state)

    def rates(
        self, t: Float[np.ndarray, "*n"], x: Float[np.ndarray, "*n n_state"], u: Float[np.ndarray, "*n n_input"]
    ) -> Float[np.ndarray, "*n n_state"]:
        """Values of g at many points."""
        found, columns = np.array(self.given.rates(t, x, u)), self._columns(x, u)
        for k, terms in self._of_states:
            for term, value in terms:
                found[..., k] += value * np.asarray(term.evaluate(columns))
        return found

    def jacobian(
        self, t: Float[np.ndarray, "*n"], x: Float[np.ndarray, "*n n_state"], u: Float[np.ndarray, "*n n_input"]
    ) -> Float[np.ndarray, "*n n_state n_state"]:
        """∂g/∂x at points along paths."""
        found, columns = np.array(self.given.jacobian(t, x, u)), self._columns(x, u)
        for k, terms in self._of_states:
            for term, value in terms:
                found[..., k, :] += value * gradient(term.expr, self.states, columns)
        return found

    def output(self, name: str, t: Array | np.ndarray, x: Array | np.ndarray, u: Array | np.ndarray) -> Any:
        """That of the simulation, and the terms."""
        columns = dict(zip((*self.states, *self.inputs), (*x.T, *u.T), strict=True))
        added = [value * term.evaluate(columns) for term, value in self.known.get(name, ())]
        return sum(added, start=self.given.output(name, t, x, u))

    def formula(self, name: str) -> sympy.Expr:
        """That of the simulation, and the terms with their coefficients."""
        added = [value * term.expr for term, value in self.known.get(name, ())]
        return cast(sympy.Expr, sympy.Add(self.given.formula(name), *added))

    def own_formula(self, name: str) -> sympy.Expr:
        """That of the simulation."""
        return self.given.own_formula(name)

    def additive_terms(self, state: str) -> list[tuple[Term, float]]:
        """Those of the simulation: the coefficients of the others are known, and nobody corrects them."""
        return self.given.additive_terms(state)

    def readable_terms(self, state: str) -> list[tuple[Term, float]]:
        """Those of the simulation, and those that are known."""
        return [*self.given.readable_terms(state), *self.known.get(state, ())]

    def rate_name(self, state: str) -> str | None:
        """As in the simulation, of states without more terms."""
        return None if state in self.known else self.given.rate_name(state)

    def rounded(self, columns: Mapping[str, Float[np.ndarray, " n"]]) -> "Simulation":
        """Both with their jumps rounded."""
        known = {s: tuple((term.rounded(columns), value) for term, value in own) for s, own in self.known.items()}
        return replace(self, given=self.given.rounded(columns), known=known)

    def without_numbers(self) -> tuple["Simulation", tuple[float, ...]]:
        """Those of the simulation; the terms stay as they are."""
        given, numbers = self.given.without_numbers()
        return replace(self, inputs=given.inputs, given=given), numbers

    @property
    def key(self) -> Hashable:
        """That of the simulation, and the terms."""
        known = ((s, tuple((sympy.srepr(t.expr), value) for t, value in terms)) for s, terms in self.known.items())
        return self.given.key, tuple(known)
