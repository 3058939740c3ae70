"""Formulas of a simulation whose numbers have names, and their tangents in these."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import sympy

from bayes_greybox.physics.formula.expressions import parse_expression, symbol_names
from bayes_greybox.physics.parameters import Parameter, Parameters, Tangent, bends, moved_to, tangent
from bayes_greybox.physics.terms import Term
from bayes_greybox.running.errors import InputError

from .protocol import KnownTerms, Starts
from .reading import UserSimulation, readable
from .through_states import acting_through


@dataclass(frozen=True)
class NamedFormulas:
    """Formulas by state or output, with the parameters in them; neither where there are no parameters.

    Values of parameters, below, are those that were found; the other parameters have their own. Some starts of hidden
    states may be parameters.
    """

    formulas: Mapping[str, sympy.Expr]
    parameters: Parameters
    starts: Starts = field(default_factory=dict)

    @classmethod
    def of(cls, given: UserSimulation, parameters: Parameters, starts: Starts) -> "NamedFormulas":
        """Read the formulas of a user's simulation."""
        if not parameters:
            return cls({}, {})
        if not readable(given):
            raise InputError(
                "The model has named parameters, which are those of formulas, and its simulation is a function or an "
                "FMU: give formulas, simulation={'y': 'v', 'v': '(F - k*y)/m'}, or put the numbers into the function."
            )
        formulas = {name: parse_expression(str(text)) for name, text in (given or {}).items()}
        found = cls(formulas, parameters, starts)
        for name, each in parameters.items():
            places = found.places(name)
            if not places:
                raise InputError(
                    f"The parameter {name!r} is in no formula of the simulation: write it there, or leave it out."
                )
            if each.learned and name in found.through:
                raise InputError(
                    f"The parameter {name!r} is learned, and a hidden state with a start depends on it, which follows "
                    "nothing that is learned: give it as a number; a study may find it off."
                )
            if each.learned and len(places) > 1:
                raise InputError(
                    f"The parameter {name!r} is learned and stands in the equations of {' and '.join(places)}, each of "
                    "which would learn one of its own: give it as a number, or another name in all but one."
                )
        return found

    def places(self, parameter: str) -> list[str]:
        """Return the equations that a parameter stands in, and those of hidden states that start at it."""
        names = {name: (*symbol_names(formula), self.starts.get(name)) for name, formula in self.formulas.items()}
        return [name for name in names if parameter in names[name]]

    @cached_property
    def through(self) -> frozenset[str]:
        """Parameters that act through hidden states: the model is taken at their values, not along a tangent."""
        return acting_through(self.formulas, self.starts, self.parameters)

    def moved_through(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the changes of parameters that act through hidden states."""
        return {name: value - self.parameters[name].value for name, value in values.items() if name in self.through}

    @cached_property
    def tangents(self) -> dict[str, Tangent]:
        """Tangents by equation, at the values that each parameter is linearised at."""
        return {name: tangent(formula, self.parameters) for name, formula in self.formulas.items()}

    @cached_property
    def learned(self) -> dict[str, dict[str, sympy.Expr]]:
        """Slopes of the parameters that are learned, by equation and parameter."""
        slopes = {
            name: {p: slope for p, slope in each.slopes.items() if self.parameters[p].learned and slope != 0}
            for name, each in self.tangents.items()
        }
        return {name: each for name, each in slopes.items() if each}

    @property
    def curved(self) -> bool:
        """True if a formula is not linear in the parameters that are learned."""
        return any(bends(self.formulas[name], slopes) for name, slopes in self.learned.items())

    def bends(self, equation: str, parameters: Mapping[str, float]) -> bool:
        """Return True if the tangent of an equation is another one where these parameters have moved."""
        if self.through & set(parameters):
            return True
        return equation in self.formulas and bends(self.formulas[equation], parameters)

    def slopes(self, equation: str, values: Mapping[str, float]) -> KnownTerms:
        """Return the slopes of an equation at values of parameters, with the change of each one to there."""
        values = {name: value for name, value in values.items() if name not in self.through}
        if not values or equation not in self.formulas:
            return ()
        found = tangent(self.formulas[equation], moved_to(self.parameters, values)).slopes
        return [
            (Term(found[name], name), value - self.parameters[name].value)
            for name, value in values.items()
            if name in found
        ]

    def remainder(self, equation: str, values: Mapping[str, float]) -> KnownTerms:
        """Return what the tangent at values of parameters adds to that of the model, beside its slopes, if anything.

        Where the model has its tangents at its own values p this is

            g(x, u, p̂) + Σ (p_k − p̂_k) ∂g/∂p_k(x, u, p̂) − g(x, u, p)
        """
        values = {name: value for name, value in values.items() if name not in self.through}
        if not self.bends(equation, values):
            return ()
        formula, believed = self.formulas[equation], {n: replace(each, sd=None) for n, each in self.parameters.items()}
        believed |= {name: Parameter(self.parameters[name].here) for name in self.through}
        there, here = (tangent(formula, each).rest for each in (moved_to(believed, values), believed))
        rest: Any = there - here
        return [(Term(rest, "remainder"), 1.0)] if sympy.expand(rest) != 0 else ()
