"""Words of a headline for what is missing: effects by their names, candidates of which one is it, or no name."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bayes_greybox.discovery.answer.instrument import LISTED
from bayes_greybox.discovery.candidates import fault_probability, law_behind, rivals
from bayes_greybox.discovery.decision.probabilities import INSTRUMENT, NO_GAP, STOPS, UNKNOWN_KIND
from bayes_greybox.discovery.decision.reasons import OF_SHAPE, ONE_LAW, ONE_LAW_AND_MORE
from bayes_greybox.discovery.sensor_errors.channels import fault_kind
from bayes_greybox.discovery.study import NO_CATALOGUE, StudyResult
from bayes_greybox.discovery.summary import answer, probability_missing, probability_of_answer
from bayes_greybox.physics.catalogue.names import within

from .formatting import listed, probability_text
from .study import name_of, named_in, remembered, reversed_text

Row = Mapping[str, Any]


class Closed(NamedTuple):
    """Words for the change of the gap by the answer; `denied` where a free run contradicts it."""

    text: str
    denied: bool = False

    def after(self, clause: str, adding: str) -> list[str]:
        """Return it behind a clause, in one sentence unless something contradicts it."""
        if self.denied:
            return [f"{clause}.", self.alone(adding)]
        return [f"{clause}; {adding} {self.text}."]

    def alone(self, adding: str) -> str:
        """Return it as a sentence."""
        return f"{adding[:1].upper()}{adding[1:]} {self.text}."


class Added(NamedTuple):
    """An effect that was added, or several as one law: in words, without its probability, and with it."""

    text: str
    probability: float


def likely(study: StudyResult, text: str, p: float, more: str = "") -> str:
    """Return a clause as sure as its probability makes it, with `more` in the same brackets."""
    inside = [] if p >= study.criteria.named else [f"probability {probability_text(p)}"]
    if inside:
        how = "Most likely" if p >= study.criteria.missing else "Perhaps"
        text = f"{how} {text[0].lower()}{text[1:]}"
    inside += [more] if more else []
    return f"{text} ({'; '.join(inside)})" if inside else text


def missing_in_words(study: StudyResult, closed: Closed) -> list[str]:
    """Return what is missing, under a verdict that something is, and what adding it does."""
    rows = study.effects.query("status == 'added'").to_dict("records")
    if study.verdict == "partly named":
        # What is added beside them and may as well not be is in the tables.
        rows = [row for row in rows if row["probability"] > study.criteria.missing] or rows
    if study.verdict == "one of" and rows:
        return _one_of(study, rows, closed)
    added = _added(study, rows)
    it = "it" if len(added) == 1 else "them"
    if study.verdict == UNKNOWN_KIND or not added:
        too = closed.after(f"{_lacks(study, added)} too", f"adding {it}") if added else []
        return [f"{_without_name(study)}.", *too]
    lacks = _lacks(study, added)
    if study.verdict == "named":
        return closed.after(lacks, f"adding {it}")
    if remembers := "; ".join(text for name in study.maps if (text := remembered(study, name))):
        return closed.after(f"{lacks}, and something else that {remembers}", "adding what has a name")
    # Of several equations another may lack more.
    if len(study.maps) == 1 and study.reasons and all(each.code in OF_SHAPE for each in study.reasons):
        return closed.after(lacks, f"adding {it}")
    if study.against:
        return closed.after(f"{lacks}, but that is not all", f"adding {it}")
    # Older files know no probability of what is missing besides.
    p = max(study.settings.get("rest beside the answer", {}).values(), default=1.0)
    rest = "something else that the catalogue does not have"
    rest = rest if p >= study.criteria.missing else f"perhaps {rest} (probability {probability_text(p)})"
    return closed.after(f"{lacks}, and {rest}", "adding what has a name")


def _lacks(study: StudyResult, added: Sequence[Added]) -> str:
    """Return that the simulation lacks effects, or may lack those that are rather not there."""
    there = [each.text for each in added if each.probability >= study.criteria.missing]
    rather_not = [each.text for each in added if each.probability < study.criteria.missing]
    clauses = [f"{verb} {' and '.join(texts)}" for verb, texts in (("lacks", there), ("may lack", rather_not)) if texts]
    return f"The simulation {', and '.join(clauses)}"


def _added(study: StudyResult, rows: Sequence[Row]) -> list[Added]:
    """Return the effects that were added, in words; those that may be one law together as that law."""
    label, sure, found = study.train.target_label, study.criteria.named, []
    laws: dict[Any, float] = study.quantities["probability"].to_dict() if len(study.quantities) else {}
    doubted = {each.equation for each in study.reasons if each.code in (ONE_LAW, ONE_LAW_AND_MORE)}
    groups: dict[Any, list[Row]] = {}
    for row in rows:
        key = (row["equation"], row.get("quantity", ""))
        if key[0] in doubted and laws.get(key, 0.0) >= sure and row["probability"] < sure:
            groups.setdefault(key, []).append(row)
    for row in rows:
        key = (row["equation"], row.get("quantity", ""))
        group, where, p = groups.get(key, []), label(row["equation"]), float(row["probability"])
        if len(group) > 1 and any(row is each for each in group):
            if row is not group[0]:
                continue
            p = float(laws[key])
            names = listed([f"{within(each['name'])} {probability_text(each['probability'])}" for each in group])
            more = f"; {names} together, or one without a name"
            text = f"a law of {columns_text(key[1])} in {where}"
        else:
            tied = " or ".join(within(name_of(study, slug)) for slug in row["tied_with"])
            more = f", not to be told from {tied}" if tied else ""
            more += f", {turned}" if (turned := reversed_text(row)) else ""
            text = f"{within(named_in(study, row))} in {where}"
        found.append(Added(f"{text} (probability {probability_text(p)}{more})", p))
    return found


def columns_text(quantity: str) -> str:
    """Return the columns that a law depends on."""
    return quantity.replace(", ", " and ") or "no column, a constant,"


def _without_name(study: StudyResult) -> str:
    """Return that something without a name is missing, and what is known of it."""
    label, names = study.train.target_label, list(study.maps)
    nameless = [name for name in names if answer(study, name) == UNKNOWN_KIND] if len(names) > 1 else []
    where = f" in {' and '.join(map(label, nameless))}" if nameless else ""
    # Of several equations those without a name are spoken of here.
    names = nameless or names
    texts = {name: remembered(study, name) for name in names}
    p = probability_of_answer(study) if study.verdict == UNKNOWN_KIND else 1.0
    others = rivals(study, names[0]) if p < study.criteria.missing and len(names) == 1 else []
    # What it is has a probability of its own, given that there is something.
    it = "it" if p >= study.criteria.named or others else "if so, it"
    remembers = "; ".join(
        f"{it} {text} in {label(name)}" if len(names) > 1 else f"{it} {text}" for name, text in texts.items() if text
    )
    shape = "the maps show its shape"
    if remembers:
        shape = remembers if all(texts.values()) else f"{shape}, and {remembers}"
    what = f"Something is missing{where} that the catalogue does not have"
    if study.settings.get("catalogue") == NO_CATALOGUE:
        what = f"Something is missing{where}, for which no effect was weighed"
    if others:
        # A name may be as likely as that there is none.
        candidates = [_hypothesis(study, names[0], name, q) for name, q in [(UNKNOWN_KIND, p), *others]]
        return f"{_something(study, names)}; which effect is open: {_list(candidates)}; {shape}"
    return f"{likely(study, what, p)}; {shape}"


class Candidate(NamedTuple):
    """One of several explanations: in words, its probability, NaN if it has none, and the columns of an effect."""

    text: str
    probability: float
    quantity: str | None = None

    def __str__(self) -> str:
        return self.text if math.isnan(self.probability) else f"{self.text} {probability_text(self.probability)}"


def _list(candidates: Sequence[Candidate], joint: str = ", ") -> str:
    return joint.join(map(str, sorted(candidates, key=lambda each: -np.nan_to_num(each.probability))))


def _something(study: StudyResult, equations: Sequence[str]) -> str:
    p = probability_missing(study, equations)
    what = f"Something is missing in {' and '.join(map(study.train.target_label, equations))}"
    return likely(study, what, p, f"probability {probability_text(p)}" if p >= study.criteria.named else "")


def _one_of(study: StudyResult, rows: Sequence[Row], closed: Closed) -> list[str]:
    """Return what is sure, and between what the rest is open."""
    sure = [row for row in rows if row["probability"] >= study.criteria.named]
    unsure = [row for row in rows if row["probability"] < study.criteria.named]
    faults = [name for name in dict.fromkeys(each for row in rows for each in row["tied_with"]) if fault_kind(name)]
    adding = f"adding {' and '.join(within(named_in(study, row)) for row in rows)}"
    if sure and unsure:
        return [_besides(study, sure, unsure, faults), closed.alone(adding)]
    candidates, equations = _candidates(study, rows), list(dict.fromkeys(row["equation"] for row in rows))
    if len(candidates) < 2 and not sure:
        own = {row["slug"] for row in rows}
        others = [(name, p) for name, p in rivals(study, equations[0]) if not own & set(name.split(" + "))]
        candidates += [_hypothesis(study, equations[0], name, p) for name, p in others]
    law = law_behind(study, equations, [each.quantity for each in candidates]) if len(candidates) > 1 else None
    if law is not None:
        what = f"A law of {columns_text(law[0])} is missing in {study.train.target_label(equations[0])}"
        is_open = "which one is open" if len(rows) == 1 else "its parts are open"
        p = probability_text(law[1])
        return [f"{what} (probability {p}); {is_open}: {_list(candidates)}.", closed.alone(adding)]
    if len(candidates) < 2 or len(rows) > 1:
        # Effects that are found together are no alternatives.
        agreement = min(float(row.get("agreement", math.nan)) for row in rows)
        shares = f" (agreement {probability_text(agreement)})" if agreement < study.criteria.named else ""
        doubt = f"but parts of the record disagree{shares}" if sure else "but that is not sure"
        return [f"{_lacks(study, _added(study, rows))}, {doubt}.", closed.alone(adding)]
    return [f"{_something(study, equations)}; which effect is open: {_list(candidates)}.", closed.alone(adding)]


def _besides(study: StudyResult, sure: Sequence[Row], unsure: Sequence[Row], faults: Sequence[str]) -> str:
    """Return what is sure, and what may be missing besides."""
    candidates = _candidates(study, unsure)
    # That there is nothing besides may be as likely as that it is one of them.
    any_of_them = sum(each.probability for each in candidates if not math.isnan(each.probability))
    lacks = _lacks(study, _added(study, sure))
    if any_of_them >= study.criteria.named and len(candidates) > 1 and not faults:
        return f"{lacks}; something else is missing besides, and which effect is open: {_list(candidates)}."
    # Terms that fit what is left without a name are in the model, and no news.
    likely_at_all = [each for each in candidates if not each.probability < LISTED]
    if not likely_at_all:
        return f"{lacks}; what is added besides has no name."
    return f"{lacks}, and perhaps {_list(likely_at_all, ' or ')}."


def _candidates(study: StudyResult, rows: Sequence[Row]) -> list[Candidate]:
    """Return effects and what is tied with them, each once."""
    equations = {row["equation"] for row in rows}
    instead = study.effects.query("status == 'one of'").to_dict("records")
    every = [*rows, *(row for row in instead if row["equation"] in equations)]
    found = [_effect(study, row) for row in every]
    named = {within(name) for row in every for name in (row["name"], named_in(study, row))}
    for name in dict.fromkeys(name for row in rows for name in row["tied_with"]):
        if fault_kind(name):
            found.append(Candidate(f"an error of the sensor ({name})", fault_probability(study, name)))
        elif within(name_of(study, name)) not in named:
            # Older files may have no row of it.
            found.append(Candidate(within(name_of(study, name)), math.nan))
    return found


def _effect(study: StudyResult, row: Row) -> Candidate:
    turned = f" ({text})" if (text := reversed_text(row)) else ""
    where = f" in {study.train.target_label(row['equation'])}" if len(study.maps) > 1 else ""
    text = f"{within(named_in(study, row))}{turned}{where}"
    return Candidate(text, float(row["probability"]), row.get("quantity"))


def _hypothesis(study: StudyResult, equation: str, name: str, p: float) -> Candidate:
    """Return a hypothesis as a candidate; an effect by itself has its own probability and not that of the set alone."""
    if name in STOPS:
        texts = {UNKNOWN_KIND: "one without a name", NO_GAP: "none", INSTRUMENT: "an error of the measurement instead"}
        return Candidate(texts.get(name, "a coefficient of the simulation instead"), p)
    own = study.effects[(study.effects["slug"] == name) & (study.effects["equation"] == equation)]
    return _effect(study, own.iloc[0].to_dict()) if len(own) else Candidate(within(name_of(study, name)), p)
