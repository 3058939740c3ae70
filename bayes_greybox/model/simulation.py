"""The known part of the model: the user's simulation as a right-hand side."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import sympy
from jaxtyping import Array, Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.expressions import evaluate, parse_expression

RightHandSide = Callable[[Array, Array, Array], Array]
"""(t, x [n_state], u [n_input]) -> dx/dt [n_state]."""


@dataclass(frozen=True)
class Simulation:
    """g(x, u): expressions by state, or a callable for all states at once. Missing expressions are zero.

    Attributes:
        states: State names, in the order of x.
        inputs: Input names, in the order of u.
        expressions: Parsed expressions by state.
        function: The user's callable, instead of expressions.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    expressions: Mapping[str, sympy.Expr]
    function: RightHandSide | None = None

    @classmethod
    def of(
        cls, given: Mapping[str, str] | RightHandSide | None, states: tuple[str, ...], inputs: tuple[str, ...]
    ) -> "Simulation":
        """Read the user's simulation.

        Raises:
            InputError: An expression for an unknown state, or one that cannot be read.
        """
        if callable(given):
            return cls(states, inputs, {}, given)
        given = given or {}
        unknown = [name for name in given if name not in states]
        if unknown:
            raise InputError(
                f"The simulation has an equation for {unknown[0]!r}, which is not a state of the data; "
                f"states: {', '.join(states)}."
            )
        parsed = {name: parse_expression(str(text), (*states, *inputs)) for name, text in given.items()}
        return cls(states, inputs, parsed)

    def rate(self, t: Array, x: Float[Array, " n_state"], u: Float[Array, " n_input"]) -> Float[Array, " n_state"]:
        """Value of g at one point, inside an integrator."""
        if self.function is not None:
            return jnp.asarray(self.function(t, x, u), float)
        columns = dict(zip((*self.states, *self.inputs), (*x, *u), strict=True))
        return jnp.stack(
            [evaluate(self.expressions[s], columns) if s in self.expressions else jnp.zeros(()) for s in self.states]
        )

    def on(self, data: Trajectories, state: str) -> Float[np.ndarray, " n_obs"]:
        """Values of g for one state on the rows of the data, user's units.

        Raises:
            InputError: A callable that fails, or returns the wrong number of rates.
        """
        if self.function is None:
            if state not in self.expressions:
                return np.zeros(data.n_obs)
            value = np.asarray(evaluate(self.expressions[state], data.columns))
        else:
            value = self._call(data)[:, self.states.index(state)]
        if not np.all(np.isfinite(value)):
            raise InputError(f"The simulation of {state!r} is not finite on all the data: check its domain.")
        return value

    def _row_by_row(self, t: np.ndarray, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        assert self.function is not None
        try:
            return np.array([self.function(*row) for row in zip(t, x, u, strict=True)], float)
        except Exception as error:
            raise InputError(
                f"The simulation failed on the data with {type(error).__name__}: {error}. It is called as "
                "simulation(t, x, u), with arrays of states and inputs, and returns the rates of all states."
            ) from error

    def _call(self, data: Trajectories) -> np.ndarray:
        x, u = data.matrix(self.states), data.matrix(self.inputs)
        try:
            rates = np.asarray(jax.vmap(self.rate)(jnp.asarray(data.time), jnp.asarray(x), jnp.asarray(u)))
        except Exception:
            # Plain NumPy, in-place assignment and Python branches fail under JAX with errors of many kinds.
            rates = self._row_by_row(data.time, x, u)
        if rates.shape != (data.n_obs, len(self.states)):
            raise InputError(
                f"The simulation returns {rates.shape[1:]} rates for {len(self.states)} states: return one "
                f"for each of {', '.join(self.states)}."
            )
        return rates
