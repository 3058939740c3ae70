"""The known part of the model: the user's simulation as a right-hand side.

`Simulation` is what the rest of the package asks; expressions and callables answer it here, each in its way.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import sympy
from jaxtyping import Array, Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories

from .derivatives import gradient
from .expressions import evaluate, parse_expression
from .rounding import rounded
from .terms import Term

RightHandSide = Callable[[Array, Array, Array], Array]
"""(t, x [n_state], u [n_input]) -> dx/dt [n_state]."""

DIFFERENCE = 6e-6
"""Step of central differences over the size of a state: the cube root of rounding."""

FUNCTION = "function"
"""What stands in files for a simulation that is code."""


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

    @abstractmethod
    def additive_terms(self, state: str) -> list[tuple[Term, float]]:
        """The terms of a state's rate, or of an output, with coefficients; none where the simulation cannot be read."""

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


@dataclass(frozen=True)
class ExpressionSimulation(Simulation):
    """Expressions by state or output; missing ones are zero.

    Attributes:
        expressions: Parsed expressions by state or output.
    """

    expressions: Mapping[str, sympy.Expr]

    @property
    def equations(self) -> tuple[str, ...]:
        """States and outputs with an expression."""
        return tuple(self.expressions)

    def rate(self, t: Array, x: Float[Array, " n_state"], u: Float[Array, " n_input"]) -> Float[Array, " n_state"]:
        """Value of g at one point, inside an integrator."""
        columns = dict(zip((*self.states, *self.inputs), (*x, *u), strict=True))
        return jnp.stack(
            [evaluate(self.expressions[s], columns) if s in self.expressions else jnp.zeros(()) for s in self.states]
        )

    def on(self, data: Trajectories, state: str) -> Float[np.ndarray, " n_obs"]:
        """Values of g for one state on the rows of the data, user's units."""
        if state not in self.expressions:
            return np.zeros(data.n_obs)
        return _finite(np.asarray(evaluate(self.expressions[state], data.columns)), state)

    def rates(
        self, t: Float[np.ndarray, "*n"], x: Float[np.ndarray, "*n n_state"], u: Float[np.ndarray, "*n n_input"]
    ) -> Float[np.ndarray, "*n n_state"]:
        """Values of g at many points."""
        columns, found = self._columns(x, u), np.zeros(x.shape)
        for k, state in enumerate(self.states):
            if state in self.expressions:
                found[..., k] = evaluate(self.expressions[state], columns)
        return found

    def jacobian(
        self, t: Float[np.ndarray, "*n"], x: Float[np.ndarray, "*n n_state"], u: Float[np.ndarray, "*n n_input"]
    ) -> Float[np.ndarray, "*n n_state n_state"]:
        """∂g/∂x at points along paths, from derivatives of the formulas."""
        columns, found = self._columns(x, u), np.zeros((*x.shape, x.shape[-1]))
        for k, state in enumerate(self.states):
            if state in self.expressions:
                found[..., k, :] = gradient(self.expressions[state], self.states, columns)
        return found

    def additive_terms(self, state: str) -> list[tuple[Term, float]]:
        """The additive terms of an expression, each with its coefficient: F - 2*y gives (F, 1) and (y, -2)."""
        if state not in self.expressions:
            return []
        found: dict[sympy.Expr, float] = {}
        for part in sympy.Add.make_args(sympy.expand(self.expressions[state])):
            value, form = part.as_coeff_Mul()
            found[form] = found.get(form, 0.0) + float(value)
        return [(Term(form), value) for form, value in found.items() if value != 0]

    def rate_name(self, state: str) -> str | None:
        """The state that the expression is the name of."""
        # An output that is a state is measured twice, and no rate.
        expression = self.expressions.get(state) if state in self.states else None
        alone = expression is not None and bool(expression.is_Symbol) and str(expression) in self.states
        return str(expression) if alone else None

    def rounded(self, columns: Mapping[str, Float[np.ndarray, " n"]]) -> "Simulation":
        """Formulas with their jumps rounded."""
        smooth = {name: rounded(expr, columns) for name, expr in self.expressions.items()}
        return replace(self, expressions=smooth)

    @property
    def key(self) -> Hashable:
        """Names and formulas."""
        return self.states, self.inputs, tuple((name, str(e)) for name, e in self.expressions.items())


@dataclass(frozen=True)
class CallableSimulation(Simulation):
    """A function (t, x, u) -> dx/dt of all states at once.

    Attributes:
        function: The user's.
    """

    function: RightHandSide

    @property
    def equations(self) -> tuple[str, ...]:
        """All states."""
        return self.states

    def rate(self, t: Array, x: Float[Array, " n_state"], u: Float[Array, " n_input"]) -> Float[Array, " n_state"]:
        """Value of g at one point, inside an integrator."""
        return jnp.asarray(self.function(t, x, u), float)

    def on(self, data: Trajectories, state: str) -> Float[np.ndarray, " n_obs"]:
        """Values of g for one state on the rows of the data, user's units; a function gives no output."""
        if state not in self.states:
            raise InputError(
                f"The simulation is a function, which gives the rates of states and not the output {state!r}: give "
                f"formulas, simulation={{{state!r}: '...'}}, or name the equation of a state in the dictionary."
            )
        return _finite(self._call(data)[:, self.states.index(state)], state)

    def rates(
        self, t: Float[np.ndarray, "*n"], x: Float[np.ndarray, "*n n_state"], u: Float[np.ndarray, "*n n_input"]
    ) -> Float[np.ndarray, "*n n_state"]:
        """Values of g at many points."""
        n_state, n_input = x.shape[-1], u.shape[-1]
        return self._at(t.ravel(), x.reshape(-1, n_state), u.reshape(-1, n_input)).reshape(x.shape)

    def jacobian(
        self, t: Float[np.ndarray, "*n"], x: Float[np.ndarray, "*n n_state"], u: Float[np.ndarray, "*n n_input"]
    ) -> Float[np.ndarray, "*n n_state n_state"]:
        """∂g/∂x at points along paths: by JAX, or by central differences of a function that JAX cannot follow."""
        n_state, n_input = x.shape[-1], u.shape[-1]
        flat = t.ravel(), x.reshape(-1, n_state), u.reshape(-1, n_input)
        try:
            found = np.asarray(_jacobians(self.function, *(jnp.asarray(each) for each in flat)))
        except Exception:
            # As in `_at`.
            size = np.sqrt(np.mean(flat[1] ** 2, axis=0))
            steps = np.diag(DIFFERENCE * np.where(size > 0, size, 1.0))
            differences = [
                self._at(flat[0], flat[1] + h, flat[2]) - self._at(flat[0], flat[1] - h, flat[2]) for h in steps
            ]
            found = np.stack(differences, axis=-1) / (2 * np.diag(steps))
        return found.reshape(*x.shape, n_state)

    def additive_terms(self, state: str) -> list[tuple[Term, float]]:
        """None: code cannot be read."""
        return []

    def rate_name(self, state: str) -> str | None:
        """Never known; data that meet the rate exactly tell it."""
        return None

    @property
    def key(self) -> Hashable:
        """Names, and the very function."""
        return self.states, self.inputs, self.function

    def _call(self, data: Trajectories) -> np.ndarray:
        return self._at(data.time, data.matrix(self.states), data.matrix(self.inputs))

    def _at(self, t: np.ndarray, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        try:
            rates = np.asarray(jax.vmap(self.rate)(jnp.asarray(t), jnp.asarray(x), jnp.asarray(u)))
        except Exception:
            # Plain NumPy, in-place assignment and Python branches fail under JAX with errors of many kinds.
            rates = self._row_by_row(t, x, u)
        if rates.shape != (len(t), len(self.states)):
            raise InputError(
                f"The simulation returns {rates.shape[1:]} rates for {len(self.states)} states: return one "
                f"for each of {', '.join(self.states)}."
            )
        return rates

    def _row_by_row(self, t: np.ndarray, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        try:
            return np.array([self.function(*row) for row in zip(t, x, u, strict=True)], float)
        except Exception as error:
            raise InputError(
                f"The simulation failed on the data with {type(error).__name__}: {error}. It is called as "
                "simulation(t, x, u), with arrays of states and inputs, and returns the rates of all states."
            ) from error


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
        return _finite(rate, state)

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

    def additive_terms(self, state: str) -> list[tuple[Term, float]]:
        """Those of the simulation: the coefficients of the others are known, and nobody corrects them."""
        return self.given.additive_terms(state)

    def rate_name(self, state: str) -> str | None:
        """As in the simulation, of states without more terms."""
        return None if state in self.known else self.given.rate_name(state)

    def rounded(self, columns: Mapping[str, Float[np.ndarray, " n"]]) -> "Simulation":
        """Both with their jumps rounded."""
        known = {s: tuple((term.rounded(columns), value) for term, value in own) for s, own in self.known.items()}
        return replace(self, given=self.given.rounded(columns), known=known)

    @property
    def key(self) -> Hashable:
        """That of the simulation, and the terms."""
        texts = tuple((s, tuple((term.text, value) for term, value in terms)) for s, terms in self.known.items())
        return self.given.key, texts


def simulation_of(
    given: Mapping[str, str] | RightHandSide | None,
    states: tuple[str, ...],
    inputs: tuple[str, ...],
    outputs: Sequence[str] = (),
) -> Simulation:
    """Read the user's simulation.

    Args:
        given: Expressions by state or output, a function of all states at once, or None for no simulation.
        states: State names of the data.
        inputs: Input names of the data.
        outputs: Output names of the data, which expressions give and do not use.

    Raises:
        InputError: An expression for an unknown state or output, or one that cannot be read.
    """
    if callable(given):
        return CallableSimulation(states, inputs, given)
    given = given or {}
    unknown = [name for name in given if name not in (*states, *outputs)]
    if unknown:
        raise InputError(f"The simulation has an equation for {unknown[0]!r}, {not_known(states, outputs)}.")
    parsed = {name: parse_expression(str(text), (*states, *inputs)) for name, text in given.items()}
    return ExpressionSimulation(states, inputs, parsed)


def not_known(states: Sequence[str], outputs: Sequence[str], hint: str = "") -> str:
    """What is said of an equation for a name that the data do not have, with those that they have.

    Args:
        states: State names of the data.
        outputs: Output names of the data.
        hint: What may have been meant, in brackets.
    """
    if not outputs:
        return f"which is not a state of the data{hint}; states: {', '.join(states)}"
    known = [f"{what}: {', '.join(names)}" for what, names in (("states", states), ("outputs", outputs)) if names]
    return f"which is neither a state nor an output of the data{hint}; {'; '.join(known)}"


@partial(jax.jit, static_argnums=0)
def _jacobians(function: RightHandSide, t: Array, x: Array, u: Array) -> Array:
    def rate(t: Array, x: Array, u: Array) -> Array:
        return jnp.asarray(function(t, x, u), float)

    return jax.vmap(jax.jacfwd(rate, 1))(t, x, u)


def simulation_record(given: Mapping[str, str] | RightHandSide | None) -> Any:
    """A user's simulation as plain values for a file: its expressions, or the word that it is code."""
    return FUNCTION if callable(given) else {name: str(text) for name, text in (given or {}).items()}


def simulation_from(record: Any, function: RightHandSide | None = None) -> Mapping[str, str] | RightHandSide:
    """The inverse of `simulation_record`.

    Args:
        record: What it returned.
        function: The simulation's function, if it had one; a file cannot hold code.

    Raises:
        InputError: If the simulation was a function and none is given.
    """
    if record != FUNCTION:
        return record
    if function is None:
        raise InputError(
            "The model's simulation was a Python function, which a file cannot hold: give it again, "
            "bg.load(path, simulation=function)."
        )
    return function


def _finite(value: np.ndarray, state: str) -> np.ndarray:
    if not np.all(np.isfinite(value)):
        raise InputError(f"The simulation of {state!r} is not finite on all the data: check its domain.")
    return value
