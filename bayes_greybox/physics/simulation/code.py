"""A simulation that is code."""

from collections.abc import Hashable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import sympy
from jaxtyping import Array

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.formula.grammar import symbol
from bayes_greybox.running.errors import InputError

from .protocol import (
    CENTRAL_DIFFERENCE_STEP,
    Input,
    Inputs,
    Jacobians,
    RightHandSide,
    Simulation,
    State,
    States,
    Times,
)


@dataclass(frozen=True)
class CallableSimulation(Simulation):
    """A user's function (t, x, u) -> dx/dt of all states at once."""

    function: RightHandSide

    @property
    def code(self) -> str:
        """A few words."""
        return "your function"

    @property
    def _equations(self) -> tuple[str, ...]:
        return self.states

    def _rate(self, t: Array, x: State, u: Input) -> State:
        return jnp.asarray(self.function(t, x, u), float)

    def _on(self, data: Trajectories, state: str) -> np.ndarray:
        if state not in self.states:
            raise InputError(
                f"The simulation is a function, which gives the rates of states and not the output {state!r}: give "
                f"formulas, simulation={{{state!r}: '...'}}, or name the equation of a state in the dictionary."
            )
        rates = self._at(data.time, data.matrix(self.states), data.matrix(self.inputs))
        return rates[:, self.states.index(state)]

    def _rates(self, t: Times, x: States, u: Inputs) -> States:
        return self._at(*flat(t, x, u)).reshape(x.shape)

    def _jacobian(self, t: Times, x: States, u: Inputs) -> Jacobians:
        """Return ∂g/∂x by JAX, or by central differences where JAX cannot trace the function."""
        t, x_flat, u = flat(t, x, u)
        try:
            slopes = np.asarray(_jacobians(self._now(), *(jnp.asarray(each) for each in (t, x_flat, u))))
        except Exception:
            # As in `_at`.
            size = np.sqrt(np.mean(x_flat**2, axis=0))
            steps = np.diag(CENTRAL_DIFFERENCE_STEP * np.where(size > 0, size, 1.0))
            differences = [self._at(t, x_flat + h, u) - self._at(t, x_flat - h, u) for h in steps]
            slopes = np.stack(differences, axis=-1) / (2 * np.diag(steps))
        return slopes.reshape(*x.shape, x.shape[-1])

    def _formula(self, name: str) -> sympy.Expr:
        return undefined(self, name) if name in self.states else sympy.S.Zero

    @property
    def _key(self) -> Hashable:
        return self.states, self.inputs, self._now()

    def _now(self) -> "_Now":
        return _Now(self.function, len(self.states), len(self.inputs))

    def _at(self, t: np.ndarray, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        try:
            rates = np.asarray(jax.vmap(self._rate)(jnp.asarray(t), jnp.asarray(x), jnp.asarray(u)))
        except Exception:
            # Plain NumPy, in-place assignment and Python branches fail under JAX with errors of many kinds.
            try:
                rates = np.array([self.function(*row) for row in zip(t, x, u, strict=True)], float)
            except Exception as error:
                raise InputError(
                    f"The simulation failed on the data with {type(error).__name__}: {error}. It is called as "
                    "simulation(t, x, u), with arrays of states and inputs, and returns the rates of all states."
                ) from error
        if rates.shape != (len(t), len(self.states)):
            raise InputError(
                f"The simulation returns {rates.shape[1:]} rates for {len(self.states)} states: return one "
                f"for each of {', '.join(self.states)}."
            )
        return rates


def flat(t: np.ndarray, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points along one axis."""
    return t.ravel(), x.reshape(t.size, x.shape[-1]), u.reshape(t.size, u.shape[-1])


def undefined(simulation: Simulation, name: str) -> sympy.Expr:
    """Return the undefined function g_name(t, x, u) that stands for code."""
    return sympy.Function(f"g_{name}", real=True)(*map(symbol, ("t", *simulation.states, *simulation.inputs)))


def require_traceable(simulation: Simulation, otherwise: str = "") -> None:
    """Refuse a simulation that an integrator could not follow; rates of rows do with plain NumPy, paths do not.

    The message ends with `otherwise`, an alternative for the user.
    """
    x, u = (jax.ShapeDtypeStruct((len(names),), float) for names in (simulation.states, simulation.inputs))
    try:
        jax.eval_shape(simulation.rate, jax.ShapeDtypeStruct((), float), x, u)
    except Exception as error:
        raise InputError(
            f"The simulation cannot be integrated, {type(error).__name__}: write it with jax.numpy, without in-place "
            f"assignment and without branches on its values{otherwise}."
        ) from error


class _Now:
    """A function as it is now, unequal to itself once the numbers that it reads beside its arguments have changed.

    A global of a notebook or an attribute of its object may be changed between two fits. Only the function's values at
    a few points show that.
    """

    def __init__(self, function: RightHandSide, n_state: int, n_input: int) -> None:
        self._function = function
        points = np.random.default_rng(0).standard_normal((3, 1 + n_state + n_input))
        try:
            values = [np.asarray(function(z[0], z[1 : 1 + n_state], z[1 + n_state :]), float) for z in points]
            self._seen = b"".join(each.tobytes() for each in values)
        except Exception:
            # It has no values there, or its error is reported where it is used.
            self._seen = b""

    def __call__(self, t: Array, x: Array, u: Array) -> Array:
        return jnp.asarray(self._function(t, x, u), float)

    def __hash__(self) -> int:
        # By identity: users' functions need not be hashable.
        return hash((id(self._function), self._seen))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Now) and self._function is other._function and self._seen == other._seen


@partial(jax.jit, static_argnums=0)
def _jacobians(function: _Now, t: Array, x: Array, u: Array) -> Array:
    return jax.vmap(jax.jacfwd(function, 1))(t, x, u)
