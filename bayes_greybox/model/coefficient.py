"""Terms of equations and of blocks that share their rows, and the priors of single coefficients."""

import difflib
from collections.abc import Container, Mapping, Sequence
from typing import Any, NamedTuple

from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.physics.formula.expressions import parse_expression, symbol_names
from bayes_greybox.physics.terms import Dictionary, Term, stating, terms_of
from bayes_greybox.running.errors import InputError


class StatedTerms(NamedTuple):
    """The terms of one equation, and the priors that are stated of their coefficients.

    Attributes:
        fixed: Terms that are not learned, with their coefficients.
        known: Terms in the simulation: the fixed ones, and means that are taken off.
        priors: Priors of single terms by name.
    """

    all: Dictionary
    learned: tuple[Term, ...]
    fixed: list[tuple[Term, float]]
    known: list[tuple[Term, float]]
    priors: dict[str, Coefficient]


def stated_terms(terms: Any, stated: Mapping[str, Coefficient], names: Sequence[str], equation: str) -> StatedTerms:
    """Read the terms of one equation and the priors of their coefficients."""
    dictionary = Dictionary.of(terms, names)
    priors = matched(stated, dictionary.names, equation)
    learned = tuple(t for t in dictionary.terms if t.name not in priors or priors[t.name].learned)
    known = [(t, priors[t.name].known) for t in dictionary.terms if t.name in priors]
    fixed = [(t, value) for t, value in known if t not in learned]
    return StatedTerms(dictionary, learned, fixed, [(t, value) for t, value in known if value != 0], priors)


def read_coefficients(stated: Any, dictionary: Mapping[str, Any]) -> dict[str, dict[str, Coefficient]]:
    """Read the priors of single coefficients that a model was given, and those that terms of its dictionary state."""
    example = "{'ydot': {'y**3': bg.priors.Coefficient(sign=-1)}}"
    if not isinstance(stated, Mapping):
        raise InputError(f"GreyBox(coefficients={stated!r}) must map equations to terms, for example {example}.")
    found: dict[str, dict[str, Coefficient]] = {}
    for equation, terms in stated.items():
        if equation not in dictionary:
            raise InputError(
                f"GreyBox(coefficients=...) has priors for {equation!r}, which has no equation in the dictionary; "
                f"equations: {', '.join(dictionary) or 'none'}."
            )
        if not isinstance(terms, Mapping):
            raise InputError(f"GreyBox(coefficients={{{equation!r}: ...}}) must map terms, for example {example}.")
        for term, prior in terms.items():
            if not isinstance(prior, Coefficient):
                raise InputError(
                    f"GreyBox(coefficients=...) has {prior!r} for {term!r} of {equation!r}: give "
                    "bg.priors.Coefficient(...)."
                )
        found[equation] = dict(terms)
    for equation, terms in dictionary.items():
        for term in stating(terms):
            assert term.stated is not None
            priors = found.setdefault(str(equation), {})
            if priors.setdefault(term.name, term.stated) != term.stated:
                raise InputError(
                    f"The coefficient of the term {term.name!r} of {equation!r} is stated twice, {term.stated} and "
                    f"{priors[term.name]}: state it once, in the term or in coefficients=...."
                )
    return found


def matched(stated: Mapping[str, Coefficient], names: Sequence[str], equation: str) -> dict[str, Coefficient]:
    """Return priors by the names of the dictionary's terms, which blanks in a key do not change.

    A key that is no term, or two for one term, are refused.
    """
    found: dict[str, Coefficient] = {}
    for key, prior in stated.items():
        name = key if key in names else "".join(str(key).split())
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise InputError(
                f"GreyBox(coefficients=...) has a prior for {key!r}, which is no term of the dictionary of "
                f"{equation!r}{hint}; terms: {', '.join(names)}."
            )
        if name in found:
            raise InputError(f"The term {name!r} of {equation!r} has two priors of its coefficient: state it once.")
        found[name] = prior
    return found


def centred(stated: Mapping[str, Mapping[str, Coefficient]]) -> dict[str, dict[str, Coefficient]]:
    """Return the priors beside a simulation that has every term with its mean; coefficients with bounds are refused."""
    for equation, terms in stated.items():
        for term, prior in terms.items():
            if prior.bounded:
                raise InputError(
                    f"The evidence of a model has no closed form with bounds on a coefficient, as on {term!r} of "
                    f"{equation!r}: for a study give it mean and sd, or fixed, or leave its prior out; GreyBox.fit "
                    "takes it as it is."
                )
    return {name: {term: prior.centred() for term, prior in terms.items()} for name, terms in stated.items()}


def stated_in_words(stated: Mapping[str, Mapping[str, Coefficient]], several: bool) -> str:
    """Return the priors in a few signs, `y N(-2, 0.1²); y**3 ≤ 0`, with names of equations if there are several."""
    return "; ".join(
        f"{term} of {equation} {prior}" if several else f"{term} {prior}"
        for equation, terms in stated.items()
        for term, prior in terms.items()
    )


def by_block(blocks: Mapping[str, tuple[str, ...]], dictionaries: Mapping[str, Dictionary]) -> dict[str, Dictionary]:
    """Return dictionaries by block, from those by learned state; equations that share their rows have a joint one."""
    return {
        name: dictionaries[name]
        if name in dictionaries
        else Dictionary.joined({each: dictionaries[each] for each in equations})
        for name, equations in blocks.items()
    }


def used_states(
    dictionary: Mapping[str, Any], simulation: Mapping[str, str], columns: Container[str]
) -> tuple[str, ...]:
    """Return learned states without data that another equation uses; one that nothing uses is a slip of the pen."""
    unknown = [name for name in dictionary if name not in columns and name not in simulation]
    if not unknown:
        return ()
    used: dict[str, set[str]] = {name: set(_names(text)) for name, text in simulation.items()}
    for name, terms in dictionary.items():
        used.setdefault(name, set()).update(*(term.symbols for term in terms_of(terms)))
    return tuple(name for name in unknown if any(name in each for state, each in used.items() if state != name))


def _names(text: str) -> tuple[str, ...]:
    return symbol_names(parse_expression(str(text)))
