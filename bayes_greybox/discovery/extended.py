"""The extended model of a study, and the data that it is fitted to."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.coefficient import stated_terms
from bayes_greybox.model.noise.asked import FIT, Noise
from bayes_greybox.model.noise.noise_model import CORRELATED, HEAVY, PROCESS, VARYING
from bayes_greybox.model.program import AnyProgram, Program
from bayes_greybox.physics.hidden_states import HiddenState
from bayes_greybox.physics.parameters import Parameter
from bayes_greybox.physics.terms import Term

from .answer.equation_study import EquationStudy
from .grid.points import LATENT_FORCE, SENSOR_NOISE
from .regressors.columns import Column
from .regressors.regressors import CORRECTION, FREE


def extended_program(model: AnyProgram, findings: Mapping[str, EquationStudy], train: Trajectories) -> AnyProgram:
    """Return the model with the simulation's terms and the added effects as its dictionary, beside its own terms."""
    dictionary: dict[str, list[Term]] = {}
    for name, study in findings.items():
        regressors, indices = study.regressors, study.coefficients.indices
        own = [regressors.columns[i] for i in (*regressors.of_kind(FREE), *regressors.of_kind(CORRECTION))]
        plain = [column.formula for column in own if not column.parameter]
        base = indices[len(indices) - len(study.verdict.labels) :]
        added = [_formula(regressors.columns, i, study.amendment.hidden) for i in base]
        fixed: list[Term] = []
        if stated := model.coefficients.get(name, {}):
            parts = stated_terms(model.dictionary[name], stated, tuple(regressors.rows.columns), name)
            fixed = [term for term, _ in parts.fixed]
            # The study's own terms are without their stated priors, which a copy of the dictionary should have.
            by_name = {term.name: term for term in parts.all.terms}
            plain = [by_name.get(term.name, term) for term in plain]
        model = replace(model, parameters={**model.parameters, **_moved(model, study)})
        # A dictionary needs a term; an offset is the least that can be asked for.
        least = [] if model.learns(name) else [Term("1")]
        terms = [*fixed, *([*plain, *added] or least)]
        # A term of the dictionary is a plain formula: its hidden states are the simulation's.
        dictionary[name] = [replace(term, states=()) for term in terms]
        model = model if study.amendment.rows is None else replace(model, rows=study.amendment.rows)
        model = model.remembering(study.amendment.hidden, train)
    kinds = {name for study in findings.values() for name in _noise(study)}
    if any(study.source.n_sensor > 1 for study in findings.values()):
        # Of several sensors' samples noise of a kind of its own is not found: see `check_asked`.
        kinds &= {PROCESS}
    if not model.rows.follows_path:
        # The posterior's f takes up a process in time that acts on rates.
        kinds -= {PROCESS}
    if not kinds:
        return replace(model, dictionary=dictionary)
    noise = model.noise if isinstance(model.noise, Noise) else Noise(scale=model.noise)
    correlation = noise.correlation or (FIT if CORRELATED in kinds else None)
    # The user's settings stay; the kinds of the study are estimated again beside all coefficients.
    noise = replace(
        noise,
        correlation=correlation,
        depends_on=noise.depends_on or (FIT if VARYING in kinds else None),
        tails=noise.tails or (FIT if HEAVY in kinds else None),
        force=noise.force or (FIT if PROCESS in kinds and correlation is None else None),
    )
    return replace(model, dictionary=dictionary, noise=noise)


def _moved(model: Program, study: EquationStudy) -> dict[str, Parameter]:
    """Return the parameters that the answer moves, learned with the priors that the study weighed them by."""
    moved, regressors = {}, study.regressors
    for name, value in study.near.rows.point.parameters.items():
        parameter = model.parameters[name]
        if len(model.named.places(name)) > 1 or name in model.named.through:
            # One coefficient is of one equation, and no hidden state follows what is learned.
            moved[name] = replace(parameter, value=value)
            continue
        own = next(column for column in regressors.columns if column.parameter == name)
        moved[name] = replace(parameter, sd=parameter.sd or own.sd * regressors.target_scale / own.scale, at=value)
    return moved


def _noise(study: EquationStudy) -> set[str]:
    """Return the kinds of noise at the likeliest noise point of the answer."""
    point = study.near.weighed.grid.points[study.verdict.hypothesis.point]
    kinds = {LATENT_FORCE: {PROCESS}, SENSOR_NOISE: {CORRELATED}}.get(point.kind, set())
    return kinds | (set(study.near.rows.point.shapes[point.shape - 1].about) if point.shape else set())


def _formula(columns: Sequence[Column], index: int, hidden: Sequence[HiddenState]) -> Term:
    """Return the formula of an effect, at the value of its nonlinear parameter that its hidden states have."""
    column = columns[index]
    if not column.formula.states or column.effect is None:
        return column.formula
    same = (c.formula for c in columns if c.effect is not None and c.effect.label == column.effect.label)
    return next((each for each in same if set(each.states) <= set(hidden)), column.formula)


def hidden_used(dictionary: Mapping[str, Sequence[Term]], hidden: Sequence[HiddenState]) -> tuple[HiddenState, ...]:
    """Return the hidden states that terms use, and those that the rates of these use."""
    names = {name for terms in dictionary.values() for term in terms for name in term.symbols}
    for _ in hidden:
        names |= {name for state in hidden if state.name in names for name in state.symbols}
    return tuple(state for state in hidden if state.name in names)


def corrected_data(train: Trajectories, findings: Mapping[str, EquationStudy]) -> Trajectories:
    """Return data for the extended model; as they came if two equations correct states or inputs differently."""
    each = {name: study.amendment.corrected(train) for name, study in findings.items()}
    first = next(iter(each.values()))
    # Each has hidden states of its own.
    measured = [name for name in first.columns if name not in first.computed]
    if any(not np.array_equal(first.column(c), other.column(c)) for other in each.values() for c in measured):
        return train
    return replace(first, derivatives={**first.derivatives, **{n: data.derivatives[n] for n, data in each.items()}})
