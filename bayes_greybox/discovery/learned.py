"""The equations of a study's extended model: simulation, effects, and f if a discrepancy has no name."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.equations.learned import (
    Drawn,
    InnerValue,
    LearnedDiscrepancy,
    LearnedEquation,
    LearnedSystem,
    LearnedTerm,
    Value,
    parameters_of,
)
from bayes_greybox.model.program import Program
from bayes_greybox.physics.catalogue.effects import BoundEffect
from bayes_greybox.physics.terms import Term
from bayes_greybox.physics.units import target_unit

from .answer.amendment import Amendment
from .answer.equation_study import unit_if_known
from .regressors.regressors import CORRECTION, FREE
from .study import StudyResult

ByTerm = Mapping[tuple[str, str], float]
"""Probabilities by equation and term."""


def studied_system(study: StudyResult) -> LearnedSystem:
    """Return the equations of the extended model, with the coefficients of the study's tables."""
    rows = study.effects.to_dict("records")
    probabilities = {(row["equation"], row["slug"]): row["probability"] for row in rows if row["status"] == "added"}
    probabilities |= dict(zip(study.corrections.index, study.corrections["probability"], strict=True))
    return extended_system(study.base, study.train, study.amendments, probabilities)


def shown_effects(study: StudyResult) -> pd.DataFrame:
    """Return the table of effects with the coefficients of the equations: those of the likeliest pattern."""
    table: Any = study.effects.copy()
    if not len(table) or not study.amendments:
        return table
    terms = {name: list(each.terms) for name, each in studied_system(study).learned.items()}
    for place in table.index[table["status"] == "added"]:
        alike = [term for term in terms.get(table.at[place, "equation"], ()) if term.name == table.at[place, "slug"]]
        if alike:
            value = alike[0].value
            table.loc[place, ["mean", "sd", "lower", "upper"]] = value.mean, value.sd, value.lower, value.upper
            # The same effect on other columns has a term of its own.
            terms[table.at[place, "equation"]].remove(alike[0])
    return table


def shown_corrections(study: StudyResult) -> pd.DataFrame:
    """Return the table of corrections with the values of parameters that the equations have, as `shown_effects`."""
    table: Any = study.corrections.copy()
    if "parameter" not in table or not getattr(study, "amendments", None):
        return table
    values = {each.name: each.value for each in studied_system(study).parameters if each.learned}
    for place in table.index[table["parameter"].astype(bool)]:
        value = values.get(place[-1])
        if value is not None:
            now = np.array([value.mean, value.lower, value.upper]) - table.at[place, "nominal"]
            table.loc[[place], ["mean", "lower", "upper"]] = now
            table.loc[[place], "sd"] = value.sd
    return table


def extended_system(
    base: Program, data: Trajectories, amendments: Mapping[str, Amendment], probabilities: ByTerm
) -> LearnedSystem:
    """Return the equations of a model with its amendments.

    An effect has the mean of its nonlinear parameter, and that of its coefficient over all values of it, as tables have
    them; one with hidden states the one value that they were found with.
    """
    for amendment in amendments.values():
        # Formulas have the parameters themselves.
        base = replace(amendment, parameters={}, slopes=()).model(base) if amendment.hidden else base
    values: dict[str, Value] = {}
    for amendment in amendments.values():
        values |= _parameters(amendment, base)
    learned = {name: _equation(name, each, base, data, probabilities) for name, each in amendments.items()}
    simulation = base.with_values({name: value.mean for name, value in values.items()}).simulator(data, lacking=True)
    # True where the commonest pattern corrects a coefficient of the simulation.
    corrected = any(
        there and each.statistics.columns[index].kind == CORRECTION
        for each in amendments.values()
        for index, there in zip(each.after.indices[: each.after.n_own], _pattern(each)[0], strict=True)
    )
    rules = ["Corrections are those of the likeliest pattern (tables average over all)."] if corrected else []
    unnamed = any(each.discrepancy and each.discrepancy.left for each in learned.values())
    rules += ["f is what is left without a name."] if unnamed else []
    return LearnedSystem("study", simulation, data, learned, " ".join(rules), parameters_of(base.parameters, values))


def _pattern(amendment: Amendment) -> tuple[Bool[np.ndarray, " n_own"], Int[np.ndarray, " n"], float]:
    """Return which of the model's own columns are in the commonest pattern, the draws with it, and its share."""
    after, able = amendment.after, amendment.able
    in_draws = after.draws[able, : after.n_own] != 0
    patterns, which, count = np.unique(in_draws, axis=0, return_inverse=True, return_counts=True)
    likeliest = int(np.argmax(count))
    return patterns[likeliest], able[np.ravel(which) == likeliest], float(count[likeliest] / np.sum(count))


def _parameters(amendment: Amendment, base: Program) -> dict[str, Value]:
    statistics, after = amendment.statistics, amendment.after
    active, alike, _ = _pattern(amendment)
    columns = [statistics.columns[index] for index in after.indices[: after.n_own]]
    return {
        c.parameter: Value.of(base.parameters[c.parameter].value + draws * statistics.target_scale / c.scale)
        for c, there, draws in zip(columns, active, after.draws[alike].T[: after.n_own], strict=True)
        if there and c.parameter
    }


def _equation(
    name: str, amendment: Amendment, base: Program, data: Trajectories, probabilities: ByTerm
) -> LearnedEquation:
    stated = base.stated(name, data) if base.learns(name) else None
    statistics, after, n_own, able = amendment.statistics, amendment.after, amendment.after.n_own, amendment.able
    active, alike, share = _pattern(amendment)
    target, scale = target_unit(name, data), statistics.target_scale
    priors = {} if stated is None else stated.priors
    # A study learns a coefficient's difference from its stated mean.
    means = {term: prior.mean for term, prior in priors.items() if prior.mean is not None}

    def learned(called: str, term: Term, draws: Float[np.ndarray, " n_draw"]) -> LearnedTerm:
        unit, probability = unit_if_known(target, term, data), probabilities.get((name, called))
        return LearnedTerm(called, term, Value.of(draws), unit, probability, priors.get(called))

    terms, left_out, inner = [], [], []
    columns = [statistics.columns[index] for index in after.indices[:n_own]]
    for k, (column, there) in enumerate(zip(columns, active, strict=True)):
        if column.parameter:
            continue
        draws = after.draws[alike if there else able, k] * scale / column.scale
        draws = draws + means.get(column.formula.name, 0.0) * (column.kind == FREE)
        (terms if there else left_out).append(learned(column.formula.name, column.formula, draws))
    for k in range(after.inner.shape[1]):
        values_of = [statistics.columns[i] for i in after.inner[alike, k]]
        effect, formula = values_of[0].effect, values_of[0].formula
        assert effect is not None
        values = {key: Value.of(np.array([column.inner[key] for column in values_of])) for key in values_of[0].inner}
        if formula.states:
            # Draws that one model can have share its hidden states, and with them the nonlinear parameter, which all
            # draws know no better than this.
            every = [statistics.columns[i].inner for i in after.inner[:, k]]
            known = {key: Value.of(np.array([inner[key] for inner in every])) for key in values}
            values = {key: replace(known[key], mean=value.mean) for key, value in values.items()}
        term = formula if formula.states or not values else effect.term({k: v.mean for k, v in values.items()})
        draws = after.draws[alike, n_own + k] * (scale / np.array([column.scale for column in values_of]))
        terms.append(learned(effect.slug, term, draws))
        inner += [_inner(effect, key, value, data) for key, value in values.items()]
    given = [
        LearnedTerm(term.name, term, Value.exact(value), unit_if_known(target, term, data), None, priors[term.name])
        for term, value in (stated.fixed if stated is not None else ())
    ]
    discrepancy, f = None, amendment.discrepancy
    if f is not None:
        discrepancy = LearnedDiscrepancy(statistics.variables, True, amendment.orthogonal_features, scale * f.mean)
    return LearnedEquation(
        terms=tuple(terms),
        left_out=tuple(left_out),
        pattern=share if any(c.kind == CORRECTION for c in columns) else None,
        discrepancy=discrepancy,
        drawn=_drawn(amendment, means),
        inner=tuple(inner),
        given=tuple(given),
    )


def _inner(effect: BoundEffect, name: str, value: Value, data: Trajectories) -> InnerValue:
    inner, time = next(each for each in effect.effect.inner if each.name == name), data.unit("t") or ""
    unit = (data.unit(effect.names[inner.unit_of]) or "") if inner.unit_of else "1"
    unit = {"period": time, "record": time, "frequency": time and f"1/({time})"}.get(inner.scale, unit)
    return InnerValue(name, effect.slug, inner.meaning, value, unit)


def _drawn(amendment: Amendment, means: Mapping[str, float]) -> Drawn:
    """Return all draws that one model can have, the coefficients with their stated means."""
    n_draw, f = len(amendment.able), amendment.discrepancy
    # Beside orthogonal features the coefficients are the effects' own.
    added = replace(amendment, discrepancy=None, remainder=()).added(0, n_draw)
    weights = added.weights if f is None else amendment.statistics.target_scale * f.weights(n_draw)
    # The simulation has the means of its parameters; hidden states follow these, and nothing else.
    plain = [k for k, term in enumerate(added.terms) if not (term.parameter and term.states)]
    added = added._replace(terms=[added.terms[k] for k in plain], coefficients=added.coefficients[:, plain])
    named = [k for k, term in enumerate(added.terms) if term.parameter]
    stated = np.array([means.get(term.name, 0.0) * (not term.parameter) for term in added.terms])
    coefficients = added.coefficients + stated
    coefficients[:, named] -= np.mean(coefficients[:, named], axis=0)
    return Drawn(tuple(added.terms), coefficients, weights)
