"""The amended model of a study, and the data that it is fitted to."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.coefficient import stated_terms
from bayes_greybox.model.noise.asked import FIT, Noise
from bayes_greybox.model.noise.noise_model import CORRELATED, HEAVY, PROCESS, VARYING
from bayes_greybox.model.program import AnyProgram
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.terms import Term

from .answer.equation_study import EquationStudy
from .grid.noise.points import LATENT_FORCE, SENSOR_NOISE
from .regressors.columns import Column


def amended_program(model: AnyProgram, findings: Mapping[str, EquationStudy], train: Trajectories) -> AnyProgram:
    """The model with the simulation's terms and the found effects as its dictionary, beside its own terms."""
    dictionary: dict[str, list[Term]] = {}
    for name, found in findings.items():
        known = found.regressors
        own = [known.columns[i].formula for i in (*known.of_kind("free"), *known.of_kind("correction"))]
        n_own = len(found.coefficients.indices) - len(found.verdict.labels)
        base = found.coefficients.indices[n_own:]
        added = [_formula(known.columns, i, found.amendment.hidden) for i in base]
        # A dictionary needs a term; an offset is the least that can be asked for.
        stated = model.coefficients.get(name, {})
        parts = stated_terms(model.dictionary[name], stated, tuple(known.rows.columns), name) if stated else None
        given = parts.fixed if parts is not None else []
        # The study's own terms are without what they state, which a copy of the dictionary should have.
        said = {term.name: term for term in parts.all.terms} if parts is not None else {}
        own = [said.get(term.name, term) for term in own]
        dictionary[name] = [*(term for term, _ in given), *([*own, *added] or [Term("1")])]
        # A term of the dictionary is a plain formula: its hidden states are the simulation's.
        dictionary[name] = [replace(term, states=()) for term in dictionary[name]]
        model = model if found.amendment.rows is None else replace(model, rows=found.amendment.rows)
        model = model.remembering(found.amendment.hidden, train)
    named = {name for found in findings.values() for name in _noise(found)}
    if any(found.source.n_sensor > 1 for found in findings.values()):
        # Of several sensors' samples noise of a kind of its own is not found: see `check_asked`.
        named &= {PROCESS}
    if not model.rows.follows_path:
        # What a process in time adds to rates is f's in the posterior.
        named -= {PROCESS}
    if not named:
        return replace(model, dictionary=dictionary)
    noise = model.noise if isinstance(model.noise, Noise) else Noise(scale=model.noise)
    correlation = noise.correlation or (FIT if CORRELATED in named else None)
    # What was found is found again beside all coefficients; what the user asked for stays.
    noise = replace(
        noise,
        correlation=correlation,
        depends_on=noise.depends_on or (FIT if VARYING in named else None),
        tails=noise.tails or (FIT if HEAVY in named else None),
        force=noise.force or (FIT if PROCESS in named and correlation is None else None),
    )
    return replace(model, dictionary=dictionary, noise=noise)


def _noise(found: EquationStudy) -> set[str]:
    """Return what the noise of the answer's likeliest point is called."""
    point = found.near.weighed.grid.points[found.verdict.hypothesis.point]
    names = {LATENT_FORCE: {PROCESS}, SENSOR_NOISE: {CORRELATED}}.get(point.kind, set())
    return names | (set(found.near.rows.point.shapes[point.shape - 1].about) if point.shape else set())


def _formula(columns: Sequence[Column], index: int, hidden: Sequence[HiddenState]) -> Term:
    """The formula of an effect with the value of its inner parameter that its hidden states have."""
    column = columns[index]
    if not column.formula.states or column.effect is None:
        return column.formula
    same = (c.formula for c in columns if c.effect is not None and c.effect.label == column.effect.label)
    return next((each for each in same if set(each.states) <= set(hidden)), column.formula)


def hidden_used(dictionary: Mapping[str, Sequence[Term]], known: Sequence[HiddenState]) -> tuple[HiddenState, ...]:
    """Hidden states that terms use, and those that the rates of these use.

    Args:
        dictionary: Terms by equation.
        known: Hidden states.
    """
    names = {name for terms in dictionary.values() for term in terms for name in term.symbols}
    for _ in known:
        names |= {name for state in known if state.name in names for name in state.symbols}
    return tuple(state for state in known if state.name in names)


def corrected_data(train: Trajectories, findings: Mapping[str, EquationStudy]) -> Trajectories:
    """Data for the amended model; as they came where two equations correct states or inputs differently."""
    each = {name: found.amendment.corrected(train) for name, found in findings.items()}
    first = next(iter(each.values()))
    if any(not np.array_equal(first.column(c), other.column(c)) for other in each.values() for c in first.columns):
        return train
    return replace(first, derivatives={**first.derivatives, **{n: data.derivatives[n] for n, data in each.items()}})
