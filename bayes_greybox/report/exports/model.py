"""A learned model as other languages need it: inputs and outputs, coefficients by name, and formulas.

    d(x_i)/dt = g_i(x, u) + Σ_j c_ij φ_ij(x, u)

f is not in it: it has no formula.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, cast

import numpy as np
import sympy
from sympy.core.function import AppliedUndef

from bayes_greybox.equations.learned import InnerValue, LearnedSystem, LearnedTerm, Value
from bayes_greybox.physics.formula.expressions import symbol_names
from bayes_greybox.physics.units import derivative_unit, per_second, target_unit
from bayes_greybox.report.exports.printers import distinct, identifiers
from bayes_greybox.report.exports.reserved import C_WORDS, MODELICA_WORDS, PYTHON_WORDS
from bayes_greybox.running.errors import InputError


@dataclass(frozen=True)
class Quantity:
    """A state, an input or an output, as in the data; a state starts where the data do, or where `follows` does.

    A unit is "" where it is not known, `start_sd` None where the start was not estimated.
    """

    name: str
    unit: str
    about: str
    start: float = 0.0
    follows: str = ""
    start_sd: float | None = None


@dataclass(frozen=True)
class Factor:
    """A coefficient, by its identifier in the program, with its term, its posterior in `unit` and its probability.

    A unit is "1" for a plain number, "" where it is not known. `correction` says that it corrects one of the
    simulation. A `parameter` of the simulation, which has no `term`, stands in the formulas by that name.
    """

    name: str
    equation: str
    formula: str
    value: Value
    unit: str
    probability: float | None
    about: str
    correction: bool = False
    parameter: str = ""
    term: LearnedTerm | None = None


@dataclass(frozen=True)
class Formula:
    """One equation: the simulated part, and terms by the names of their coefficients."""

    name: str
    unit: str
    known: sympy.Expr
    added: tuple[tuple[str, sympy.Expr], ...]


@dataclass(frozen=True)
class Notes:
    """Remarks on a program, beside its equations.

    Attributes:
        verdict: Sentence of the study, or verdict on the chains of the fit.
        remarks: Sentences, such as errors of sensors that are not in the equations.
        discrepancy: Share of f in each equation, in words.
        starts: Hidden states with known starts: the state whose value they have there, or "" at rest.
        states: States of the model; None: all that the equations have.
    """

    verdict: str = ""
    remarks: tuple[str, ...] = ()
    discrepancy: Mapping[str, str] = field(default_factory=dict)
    starts: Mapping[str, str] = field(default_factory=dict)
    states: tuple[str, ...] | None = None
    estimated: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class ExportedModel:
    """A model that is exported, of a "fit" or a "study"; a unit is "" where it is not known.

    Attributes:
        states: In the order of x.
        inputs: In the order of u: the inputs, then states without an equation.
        outputs: Quantities that follow from x and u without a derivative.
        inner: Nonlinear parameters of terms, by equation; they stand in the formulas as numbers.
        rates: Formulas of the states, in order; `given` are those of the outputs.
        code: Description of a simulation that is code, whose rates stand in formulas as the symbols
            `rate_symbol(k)`; "" for formulas.
        correlations: Pairs of coefficients with their posterior correlation, where that is large.
    """

    origin: str
    states: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    factors: tuple[Factor, ...]
    inner: tuple[tuple[str, InnerValue], ...]
    rates: tuple[Formula, ...]
    given: tuple[Formula, ...]
    code: str
    time: str
    rule: str
    correlations: tuple[tuple[str, str, float], ...]
    notes: Notes

    @property
    def per_second(self) -> float:
        """Units of the data's time in a second, by which rates are multiplied where time must be in seconds."""
        return per_second(self.time)

    @property
    def formulas(self) -> tuple[Formula, ...]:
        """Formulas of the states, then of the outputs."""
        return (*self.rates, *self.given)

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """States, inputs and outputs."""
        return (*self.states, *self.inputs, *self.outputs)


def rate_symbol(k: int) -> str:
    """Return the symbol for rate k of a simulation that is code; no column can have its name."""
    return f"#{k}"


def exported_model(system: LearnedSystem, notes: Notes) -> ExportedModel:
    """Return learned equations as they are exported.

    A state that has no equation is something that drives the others, an input. Hidden states that belong to no term of
    the answer are left out.

    Raises:
        InputError: There is no equation; one uses something that is neither state nor input.
    """
    if not system.names:
        raise InputError("There is no equation to export: fit a model with a dictionary, or give a simulation.")
    kept = [name for name in system.states if notes.states is None or name in notes.states]
    names = [name for name in system.names if name in kept or system.is_output(name)]
    factors = _factors(system, names)
    states = [name for name in kept if name in names]
    formulas = {name: _formula(system, states, name, factors) for name in names}
    parts = [part for each in formulas.values() for part in (each.known, *(phi for _, phi in each.added))]
    used = {symbol for part in parts for symbol in symbol_names(part) if not symbol.startswith("#")}
    follows = {**notes.starts, **system.simulation.starts}
    used |= {start for name in states if isinstance(start := follows.get(name), str) and start}
    drives = "state without an equation, which drives the others"
    driving = dict.fromkeys((name for name in kept if name not in formulas and name in used), drives)
    driving = {**dict.fromkeys(system.inputs, "input"), **driving}
    unknown = sorted(used - {*states, *driving, *(each.parameter for each in factors)})
    if unknown:
        raise InputError(
            f"The equations use {unknown[0]!r}, which is neither a state nor an input of the model, and cannot be "
            "exported: add its equation to the simulation."
        )
    outputs = [name for name in names if system.is_output(name)]
    coded = any(name.startswith("#") for each in formulas.values() for name in symbol_names(each.known))
    return ExportedModel(
        origin=system.origin,
        states=tuple(_state(system, name, notes) for name in states),
        inputs=tuple(Quantity(name, _unit(system, name), about) for name, about in driving.items()),
        outputs=tuple(Quantity(name, target_unit(name, system.data), "output") for name in outputs),
        factors=factors,
        inner=tuple((name, inner) for name in names if name in system.learned for inner in system.learned[name].inner),
        rates=tuple(formulas[name] for name in states),
        given=tuple(formulas[name] for name in outputs),
        code=system.simulation.code if coded else "",
        time=system.data.units.get("t", ""),
        rule=system.rule,
        correlations=tuple(_correlations(system, factors)),
        notes=notes,
    )


def _factors(system: LearnedSystem, names: Sequence[str]) -> tuple[Factor, ...]:
    """Return coefficients with distinct names: of the effect or the term, with the equation where two are alike."""
    learned = {name: system.learned[name] for name in names if name in system.learned}
    every = [(name, term) for name, equation in learned.items() for term in (*equation.given, *equation.terms)]
    short = [_readable(term.name) for _, term in every]
    wanted = [
        f"k_{text}_{_readable(name)}" if short.count(text) > 1 else f"k_{text}"
        for text, (name, _) in zip(short, every, strict=True)
    ]
    taken = {*system.states, *system.inputs, *system.names}
    called = distinct([text[:40] for text in wanted], taken)
    # Parameters keep their names, but for those that mean something in a language.
    reserved = {*taken, *called, *PYTHON_WORDS, *C_WORDS, *MODELICA_WORDS}
    parameters = identifiers([each.name for each in system.parameters], reserved)
    about = {True: "", False: "given, not estimated"}
    factors = [
        Factor(parameters[p.name], "", p.name, p.value, p.unit, None, about[p.learned], parameter=p.name)
        for p in system.parameters
    ]
    for new, (name, term) in zip(called, every, strict=True):
        words = _about(system, name, term, term in learned[name].given)
        factors.append(Factor(new, name, term.term.text, term.value, term.unit, term.probability, *words, term=term))
    return tuple(factors)


def _readable(text: str) -> str:
    """Return a term or a slug as a part of an identifier: y**3*abs(v) becomes y3_abs_v."""
    return re.sub(r"[^A-Za-z0-9_]+", "_", text.replace("**", "")).strip("_") or "term"


def _about(system: LearnedSystem, name: str, each: LearnedTerm, given: bool) -> tuple[str, bool]:
    """Return the description of a coefficient, and whether it corrects one of the simulation."""
    if given:
        return "given, not estimated", False
    nominal = {term.expr: value for term, value in system.simulation.additive_terms(name)}
    if each.term.expr in nominal:
        return f"correction, adds to the {nominal[each.term.expr]:.10g} of the simulation", True
    return each.name if each.name != each.term.name else "", False


def _formula(system: LearnedSystem, states: Sequence[str], name: str, factors: Sequence[Factor]) -> Formula:
    simulation = system.simulation
    # Terms with given coefficients are those of the learned equation.
    names = [each.name for each in system.parameters]
    known: Any = simulation.own_formula(name) if name in system.learned else simulation.in_parameters(name, names)
    calls = known.atoms(AppliedUndef)
    if calls and name not in states:
        raise InputError(f"The output {name!r} is given by an FMU: it has no formula, and cannot be exported.")
    known = known.xreplace({call: sympy.Symbol(rate_symbol(states.index(name)), real=True) for call in calls})
    own = [(each.name, each.term) for each in factors if each.equation == name]
    added = tuple((called, cast(sympy.Expr, term.term.expr)) for called, term in own if term is not None)
    return Formula(name, target_unit(name, system.data), known, added)


def _state(system: LearnedSystem, name: str, notes: Notes) -> Quantity:
    unit, first = _unit(system, name), _first(system, name)
    starts = {**notes.starts, **system.simulation.starts}
    if name in starts:
        follows = starts[name]
        if not isinstance(follows, str):
            return Quantity(name, unit, "hidden, with a known start", follows)
        about = f"hidden, moves along with {follows} where a run starts" if follows else "hidden, starts at rest"
        return Quantity(name, unit, about, (_first(system, follows) or 0.0) if follows else 0.0, follows)
    about = "not measured" if name in system.hidden else "measured"
    if name in notes.estimated:
        start = notes.estimated[name]
        return Quantity(name, unit, about, start.mean, start_sd=start.sd)
    if name in system.hidden:
        known = "unknown" if first is None else "that of a smoothed path and not estimated"
        about += f"; its start is {known}, set your own"
    return Quantity(name, unit, about, first or 0.0)


def _first(system: LearnedSystem, name: str) -> float | None:
    """Return a column's value where the first run starts; None where the data do not have it."""
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


def _correlations(system: LearnedSystem, factors: Sequence[Factor]) -> Iterator[tuple[str, str, float]]:
    """Yield large posterior correlations of coefficients of one equation, over the draws that have just its terms."""
    for name, equation in system.learned.items():
        place = {term.name: k for k, term in enumerate(equation.drawn.terms)}
        placed = {
            each.name: place[each.term.name]
            for each in factors
            if each.equation == name and each.term in equation.terms and each.term.name in place
        }
        columns = list(placed.values())
        if len(columns) < max(len(equation.terms), 2):
            continue
        draws = equation.drawn.coefficients
        inside = np.isin(np.arange(len(place)), columns)
        alike = draws if equation.pattern is None else draws[np.all((draws != 0) == inside, axis=1)]
        # Of fewer draws a correlation says nothing.
        if len(alike) < 20 or not np.all(np.std(alike[:, columns], axis=0) > 0):
            continue
        corr = np.corrcoef(alike[:, columns].T)
        for (i, first), (k, second) in combinations(enumerate(placed), 2):
            if abs(corr[i, k]) >= 0.5:
                yield first, second, float(corr[i, k])
