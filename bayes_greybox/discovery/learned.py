"""The equations that a study ends with: simulation, what was found, and f where something is left without a name."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.equations.learned import (
    Drawn,
    InnerValue,
    LearnedDiscrepancy,
    LearnedEquation,
    LearnedSystem,
    LearnedTerm,
    Value,
)
from bayes_greybox.model.coefficient import StatedTerms
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.terms import Term
from bayes_greybox.physics.units import coefficient_unit, target_unit
from bayes_greybox.running.errors import InputError

from .answer.amendment import Amendment
from .study import StudyResult

RULE = (
    "Terms: effects that were found, corrections of the likeliest pattern, with the coefficients that they have in it "
    "(tables average over all patterns); f where what is left has no name."
)
"""Which terms stand in an amended equation, with which coefficients, and when f does."""


def studied_system(study: StudyResult) -> LearnedSystem:
    """The equations of the amended model, with the coefficients of the study's tables.

    Args:
        study: The study.
    """
    rows = study.effects.to_dict("records")
    known = {(row["equation"], row["slug"]): row["probability"] for row in rows if row["status"] == "added"}
    known |= dict(zip(study.corrections.index, study.corrections["probability"], strict=True))
    return amended_system(study.base, study.train, study.amendments, known)


def amended_system(
    base: Program,
    data: Trajectories,
    amendments: Mapping[str, Amendment],
    probabilities: Mapping[tuple[str, str], float],
) -> LearnedSystem:
    """The equations of a model with what was added to it.

    An effect has the mean of its inner parameter, and that of its coefficient over all values of it, as tables have
    them. One with hidden states has the one value that they were found with. The simulation's own coefficients are
    corrected as in the commonest pattern of the draws.

    Args:
        base: The model before.
        data: Training data.
        amendments: By equation.
        probabilities: Of effects by equation and slug, of corrections by equation and term.
    """
    for amendment in amendments.values():
        base = amendment.model(base) if amendment.hidden else base
    learned = {
        name: _equation(name, each, data, probabilities, base.stated(name, data) if base.dictionary.get(name) else None)
        for name, each in amendments.items()
    }
    return LearnedSystem("study", base.simulator(data, lacking=True), data, learned, RULE)


def _equation(
    name: str,
    amendment: Amendment,
    data: Trajectories,
    probabilities: Mapping[tuple[str, str], float],
    stated: StatedTerms | None,
) -> LearnedEquation:
    statistics, after, n_own = amendment.statistics, amendment.after, amendment.n_own
    able = np.arange(len(after.draws)) if amendment.alike is None else amendment.alike
    patterns, which, count = np.unique(
        after.draws[able, :n_own] != 0, axis=0, return_inverse=True, return_counts=True
    )  # fmt: skip
    likeliest = int(np.argmax(count))
    alike, active = able[np.ravel(which) == likeliest], patterns[likeliest]
    target, corrected = target_unit(name, data), False
    priors = {} if stated is None else stated.priors
    # A study learns what is left of a coefficient beside its mean.
    expected = {term: prior.mean for term, prior in priors.items() if prior.mean is not None}
    terms, left_out, inner = [], [], []

    def found(called: str, term: Term, draws: Float[np.ndarray, " n_draw"]) -> LearnedTerm:
        unit, probability = _unit(target, term, data), probabilities.get((name, called))
        return LearnedTerm(called, term, Value.of(draws), unit, probability, priors.get(called))

    for k, (index, there) in enumerate(zip(after.indices[:n_own], active, strict=True)):
        column = statistics.columns[index]
        corrected = corrected or column.kind == "correction"
        draws = after.draws[alike if there else able, k] * statistics.target_scale / column.scale
        draws = draws + expected.get(column.formula.name, 0.0) * (column.kind == "free")
        (terms if there else left_out).append(found(column.formula.name, column.formula, draws))
    for k in range(after.inner.shape[1]):
        columns = [statistics.columns[i] for i in after.inner[alike, k]]
        effect, first = columns[0].effect, columns[0]
        assert effect is not None
        scale = statistics.target_scale / np.array([column.scale for column in columns])
        values = {key: Value.of(np.array([column.inner[key] for column in columns])) for key in first.inner}
        means = {key: value.mean for key, value in values.items()}
        # Draws that one model can have share its hidden states, and with them the inner parameter.
        term = first.formula if first.formula.states or not means else effect.term(means)
        terms.append(found(effect.slug, term, after.draws[alike, n_own + k] * scale))
        inner += [_inner(effect, key, value, data) for key, value in values.items()]
    return LearnedEquation(
        terms=tuple(terms),
        left_out=tuple(left_out),
        pattern=float(np.max(count) / np.sum(count)) if corrected else None,
        discrepancy=_discrepancy(amendment),
        drawn=_drawn(amendment, able, expected),
        inner=tuple(inner),
        given=tuple(
            LearnedTerm(term.name, term, Value.exact(value), _unit(target, term, data), None, priors[term.name])
            for term, value in (stated.fixed if stated is not None else ())
        ),
    )


def _unit(target: str, term: Term, data: Trajectories) -> str:
    try:
        return coefficient_unit(target, term, term.units(data.units))
    except InputError:
        # The numbers of a simulation's expression carry units that nobody wrote.
        return ""


def _inner(effect: BoundEffect, name: str, value: Value, data: Trajectories) -> InnerValue:
    inner = next(each for each in effect.effect.inner if each.name == name)
    unit = (data.unit(effect.names[inner.unit_of]) or "") if inner.unit_of else "1"
    if inner.scale == "period":
        unit = data.unit("t") or ""
    elif inner.scale == "frequency":
        unit = f"1/({data.unit('t')})" if data.unit("t") else ""
    return InnerValue(name, effect.slug, inner.meaning, value, unit)


def _discrepancy(amendment: Amendment) -> LearnedDiscrepancy | None:
    f = amendment.discrepancy
    if f is None:
        return None
    known = amendment.statistics
    return LearnedDiscrepancy(known.variables, True, amendment.orthogonal_features, known.target_scale * f.mean)


def _drawn(amendment: Amendment, able: Bool[np.ndarray, " n"] | np.ndarray, expected: Mapping[str, float]) -> Drawn:
    """All draws that one model can have, coefficients with what is expected of them."""
    n_draw, f = len(able), amendment.discrepancy
    # Beside orthogonal features the coefficients are the effects' own.
    added = replace(amendment, discrepancy=None).added(0, n_draw)
    weights = added.weights if f is None else amendment.statistics.target_scale * f.weights(n_draw)
    known = np.array([expected.get(term.name, 0.0) for term in added.terms])
    return Drawn(tuple(added.terms), added.coefficients + known, weights)
