"""A simulation of formulas."""

from collections.abc import Collection, Hashable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import sympy
from jaxtyping import Array, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.formula.expressions import evaluate
from bayes_greybox.physics.formula.grammar import symbol
from bayes_greybox.physics.formula.numbers import as_columns, without_numbers
from bayes_greybox.physics.formula.rounding import gradient, rounded
from bayes_greybox.physics.parameters import Parameter, Parameters, tangent
from bayes_greybox.physics.terms import Term

from .protocol import Correctable, Input, Inputs, Jacobians, Simulation, Starts, State, States, Times
from .through_states import acting_through, through_states


@dataclass(frozen=True)
class ExpressionSimulation(Simulation):
    """Expressions by state or output; missing ones are zero.

    Attributes:
        expressions: Parsed expressions by state or output, without names of parameters (see `with_parameters`).
        written: The same as the user wrote them, with names of parameters; empty where there are none.
        parameters: The parameters.
        begun: The same as `starts`, with names of parameters.
    """

    expressions: Mapping[str, sympy.Expr]
    written: Mapping[str, sympy.Expr] = field(default_factory=dict)
    parameters: Parameters = field(default_factory=dict)
    begun: Starts = field(default_factory=dict)

    @classmethod
    def with_parameters(
        cls, states: tuple[str, ...], inputs: tuple[str, ...], written: Mapping[str, sympy.Expr],
        parameters: Parameters, starts: Starts,
    ) -> "ExpressionSimulation":  # fmt: skip
        """Return formulas at the values of their parameters, without the terms of those that are learned.

        Parameters that act through hidden states are where formulas are linearised: these states follow no tangent.
        """
        if not parameters:
            return cls(states, inputs, written, begun=starts)
        there = {name: Parameter(parameters[name].here) for name in acting_through(written, starts, parameters)}
        expressions = {name: tangent(expr, {**parameters, **there}).rest for name, expr in written.items()}
        return cls(states, inputs, expressions, written, parameters, starts)

    @property
    def _equations(self) -> tuple[str, ...]:
        return tuple(self.expressions)

    @property
    def starts(self) -> Starts:
        """Values of hidden states where a run starts, those of parameters where formulas are linearised."""
        here: dict[float | str, float] = {name: each.here for name, each in self.parameters.items()}
        return {state: here.get(start, start) for state, start in self.begun.items()}

    def _rate(self, t: Array, x: State, u: Input) -> State:
        columns, known = self.named(x, u), self.expressions
        return jnp.stack([evaluate(known[s], columns) if s in known else jnp.zeros(()) for s in self.states])

    def _on(self, data: Trajectories, state: str) -> np.ndarray:
        if state not in self.expressions:
            return np.zeros(data.n_obs)
        return np.asarray(evaluate(self.expressions[state], data.columns))

    def _rates(self, t: Times, x: States, u: Inputs) -> States:
        columns, rates = self._columns(x, u), np.zeros(x.shape)
        for k, state in enumerate(self.states):
            if state in self.expressions:
                rates[..., k] = evaluate(self.expressions[state], columns)
        return rates

    def _jacobian(self, t: Times, x: States, u: Inputs) -> Jacobians:
        columns, slopes = self._columns(x, u), np.zeros((*x.shape, x.shape[-1]))
        for k, state in enumerate(self.states):
            if state in self.expressions:
                slopes[..., k, :] = gradient(self.expressions[state], self.states, columns)
        return slopes

    def _formula(self, name: str) -> sympy.Expr:
        return self.expressions.get(name, sympy.S.Zero)

    def own_formula(self, name: str) -> sympy.Expr:
        """Return the expression with names of parameters."""
        return self.written.get(name, self._formula(name))

    def _in_parameters(self, name: str, parameters: Collection[str]) -> sympy.Expr:
        if name not in self.written:
            return self._formula(name)
        given = {symbol(p): sympy.Float(each.value) for p, each in self.parameters.items() if p not in parameters}
        return cast(sympy.Expr, self.written[name].xreplace(given))

    def additive_terms(self, state: str) -> list[tuple[Term, float]]:
        """Split an expression into additive terms with coefficients: F - 2*y gives (F, 1) and (y, -2)."""
        return _additive(self.expressions[state]) if state in self.expressions else []

    def correctable(self, state: str) -> list[Correctable]:
        """Return the coefficients of terms without parameters, and the parameters that are not learned anyway."""
        if state not in self.written:
            return super().correctable(state)
        formula, names = self.written[state], {symbol(name) for name in self.parameters}
        parts = [part for part in sympy.Add.make_args(sympy.expand(formula)) if not part.free_symbols & names]
        off = [Correctable(term, value) for term, value in _additive(sympy.Add(*parts))]
        slopes = tangent(formula, self.parameters).slopes
        for name, each in self.parameters.items():
            through, hidden = through_states(state, name, self.written, self.begun, self.parameters)
            slope: Any = slopes.get(name, sympy.S.Zero) + through
            if slope != 0 and not each.learned:
                term = Term(slope, name, states=hidden, parameter=name)
                off.append(Correctable(term, each.value, name, each.changes))
        return off

    def nominals(self, state: str) -> dict[str, float]:
        """Return the numbers that the additive terms of the whole formula have."""
        if state not in self.written:
            return super().nominals(state)
        values = {symbol(name): sympy.Float(each.here) for name, each in self.parameters.items()}
        formula: Any = self.written[state].xreplace(values)
        return {term.name: value for term, value in _additive(formula)}

    def _rate_name(self, state: str) -> str | None:
        # An output that is a state is measured twice, and no rate.
        expression = self.expressions.get(state) if state in self.states else None
        alone = expression is not None and bool(expression.is_Symbol) and str(expression) in self.states
        return str(expression) if alone else None

    def rounded(self, columns: Mapping[str, Float[np.ndarray, " n"]]) -> "Simulation":
        """Round the jumps of the formulas."""
        smooth = {name: rounded(expr, columns) for name, expr in self.expressions.items()}
        named = {**columns, **{name: np.asarray(each.here) for name, each in self.parameters.items()}}
        written = {name: rounded(expr, named) for name, expr in self.written.items()}
        return replace(super().rounded(columns), expressions=smooth, written=written)

    def without_numbers(self) -> tuple["Simulation", tuple[float, ...]]:
        """Return formulas over numbers that are inputs; these are the last ones."""
        formulas, numbers = without_numbers(self.expressions.values())
        inputs = (*self.inputs, *as_columns(numbers))
        return replace(self, inputs=inputs, expressions=dict(zip(self.expressions, formulas, strict=True))), numbers

    @property
    def _key(self) -> Hashable:
        # With all digits of their numbers.
        formulas = tuple((name, sympy.srepr(e)) for name, e in self.expressions.items())
        return self.states, self.inputs, formulas, tuple(self.starts.items())


def _additive(formula: sympy.Expr) -> list[tuple[Term, float]]:
    """Split a formula into additive terms with coefficients: F - 2*y gives (F, 1) and (y, -2)."""
    values: dict[sympy.Expr, float] = {}
    for part in sympy.Add.make_args(sympy.expand(formula)):
        value, form = part.as_coeff_Mul()
        values[form] = values.get(form, 0.0) + float(value)
    return [(Term(form), value) for form, value in values.items() if value != 0]
