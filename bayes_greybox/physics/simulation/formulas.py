"""A simulation of formulas."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
import sympy
from jaxtyping import Array, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.formula.derivatives import gradient
from bayes_greybox.physics.formula.expressions import evaluate
from bayes_greybox.physics.formula.numbers import as_columns, without_numbers
from bayes_greybox.physics.formula.rounding import rounded
from bayes_greybox.physics.terms import Term

from .protocol import Input, Inputs, Jacobians, Simulation, State, States, Times, finite


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

    def rate(self, t: Array, x: State, u: Input) -> State:
        """Return g at one point, inside an integrator."""
        columns, known = self.named(x, u), self.expressions
        return jnp.stack([evaluate(known[s], columns) if s in known else jnp.zeros(()) for s in self.states])

    def on(self, data: Trajectories, state: str) -> Float[np.ndarray, " n_obs"]:
        """Return g for one state on the rows of the data, user's units."""
        if state not in self.expressions:
            return np.zeros(data.n_obs)
        return finite(np.asarray(evaluate(self.expressions[state], data.columns)), state)

    def rates(self, t: Times, x: States, u: Inputs) -> States:
        """Return g at many points."""
        columns, rates = self._columns(x, u), np.zeros(x.shape)
        for k, state in enumerate(self.states):
            if state in self.expressions:
                rates[..., k] = evaluate(self.expressions[state], columns)
        return rates

    def jacobian(self, t: Times, x: States, u: Inputs) -> Jacobians:
        """Return ∂g/∂x at points along paths, from derivatives of the formulas."""
        columns, slopes = self._columns(x, u), np.zeros((*x.shape, x.shape[-1]))
        for k, state in enumerate(self.states):
            if state in self.expressions:
                slopes[..., k, :] = gradient(self.expressions[state], self.states, columns)
        return slopes

    def formula(self, name: str) -> sympy.Expr:
        """Return the expression; zero where there is none."""
        return self.expressions.get(name, sympy.S.Zero)

    def additive_terms(self, state: str) -> list[tuple[Term, float]]:
        """Split an expression into additive terms with coefficients: F - 2*y gives (F, 1) and (y, -2)."""
        if state not in self.expressions:
            return []
        values: dict[sympy.Expr, float] = {}
        for part in sympy.Add.make_args(sympy.expand(self.expressions[state])):
            value, form = part.as_coeff_Mul()
            values[form] = values.get(form, 0.0) + float(value)
        return [(Term(form), value) for form, value in values.items() if value != 0]

    def rate_name(self, state: str) -> str | None:
        """Return the state whose name is the expression."""
        # An output that is a state is measured twice, and no rate.
        expression = self.expressions.get(state) if state in self.states else None
        alone = expression is not None and bool(expression.is_Symbol) and str(expression) in self.states
        return str(expression) if alone else None

    def rounded(self, columns: Mapping[str, Float[np.ndarray, " n"]]) -> "Simulation":
        """Round the jumps of the formulas."""
        smooth = {name: rounded(expr, columns) for name, expr in self.expressions.items()}
        return replace(self, expressions=smooth)

    def without_numbers(self) -> tuple["Simulation", tuple[float, ...]]:
        """Return formulas over numbers that are inputs; these are the last ones."""
        formulas, numbers = without_numbers(self.expressions.values())
        inputs = (*self.inputs, *as_columns(numbers))
        return replace(self, inputs=inputs, expressions=dict(zip(self.expressions, formulas, strict=True))), numbers

    @property
    def key(self) -> Hashable:
        """Names and formulas, with all digits of their numbers."""
        return self.states, self.inputs, tuple((name, sympy.srepr(e)) for name, e in self.expressions.items())
