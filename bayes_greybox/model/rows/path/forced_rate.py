"""Rates of all states with terms added to those that are learned."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import sympy
from jaxtyping import Array, Float

from bayes_greybox.physics.formula.expressions import evaluate
from bayes_greybox.physics.formula.numbers import as_columns, without_numbers
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.terms import Term


class Force(NamedTuple):
    """A term with its coefficient, and the index of the state whose rate it is added to."""

    term: Term
    coefficient: float
    state: int


class ForcedRate:
    """Rate of all states with terms added to some: equal to any other with the same formulas, so compiled once.

    Numbers within a formula, such as the width of a dead zone, are arguments of the rate and none of the formula's.
    """

    def __init__(self, simulation: Simulation, driven: tuple[int, ...], added: Sequence[Force]) -> None:
        self.simulation, self.driven, self.added = simulation, driven, tuple(added)
        by_state = {simulation.states[k]: [(f.term, f.coefficient) for f in added if f.state == k] for k in driven}
        self.whole = simulation.beside(by_state)
        self.bare, of_simulation = simulation.without_numbers()
        formulas: list[sympy.Expr] = []
        numbers: list[Sequence[float]] = [of_simulation]
        for term, coefficient, _ in added:
            (formula,), within = without_numbers([term.expr])
            formulas.append(formula)
            numbers.append([coefficient, *within])
        self.formulas = tuple(formulas)
        self.args = tuple(jnp.array(each, float) for each in numbers)
        self._key = (self.bare.key, driven, tuple(map(str, formulas)), tuple(force.state for force in added))

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ForcedRate) and self._key == other._key

    def __call__(self, t: Array, x: Array, u: Array, args: tuple[Array, ...]) -> Array:
        """Return the rates at a point; `args` are numbers of the simulation, then coefficient and numbers by term."""
        of_simulation, *added = args
        rate = jnp.asarray(self.bare.rate(t, x, jnp.concatenate([u, of_simulation])), float)
        columns = dict(zip(self.names, (*x, *u), strict=True))
        forces = dict.fromkeys(self.driven, 0.0 * t)
        for (*_, state), formula, (coefficient, *numbers) in zip(self.added, self.formulas, added, strict=True):
            forces[state] = forces[state] + coefficient * evaluate(formula, {**columns, **as_columns(numbers)})
        for state, force in forces.items():
            rate = rate.at[state].add(force)
        return rate

    @property
    def names(self) -> tuple[str, ...]:
        """States, then inputs."""
        return (*self.simulation.states, *self.simulation.inputs)

    def known(self, points: Float[np.ndarray, "*n c"]) -> Float[np.ndarray, "*n n_state"]:
        """Return the rates of the simulation alone; points are time, states and inputs."""
        return self.simulation.rates(*self._parted(points))

    def rates(self, points: Float[np.ndarray, "*n c"]) -> Float[np.ndarray, "*n n_state"]:
        """Return the rates with the added terms."""
        return np.array(self.whole.rates(*self._parted(points)))

    def jacobian(self, points: Float[np.ndarray, "*n c"]) -> Float[np.ndarray, "*n n_state n_state"]:
        """Return their derivatives by the states; neighbours on a path are neighbours along the last axis but one."""
        return self.whole.jacobian(*self._parted(points))

    def _parted(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        n_state = len(self.simulation.states)
        return points[..., 0], points[..., 1 : 1 + n_state], points[..., 1 + n_state :]
