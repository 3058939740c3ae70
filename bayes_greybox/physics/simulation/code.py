"""A simulation that is code."""

from collections.abc import Hashable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import sympy
from jaxtyping import Array, Float

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.formula.grammar import symbol
from bayes_greybox.physics.terms import Term

from .protocol import RightHandSide, Simulation, finite

DIFFERENCE = 6e-6
"""Step of central differences over the size of a state: the cube root of rounding."""


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
        return finite(self._call(data)[:, self.states.index(state)], state)

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

    def formula(self, name: str) -> sympy.Expr:
        """An undefined function g_name(t, x, u) of a state: code cannot be read. It gives no outputs."""
        if name not in self.states:
            return sympy.S.Zero
        return sympy.Function(f"g_{name}", real=True)(*map(symbol, ("t", *self.states, *self.inputs)))

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


@partial(jax.jit, static_argnums=0)
def _jacobians(function: RightHandSide, t: Array, x: Array, u: Array) -> Array:
    def rate(t: Array, x: Array, u: Array) -> Array:
        return jnp.asarray(function(t, x, u), float)

    return jax.vmap(jax.jacfwd(rate, 1))(t, x, u)
