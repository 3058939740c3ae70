"""Equations and starts of a posterior: its likeliest pattern, with coefficients given that pattern."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from bayes_greybox.criticism.inclusion import ROPE, inclusion
from bayes_greybox.criticism.judged import IDENTIFIABLE_RATIO
from bayes_greybox.criticism.prediction import PREDICTION_DRAWS
from bayes_greybox.inference.path_starts import path_of, start_draws
from bayes_greybox.inference.posterior import Learned, Posterior
from bayes_greybox.inference.remembering import remembered
from bayes_greybox.model.design import EquationDraws
from bayes_greybox.model.exact_program import START_SITE
from bayes_greybox.model.frame import Frame
from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.physics.terms import Term

from .learned import (
    INTERVAL_LEVEL,
    Drawn,
    LearnedDiscrepancy,
    LearnedEquation,
    LearnedSystem,
    LearnedTerm,
    Value,
    parameters_of,
)  # fmt: skip

LIKELY_INSIDE = 0.5
"""Probability to matter from which on a term stands in the equation, under a prior without inclusion."""

DISCREPANCY_ROWS, FEWEST_PATTERN_DRAWS = 500, 10
"""Most rows, evenly spaced, and fewest draws of the likeliest pattern (else those of all) that tell f from zero."""


@remembered
def fitted_system(posterior: Posterior) -> LearnedSystem:
    """Return the equations of a fitted model.

    Under a prior with inclusion the terms are those of the most frequent pattern among the draws, jointly for equations
    that share their rows, and coefficients are those of the draws with this pattern. Under another prior all draws
    count, and a term is left out if it is unlikely to move the rate by more than one per cent of the RMS of its target.
    f stands in an equation if it moves the rate by more than that and is told from zero, by the draws of the same
    pattern, since f depends on the terms beside it.
    """
    table = inclusion(posterior, INTERVAL_LEVEL)
    patterned = "inclusion" in table
    equations: dict[str, LearnedEquation] = {}
    values: dict[str, Value] = {}
    for name, learned in posterior.learned().items():
        part = _Part.of(posterior, learned)
        rows = table.loc[name].loc[list(learned.frame.dictionary.names)]
        inside = part.active if patterned else (rows["outside_rope"] > LIKELY_INSIDE).to_numpy()
        probability = rows["inclusion"].tolist() if patterned else [None] * len(rows)
        stated, units = posterior.model.stated(name, posterior.data), table.loc[name]["unit"]
        every, in_pattern = (
            part.terms(draws, rows["unit"].tolist(), probability, stated.priors)
            for draws in (np.ones(len(part.theta), bool), part.alike)
        )
        named = {term.name: term.value for term in in_pattern if term.term.parameter}
        values |= named
        equations[name] = LearnedEquation(
            terms=tuple(t for t, there in zip(in_pattern, inside, strict=True) if there and t.name not in named),
            left_out=tuple(t for t, there in zip(every, inside, strict=True) if not there and t.name not in named),
            pattern=float(np.mean(part.alike)) if patterned else None,
            discrepancy=part.discrepancy(posterior),
            drawn=Drawn(learned.frame.dictionary.terms, part.theta - part.means(named), part.weight),
            given=tuple(
                LearnedTerm(term.name, term, Value.exact(value), units[term.name], None, stated.priors[term.name])
                for term, value in stated.fixed
            ),
        )
    rule = "Terms: those of the likeliest pattern (tables average over all)"
    if not patterned:
        rule = "Terms: those likely to move the rate by over 1\u00a0% (RMS) of what the simulation leaves"
    rule += "." if posterior.model.discrepancy is None else "; f where it matters as much."
    model = posterior.model.with_values({name: value.mean for name, value in values.items()})
    simulation, parameters = model.simulator(posterior.data, lacking=True), parameters_of(model.parameters, values)
    return LearnedSystem("fit", simulation, posterior.data, equations, rule, parameters)


@dataclass(frozen=True)
class _Part:
    """Draws of one learned state, in user's units; terms of its block's likeliest pattern, and draws that have it."""

    learned: Learned
    theta: Float[np.ndarray, "n_draw n_term"]
    weight: Float[np.ndarray, "n_draw n_basis"]
    active: Bool[np.ndarray, " n_term"]
    alike: Bool[np.ndarray, " n_draw"]

    @classmethod
    def of(cls, posterior: Posterior, learned: Learned) -> "_Part":
        draws, frame = learned.of(posterior.draws(learned.block)), learned.frame
        active = posterior.likeliest_pattern(learned.block)
        alike = np.all(posterior.patterns(learned.block) == active, axis=1)
        weight = np.asarray(draws.weight) * frame.target_scale
        return cls(learned, draws.theta * frame.coefficient_scale, weight, active[learned.columns], alike)

    def terms(
        self, rows: Bool[np.ndarray, " n_draw"], units: Sequence[str], probability: Sequence[float | None],
        stated: Mapping[str, Coefficient],
    ) -> list[LearnedTerm]:  # fmt: skip
        """Return all terms, with the coefficients of some draws."""
        terms: tuple[Term, ...] = self.learned.frame.dictionary.terms
        return [
            LearnedTerm(term.name, term, Value.of(draws), unit, p, stated.get(term.name))
            for term, draws, unit, p in zip(terms, self.theta[rows].T, units, probability, strict=True)
        ]

    def means(self, values: Mapping[str, Value]) -> Float[np.ndarray, " n_term"]:
        """Return the means of named parameters, by term; zero for all other terms."""
        return np.array([values[t.name].mean if t.name in values else 0.0 for t in self.learned.frame.dictionary.terms])

    def discrepancy(self, posterior: Posterior) -> LearnedDiscrepancy | None:
        """Return f given the terms; None if the model has none."""
        frame, design = self.learned.frame, self.learned.equation.design
        if not frame.variables:
            return None
        columns = self.learned.equation.rows.columns
        n_row = len(next(iter(columns.values())))
        index = np.unique(np.linspace(0, n_row - 1, min(n_row, DISCREPANCY_ROWS)).astype(int))
        columns = {name: column[index] for name, column in columns.items()}
        f = np.asarray(design.at(frame, columns, self._draws_of_f(posterior)))
        mean, variance = np.mean(f, axis=0), np.var(f, axis=0)
        size = np.sqrt(np.mean(mean**2))
        left = bool(size > max(ROPE, IDENTIFIABLE_RATIO * np.sqrt(np.mean(variance))))
        features = partial(_features_of, frame) if design.expands else None
        return LearnedDiscrepancy(frame.variables, left, features, self.weight[self.alike].mean(axis=0))

    def _draws_of_f(self, posterior: Posterior) -> EquationDraws:
        """Return draws that tell f from zero, of the likeliest pattern if there are enough."""
        alike = np.flatnonzero(self.alike)
        draws = alike if len(alike) >= FEWEST_PATTERN_DRAWS else np.arange(len(self.alike))
        most = self.learned.equation.design.worthwhile(PREDICTION_DRAWS)
        if len(draws) > most:
            draws = draws[np.linspace(0, len(draws) - 1, most).round().astype(int)]
        # NumPy, because JAX compiles a program for each shape that it indexes.
        every = jax.tree.map(np.asarray, self.learned.of(posterior.draws(self.learned.block)))
        return jax.tree.map(lambda values: values[draws], every)


def _features_of(frame: Frame, columns: Mapping[str, Any]) -> Array | np.ndarray:
    """Return Ψ̃ at columns; a module function, so that it can be pickled."""
    return frame.rows(columns)[1]


@remembered
def estimated_starts(posterior: Posterior) -> Mapping[str, Value]:
    """Return all states at the first sample of the first run, by state; user's units.

    Draws are those of the likeliest pattern, as in the equations of `fitted_system`. There are no starts if rows follow
    no path from its start, or an unknown force moves it.
    """
    model = posterior.model
    if not model.rows.follows_path:
        return {}
    ((block, equation),) = posterior.equations.items()
    if equation.rows.noise.moved:
        return {}
    values = posterior.values(block)
    alike = np.all(posterior.patterns(block) == posterior.likeliest_pattern(block), axis=1)
    if START_SITE in values:
        draws = values[START_SITE][alike]
    else:
        drawn = posterior.draws(block)
        theta, weight, sigma = (np.asarray(each)[alike] for each in (drawn.theta, drawn.weight, drawn.hyper.sigma))
        draws = start_draws(equation, path_of(posterior), theta, weight, sigma, posterior.sampling.seed)
    states = model.simulator(posterior.data).states
    return {name: Value.of(draws[:, 0, k]) for k, name in enumerate(states)}
