"""The protocol of a simulation, which formulas, code and FMUs fulfil."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, cast

import numpy as np
import sympy
from jaxtyping import Array, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.formula.expressions import evaluate
from bayes_greybox.physics.formula.rounding import gradient
from bayes_greybox.physics.hidden_states import Starts
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

RightHandSide = Callable[[Array, Array, Array], Array]
"""(t, x [n_state], u [n_input]) -> dx/dt [n_state]."""

State = Float[Array, " n_state"]
Input = Float[Array, " n_input"]
"""States and inputs at one point, inside an integrator."""

Times = Float[np.ndarray, "*n"]
States = Float[np.ndarray, "*n n_state"]
Inputs = Float[np.ndarray, "*n n_input"]
Jacobians = Float[np.ndarray, "*n n_state n_state"]
"""Values at many points, such as those along paths."""

KnownTerms = Sequence[tuple[Term, float]]
"""Terms with their coefficients."""


class Correctable(NamedTuple):
    """A number of a simulation that a study may find off: ∂g by it, its value, any name of it, and possible changes."""

    term: Term
    nominal: float
    parameter: str = ""
    limits: tuple[float, float] = (-math.inf, math.inf)

    def about(self) -> dict[str, Any]:
        """Return all but the term, by name."""
        return {"nominal": self.nominal, "parameter": self.parameter, "limits": self.limits}


CENTRAL_DIFFERENCE_STEP = 6e-6
"""Step of central differences over the size of a column: the cube root of rounding."""


@dataclass(frozen=True)
class Simulation(ABC):
    """g(x, u), the known rates of the states, and what is known of outputs.

    A kind of simulation gives what begins with "_", of itself; terms `beside` it are added here.

    Attributes:
        states: State names, in the order of x.
        inputs: Input names, in the order of u.
        known: Known terms beside it, by state or output.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    known: Mapping[str, tuple[tuple[Term, float], ...]] = field(default_factory=dict, kw_only=True, hash=False)

    @property
    def differentiable(self) -> bool:
        """True if an integrated path has exact derivatives by its start and coefficients, as NUTS needs them."""
        return True

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences for the user about defects of the simulation that its use has shown."""
        return ()

    @property
    def code(self) -> str:
        """A few words that describe a simulation which is code; "" for formulas."""
        return ""

    @property
    def starts(self) -> Starts:
        """Values that hidden states have where a run starts, or columns that have them there."""
        return {}

    @property
    @abstractmethod
    def _equations(self) -> tuple[str, ...]: ...

    @abstractmethod
    def _rate(self, t: Array, x: State, u: Input) -> State: ...

    @abstractmethod
    def _on(self, data: Trajectories, state: str) -> np.ndarray: ...

    @abstractmethod
    def _rates(self, t: Times, x: States, u: Inputs) -> States: ...

    @abstractmethod
    def _jacobian(self, t: Times, x: States, u: Inputs) -> Jacobians: ...

    @abstractmethod
    def _formula(self, name: str) -> sympy.Expr: ...

    @property
    @abstractmethod
    def _key(self) -> Hashable: ...

    def _output(self, name: str, t: Any, x: Any, u: Any) -> Any:
        return evaluate(self._formula(name), self.named(x.T, u.T))

    def _in_parameters(self, name: str, parameters: Collection[str]) -> sympy.Expr:
        return self._formula(name)

    def _rate_name(self, state: str) -> str | None:
        return None

    @property
    def equations(self) -> tuple[str, ...]:
        """States whose rate the simulation gives, that of the others is zero; and outputs that it gives."""
        return tuple(dict.fromkeys((*self._equations, *self.known)))

    def rate(self, t: Array, x: State, u: Input) -> State:
        """Return g at one point, inside an integrator."""
        rate = self._rate(t, x, u)
        if self.known:
            columns = self.named(x, u)
            for k, term, value in self._known_in_rates:
                rate = rate.at[k].add(value * term.evaluate(columns))
        return rate

    def on(self, data: Trajectories, state: str) -> Float[np.ndarray, " n_obs"]:
        """Return g for one state or output on the rows of the data, user's units.

        Raises:
            InputError: The simulation fails, is not finite, or returns the wrong number of rates; or an output is asked
                of a function.
        """
        rate = finite(self._on(data, state), state)
        for term, value in self.known.get(state, ()):
            rate = rate + value * np.asarray(term.evaluate(data.columns))
        return finite(rate, state)

    def rates(self, t: Times, x: States, u: Inputs) -> States:
        """Return g at many points."""
        if not self.known:
            return self._rates(t, x, u)
        rates, columns = np.array(self._rates(t, x, u)), self._columns(x, u)
        for k, term, value in self._known_in_rates:
            rates[..., k] += value * np.asarray(term.evaluate(columns))
        return rates

    def jacobian(self, t: Times, x: States, u: Inputs) -> Jacobians:
        """Return ∂g/∂x at points along paths, neighbours along the last axis of t."""
        if not self.known:
            return self._jacobian(t, x, u)
        slopes, columns = np.array(self._jacobian(t, x, u)), self._columns(x, u)
        for k, term, value in self._known_in_rates:
            slopes[..., k, :] += value * gradient(term.expr, self.states, columns)
        return slopes

    def output(self, name: str, t: Array | np.ndarray, x: Array | np.ndarray, u: Array | np.ndarray) -> Any:
        """Return an output at many points along the first axis, by NumPy on its arrays, else by JAX."""
        added = [value * term.evaluate(self.named(x.T, u.T)) for term, value in self.known.get(name, ())]
        return sum(added, start=self._output(name, t, x, u))

    def formula(self, name: str) -> sympy.Expr:
        """Return the known rate of a state, or an output, as a formula; code is an undefined function g_name."""
        return self._plus_known(self._formula(name), name)

    def own_formula(self, name: str) -> sympy.Expr:
        """Return the formula as the user wrote it: with names of parameters, without terms `beside` the simulation."""
        return self._formula(name)

    def in_parameters(self, name: str, parameters: Collection[str]) -> sympy.Expr:
        """Return a formula with the names of some parameters, whose terms it has; the others are numbers in it."""
        return self._plus_known(self._in_parameters(name, parameters), name)

    def additive_terms(self, state: str) -> list[tuple[Term, float]]:
        """Return the terms of a state's rate, or of an output, with coefficients; code has none that can be read."""
        return []

    def correctable(self, state: str) -> list[Correctable]:
        """Return the numbers in a state's rate, or in an output, that a study may find off."""
        return [Correctable(term, value) for term, value in self.additive_terms(state)]

    def nominals(self, state: str) -> dict[str, float]:
        """Return the coefficients of the additive terms by name."""
        return {term.name: value for term, value in self.additive_terms(state)}

    def readable_terms(self, state: str) -> list[tuple[Term, float]]:
        """Return the terms of `additive_terms`, and those whose coefficients are known besides."""
        return [*self.additive_terms(state), *self.known.get(state, ())]

    def kinematic(self, state: str) -> bool:
        """Return True if the rate of a state is known to be another state, as position and velocity are."""
        return self.rate_name(state) is not None

    def rate_name(self, state: str) -> str | None:
        """Return the state that is the rate of a state; None where its rate is anything else, or cannot be read."""
        return None if state in self.known else self._rate_name(state)

    @property
    def key(self) -> Hashable:
        """Value that two simulations share if they do the same: programs are compiled once for it."""
        known = ((s, tuple((sympy.srepr(t.expr), value) for t, value in terms)) for s, terms in self.known.items())
        return (self._key, tuple(known)) if self.known else self._key

    def rounded(self, columns: Mapping[str, Float[np.ndarray, " n"]]) -> "Simulation":
        """Return the simulation with jumps of its formulas rounded on these columns, for an integrator."""
        known = {s: tuple((term.rounded(columns), value) for term, value in terms) for s, terms in self.known.items()}
        return replace(self, known=known) if known else self

    def without_numbers(self) -> tuple["Simulation", tuple[float, ...]]:
        """Return the simulation with decimal numbers of its formulas as further inputs, and these; code has none."""
        return self, ()

    def beside(self, known: Mapping[str, KnownTerms]) -> "Simulation":
        """Return the simulation with known terms added to the rates of states, which may also have none."""
        added = {state: (*self.known.get(state, ()), *terms) for state, terms in known.items() if terms}
        return replace(self, known={**self.known, **added}) if added else self

    def named(self, x: Any, u: Any) -> dict[str, Any]:
        """Return columns by name, where states and inputs lie along the first axis."""
        return dict(zip((*self.states, *self.inputs), (*x, *u), strict=True))

    def _columns(self, x: np.ndarray, u: np.ndarray) -> dict[str, np.ndarray]:
        return self.named(np.moveaxis(x, -1, 0), np.moveaxis(u, -1, 0))

    @property
    def _known_in_rates(self) -> list[tuple[int, Term, float]]:
        """Known terms in rates, with the index of the state and the coefficient."""
        places = {name: k for k, name in enumerate(self.states)}
        return [(places[name], *each) for name, terms in self.known.items() if name in places for each in terms]

    def _plus_known(self, formula: sympy.Expr, name: str) -> sympy.Expr:
        return cast(sympy.Expr, sympy.Add(formula, *(value * term.expr for term, value in self.known.get(name, ()))))


def finite(value: np.ndarray, state: str) -> np.ndarray:
    """Return the values of a state's rate, or refuse them where some are not finite."""
    if not np.all(np.isfinite(value)):
        raise InputError(f"The simulation of {state!r} is not finite on all the data: check its domain.")
    return value
