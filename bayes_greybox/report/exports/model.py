"""A learned model as other languages need it: what goes in and comes out, coefficients by name, and formulas.

    d(x_i)/dt = g_i(x, u) + Σ_j c_ij φ_ij(x, u)

f is not in it: it has no formula.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import sympy
from sympy.core.function import AppliedUndef

from bayes_greybox.equations.learned import InnerValue, LearnedSystem, LearnedTerm, Value
from bayes_greybox.physics.formula.expressions import symbol_names
from bayes_greybox.physics.units import derivative_unit, per_second, target_unit
from bayes_greybox.running.errors import InputError

from .names import distinct

LONGEST_NAME = 40
"""Characters of the name that a coefficient has at most."""


CORRECTION = "correction, adds to the"
"""How what is said of a correction begins."""


@dataclass(frozen=True)
class Quantity:
    """A state, an input or an output.

    Attributes:
        name: As in the data.
        unit: "" where it is not known.
        said: What it is, in a few words.
        start: Of a state, its value where the data start.
        start_sd: Its standard deviation where it was estimated; None where it was not.
        follows: State whose value it has there; "" for a value of its own.
    """

    name: str
    unit: str
    said: str
    start: float = 0.0
    follows: str = ""
    start_sd: float | None = None


@dataclass(frozen=True)
class Factor:
    """A coefficient.

    Attributes:
        name: What the program calls it: an identifier.
        equation: State or output whose equation has it.
        formula: Its term.
        value: Posterior, in `unit`.
        unit: "1" for a plain number, "" where it is not known.
        probability: Of its term; None where there is none.
        said: What it is, in a few words.
    """

    name: str
    equation: str
    formula: str
    value: Value
    unit: str
    probability: float | None
    said: str

    @property
    def correction(self) -> bool:
        """Whether it corrects a coefficient of the simulation."""
        return self.said.startswith(CORRECTION)


@dataclass(frozen=True)
class Formula:
    """One equation: what is simulated, and terms by the names of their coefficients."""

    name: str
    unit: str
    known: sympy.Expr
    added: tuple[tuple[str, sympy.Expr], ...]


@dataclass(frozen=True)
class Notes:
    """What a reader of the program should know beside its equations.

    Attributes:
        verdict: What the study says, or whether the chains of the fit can be trusted.
        remarks: Sentences, such as what of the measurement is not in the equations.
        discrepancy: By equation, how much of it f is, in words.
        starts: Hidden states with known starts: the state whose value they have there, or "" at rest.
        states: States of the model; None: all that the equations have.
        estimated: Where the data start, by state, as it was estimated with the coefficients.
    """

    verdict: str = ""
    remarks: tuple[str, ...] = ()
    discrepancy: Mapping[str, str] = field(default_factory=dict)
    starts: Mapping[str, str] = field(default_factory=dict)
    states: tuple[str, ...] | None = None
    estimated: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class ExportedModel:
    """A model that is written.

    Attributes:
        origin: "fit" or "study".
        states: In the order of x.
        inputs: In the order of u: the inputs, then states without an equation.
        outputs: Quantities that follow from x and u without a derivative.
        factors: Coefficients, given ones too.
        inner: Inner parameters of terms, by equation; they stand in the formulas as numbers.
        formulas: Of the states, in order, then of the outputs.
        code: What the simulation is in words if it is code, whose rates stand in formulas as the symbols
            `rate_symbol(k)`; "" else.
        time: Unit of time; "" where it is not known.
        rule: Which terms stand in an equation.
        correlations: Pairs of coefficients with their posterior correlation, where that is large.
        notes: What else is said.
    """

    origin: str
    states: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    factors: tuple[Factor, ...]
    inner: tuple[tuple[str, InnerValue], ...]
    formulas: tuple[Formula, ...]
    code: str
    time: str
    rule: str
    correlations: tuple[tuple[str, str, float], ...]
    notes: Notes

    @property
    def rates(self) -> tuple[Formula, ...]:
        """Formulas of the states."""
        return self.formulas[: len(self.states)]

    @property
    def per_second(self) -> float:
        """Units of the data's time in a second: what rates are multiplied by where time must be in seconds."""
        return per_second(self.time)

    @property
    def given(self) -> tuple[Formula, ...]:
        """Formulas of the outputs."""
        return self.formulas[len(self.states) :]

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """States, inputs and outputs."""
        return (*self.states, *self.inputs, *self.outputs)


def rate_symbol(k: int) -> str:
    """Name of the symbol that stands for rate k of a simulation that is code; no column can have it."""
    return f"#{k}"


def exported_model(system: LearnedSystem, notes: Notes) -> ExportedModel:
    """Read learned equations for export.

    A state that has no equation is something that drives the others, an input. Hidden states that belong to no term of
    the answer are left out.

    Args:
        system: The equations.
        notes: What is said with them.

    Raises:
        InputError: There is no equation; one uses something that is neither state nor input.
    """
    if not system.names:
        raise InputError("There is no equation to export: fit a model with a dictionary, or give a simulation.")
    kept = [name for name in system.states if notes.states is None or name in notes.states]
    names = [name for name in system.names if name in kept or system.is_output(name)]
    factors = _named(system, names)
    states = [name for name in kept if name in names]
    formulas = {
        name: _formula(system, states, name, [each for each in factors if each[0].equation == name]) for name in names
    }
    used = {each for formula in formulas.values() for each in _symbols(formula)}
    used |= {notes.starts[name] for name in states if notes.starts.get(name)}
    driving = [*system.inputs, *(name for name in kept if name not in formulas and name in used)]
    unknown = sorted(used - {*states, *driving})
    if unknown:
        raise InputError(
            f"The equations use {unknown[0]!r}, which is neither a state nor an input of the model, and cannot be "
            "exported: add its equation to the simulation."
        )
    outputs = [name for name in names if system.is_output(name)]
    return ExportedModel(
        origin=system.origin,
        states=tuple(_state(system, name, notes) for name in states),
        inputs=tuple(Quantity(name, _unit(system, name), _said_of_input(system, name)) for name in driving),
        outputs=tuple(Quantity(name, target_unit(name, system.data), "output") for name in outputs),
        factors=tuple(factor for factor, _ in factors),
        inner=tuple((name, inner) for name in names if name in system.learned for inner in system.learned[name].inner),
        formulas=tuple(formulas[name] for name in (*states, *outputs)),
        code=system.simulation.code
        if any(name.startswith("#") for each in formulas.values() for name in symbol_names(each.known))
        else "",
        time=system.data.units.get("t", ""),
        rule=system.rule,
        correlations=_correlations(system, factors),
        notes=notes,
    )


def _named(system: LearnedSystem, names: Sequence[str]) -> list[tuple[Factor, LearnedTerm]]:
    """Coefficients with names: of the effect or of the term, with that of the equation where two would be alike."""
    every = [
        (name, each, each in system.learned[name].given)
        for name in names
        if name in system.learned
        for each in (*system.learned[name].given, *system.learned[name].terms)
    ]
    short = [_readable(each.name) for _, each, _ in every]
    wanted = [
        f"k_{text}_{_readable(name)}" if short.count(text) > 1 else f"k_{text}"
        for text, (name, _, _) in zip(short, every, strict=True)
    ]
    taken = {*system.states, *system.inputs, *system.names}
    called = distinct([text[:LONGEST_NAME] for text in wanted], taken)
    return [
        (
            Factor(
                new, name, each.term.text, each.value, each.unit, each.probability, _said(system, name, each, given)
            ),
            each,
        )
        for new, (name, each, given) in zip(called, every, strict=True)
    ]


def _readable(text: str) -> str:
    """A term or a slug as a part of an identifier: y**3*abs(v) becomes y3_abs_v."""
    plain = re.sub(r"[^A-Za-z0-9_]+", "_", text.replace("**", "")).strip("_")
    return plain or "term"


def _said(system: LearnedSystem, name: str, each: LearnedTerm, given: bool) -> str:
    if given:
        return "given, not estimated"
    nominal = {term.expr: value for term, value in system.simulation.additive_terms(name)}
    if each.term.expr in nominal:
        return f"{CORRECTION} {nominal[each.term.expr]:.10g} of the simulation"
    return each.name if each.name != each.term.name else ""


def _formula(
    system: LearnedSystem, states: Sequence[str], name: str, factors: Iterable[tuple[Factor, LearnedTerm]]
) -> Formula:
    simulation = system.simulation
    # Terms with given coefficients are those of the learned equation.
    known: Any = simulation.own_formula(name) if name in system.learned else simulation.formula(name)
    calls = known.atoms(AppliedUndef)
    if calls and name not in states:
        raise InputError(f"The output {name!r} is given by an FMU: it has no formula, and cannot be exported.")
    known = known.xreplace({call: _symbol(states.index(name)) for call in calls})
    added = tuple((factor.name, cast(sympy.Expr, each.term.expr)) for factor, each in factors)
    return Formula(name, target_unit(name, system.data), known, added)


def _symbol(k: int) -> sympy.Symbol:
    return sympy.Symbol(rate_symbol(k), real=True)


def _symbols(formula: Formula) -> set[str]:
    used = {name for part in (formula.known, *(phi for _, phi in formula.added)) for name in symbol_names(part)}
    return {name for name in used if not name.startswith("#")}


def _state(system: LearnedSystem, name: str, notes: Notes) -> Quantity:
    unit, first = _unit(system, name), _first(system, name)
    if name in notes.starts:
        follows = notes.starts[name]
        said = f"hidden, moves along with {follows} where a run starts" if follows else "hidden, starts at rest"
        return Quantity(name, unit, said, (_first(system, follows) or 0.0) if follows else 0.0, follows)
    said = "not measured" if name in system.hidden else "measured"
    if name in notes.estimated:
        found = notes.estimated[name]
        return Quantity(name, unit, said, found.mean, start_sd=found.sd)
    if name in system.hidden:
        known = "unknown" if first is None else "that of a smoothed path and not estimated"
        said += f"; its start is {known}, set your own"
    return Quantity(name, unit, said, first or 0.0)


def _first(system: LearnedSystem, name: str) -> float | None:
    """Where the first run of the data starts; None of what they do not have."""
    # What a hidden state moves along with may be an input.
    column = system.data.states.get(name, system.data.inputs.get(name))
    value = None if column is None or not len(column) else float(column[0])
    return value if value is not None and np.isfinite(value) else None


def _unit(system: LearnedSystem, name: str) -> str:
    unit = system.data.unit(name)
    if unit is not None:
        return unit
    # What is nothing but the rate of another state has its unit.
    of = next((each for each in system.states if system.simulation.rate_name(each) == name), None)
    return derivative_unit(of, system.data.units) if of is not None else ""


def _said_of_input(system: LearnedSystem, name: str) -> str:
    return "input" if name in system.inputs else "state without an equation, which drives the others"


NOTABLE = 0.5
"""From this size on a correlation of two coefficients is said."""

FEWEST = 20
"""Draws below which nothing is said of correlations."""


def _correlations(
    system: LearnedSystem, factors: Sequence[tuple[Factor, LearnedTerm]]
) -> tuple[tuple[str, str, float], ...]:
    """Posterior correlations of coefficients of one equation, over the draws that have just its terms."""
    found = []
    for name, equation in system.learned.items():
        place = {term.name: k for k, term in enumerate(equation.drawn.terms)}
        own = [
            (factor.name, place[each.term.name])
            for factor, each in factors
            if factor.equation == name and each in equation.terms and each.term.name in place
        ]
        if len(own) < len(equation.terms) or len(own) < 2:
            continue
        columns = [k for _, k in own]
        inside = np.isin(np.arange(len(place)), columns)
        draws = equation.drawn.coefficients
        alike = draws if equation.pattern is None else draws[np.all((draws != 0) == inside, axis=1)]
        spread = np.std(alike[:, columns], axis=0) if len(alike) >= FEWEST else np.zeros(len(columns))
        if not np.all(spread > 0):
            continue
        corr = np.corrcoef(alike[:, columns].T)
        found += [
            (own[i][0], own[k][0], float(corr[i, k]))
            for i in range(len(own))
            for k in range(i + 1, len(own))
            if abs(corr[i, k]) >= NOTABLE
        ]
    return tuple(found)
