"""Learned equations as plain data, from which text, LaTeX, JSON, SymPy and functions are made.

    d(x_i)/dt = g_i(x, u) + Σ_j θ_ij φ_ij(x, u) + f_i(x, u)

An equation has only the terms of the likeliest inclusion pattern, each coefficient with its posterior given that
pattern, so that everything that is printed or exported is the same model.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy
from jaxtyping import Array, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.physics.formula.expressions import symbol_names
from bayes_greybox.physics.formula.grammar import symbol
from bayes_greybox.physics.parameters import Parameters
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.terms import Term

INTERVAL_LEVEL = 0.9
"""Probability of the intervals."""

Features = Callable[[Mapping[str, Array] | Mapping[str, np.ndarray]], Array | np.ndarray]
"""Features of f [n_row, n_basis] at columns, NumPy arrays for NumPy columns."""


@dataclass(frozen=True)
class Value:
    """Posterior of one number: mean, standard deviation (NaN for a single draw), equal-tailed interval."""

    mean: float
    sd: float
    lower: float
    upper: float

    @classmethod
    def exact(cls, number: float) -> "Value":
        """Return the value of a number without uncertainty."""
        return cls(number, 0.0, number, number)

    @classmethod
    def of(cls, draws: Float[np.ndarray, " n_draw"]) -> "Value":
        """Summarise draws."""
        lower, upper = np.quantile(draws, [(1 - INTERVAL_LEVEL) / 2, (1 + INTERVAL_LEVEL) / 2])
        sd = float(np.std(draws, ddof=1)) if len(draws) > 1 else np.nan
        return cls(float(np.mean(draws)), sd, float(lower), float(upper))


@dataclass(frozen=True)
class LearnedTerm:
    """A term with its coefficient.

    Attributes:
        name: Name in tables: that of the term, or the slug of an effect.
        term: Formula, with nonlinear parameters at their means.
        value: Coefficient, in `unit`.
        unit: Unit of the coefficient; "1" for a plain number, "" if unknown.
        probability: P(γ = 1 | y) of a term, or the probability of an effect; None under a prior without inclusion.
        stated: Prior or bounds that the user stated for the coefficient, if any.
    """

    name: str
    term: Term
    value: Value
    unit: str
    probability: float | None
    stated: Coefficient | None = None


@dataclass(frozen=True)
class InnerValue:
    """A nonlinear parameter of an effect, such as the gap of a dead zone; `effect` is the effect's slug."""

    name: str
    effect: str
    meaning: str
    value: Value
    unit: str


@dataclass(frozen=True)
class LearnedParameter:
    """A named parameter of the simulation, whose formulas have its mean; exact unless it was learned, or found off."""

    name: str
    value: Value
    unit: str
    learned: bool


@dataclass(frozen=True)
class LearnedDiscrepancy:
    """The f of one equation, and whether it stands there (`left`).

    Attributes:
        features: Features of f; None if f has no finite expansion.
        mean: Posterior mean of their weights given the terms of the equation, user's units of the rate.
    """

    variables: tuple[str, ...]
    left: bool
    features: Features | None
    mean: Float[np.ndarray, " n_basis"]


@dataclass(frozen=True)
class Drawn:
    """Posterior draws of one equation, of any pattern, user's units.

    Attributes:
        terms: All terms that any draw has; slopes of parameters have a parameter's difference from its mean.
        coefficients: Coefficients of the terms; zero if a draw excludes a term.
        weights: Weights of the features of f; no columns without f.
    """

    terms: tuple[Term, ...]
    coefficients: Float[np.ndarray, "n_draw n_term"]
    weights: Float[np.ndarray, "n_draw n_basis"]


@dataclass(frozen=True)
class LearnedEquation:
    """The learned part of one state's rate, or of an output.

    Attributes:
        terms: Terms of the equation.
        left_out: Excluded terms; their coefficients are those of the whole posterior.
        pattern: Probability of the pattern; None under a prior without inclusion.
        discrepancy: f, if the model has it.
        drawn: Posterior draws.
        inner: Nonlinear parameters of the terms.
        given: Terms with fixed coefficients, which the simulation of the system includes.
    """

    terms: tuple[LearnedTerm, ...]
    left_out: tuple[LearnedTerm, ...]
    pattern: float | None
    discrepancy: LearnedDiscrepancy | None
    drawn: Drawn
    inner: tuple[InnerValue, ...] = ()
    given: tuple[LearnedTerm, ...] = ()


@dataclass(frozen=True)
class LearnedSystem:
    """All equations of a model, including those of the simulation only.

    Attributes:
        origin: "fit" or "study".
        simulation: g, with hidden states, with terms whose coefficients are fixed, and at the means of parameters.
        data: Training data, for names, units and labels.
        learned: Learned parts, by state or output.
        rule: Criteria for the terms in an equation, and for f, in words.
        parameters: Named parameters of the simulation.
    """

    origin: str
    simulation: Simulation
    data: Trajectories
    learned: Mapping[str, LearnedEquation]
    rule: str
    parameters: tuple[LearnedParameter, ...] = ()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states, in the order of x; hidden ones too."""
        return self.simulation.states

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs, in the order of u."""
        return self.simulation.inputs

    @property
    def names(self) -> tuple[str, ...]:
        """States and outputs that have an equation: the states in their order, then the outputs."""
        equations = (*self.simulation.equations, *self.learned)
        states = tuple(name for name in self.states if name in equations)
        return (*states, *dict.fromkeys(name for name in equations if name not in states))

    @property
    def hidden(self) -> tuple[str, ...]:
        """States that no sensor measures."""
        measured = {*(self.data.samples or self.data).state_names} - {*self.simulation.starts}
        return tuple(name for name in self.states if name not in measured)

    @property
    def with_f(self) -> tuple[str, ...]:
        """Learned equations in which f stands."""
        return tuple(name for name, each in self.learned.items() if each.discrepancy and each.discrepancy.left)

    @property
    def shown(self) -> tuple[str, ...]:
        """Equations that are printed: the learned ones, and those of hidden states in their terms."""
        printed = list(self.learned)
        for name in printed:
            used = {used for each in self._terms(name) for used in each.term.symbols}
            # The rate of a hidden state may depend on another one, and so may an output.
            depends = name in self.hidden or self.is_output(name)
            used |= set(symbol_names(self.simulation.formula(name))) if depends else set()
            printed += [state for state in self.hidden if state in used and state not in printed]
        return tuple(printed)

    def is_output(self, name: str) -> bool:
        """Return True if an equation gives a measured quantity, not a rate."""
        return name not in self.states

    def to_sympy(self) -> dict[str, sympy.Expr]:
        """Return the right-hand sides by state or output: g + Σ E[θ_j] φ_j, and f as an undefined function."""
        sides: dict[str, Any] = {}
        for name in self.names:
            terms: list[Any] = [sympy.Float(each.value.mean) * each.term.expr for each in self._terms(name)]
            f = self.learned[name].discrepancy if name in self.with_f else None
            if f is not None:
                terms.append(sympy.Function(f"f_{name}", real=True)(*map(symbol, f.variables)))
            sides[name] = sympy.Add(self.simulation.formula(name), *terms)
        return sides

    def _terms(self, name: str) -> tuple[LearnedTerm, ...]:
        return self.learned[name].terms if name in self.learned else ()


def parameters_of(parameters: Parameters, learned: Mapping[str, Value]) -> tuple[LearnedParameter, ...]:
    """Return named parameters, with the posterior values of those that were learned."""
    return tuple(
        LearnedParameter(name, learned.get(name) or Value.exact(each.value), each.unit or "", name in learned)
        for name, each in parameters.items()
    )
