"""The verdict of a study in one sentence."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from bayes_greybox.discovery.answer.instrument import IN_MODEL
from bayes_greybox.discovery.decision.criteria import CRITERIA, Criteria
from bayes_greybox.discovery.decision.probabilities import UNKNOWN_KIND
from bayes_greybox.discovery.decision.reasons import OF_SHAPE, ONE_LAW, ONE_LAW_AND_MORE
from bayes_greybox.discovery.decision.vetoes import worse_in_words
from bayes_greybox.discovery.sensor_errors.channels import LAG, fault_kind
from bayes_greybox.discovery.study import NO_CATALOGUE, StudyResult
from bayes_greybox.discovery.summary import (
    CommonFactor,
    answer,
    by_common_factor,
    corrections_above,
    gap_change,
    not_weighed,
    probability_missing,
    probability_of_answer,
    sensors_like,
)
from bayes_greybox.physics.catalogue.names import within

from .doubts import role_text
from .formatting import estimate, formula, listed, number, numbers_in, probability_text, share_text, unit_text
from .study import closed_share, name_of, named_in, remembered, reversed_text, risen


def sentence(study: StudyResult) -> str:
    """Return the verdict so that someone who never heard of evidence knows what to do.

    What was found of the measurement, and what speaks against the verdict, follow it.
    """
    parts = [_answer(study)]
    measured = measurement_in_words(study)
    if measured and study.verdict != "instrument":
        parts.append(f"Of the measurement: {'; '.join(measured)}.")
    if study.verdict == UNKNOWN_KIND:
        # What is missing may be among them.
        parts += [f"{role_text(role, count)}." for role, count in not_weighed(study).items()]
    if study.against:
        parts.append(f"Against it: {'; '.join(study.against)}.")
    return " ".join(parts)


def measurement_in_words(study: StudyResult) -> list[str]:
    """Return what the study takes for true about sensors and noise."""
    if not len(study.instrument):
        return []
    # Several equations may be judged on the samples of one sensor.
    texts = study.instrument.loc[study.instrument["status"] == IN_MODEL, "text"]
    return [numbers_in(text) for text in dict.fromkeys(texts)]


def closed_in_words(gap: pd.DataFrame, what: str = "the rate", criteria: Criteria = CRITERIA) -> str:
    """Return what became of the gap, on held-out data where the rates were measured there."""
    change = gap_change(gap, criteria)
    where = "held-out data" if change.part == "test" else "the training data"
    if change.code == "none shown":
        # Next to nothing, whatever multiple of it is left; what precise data show of a small gap may well be closed.
        return f"closes no gap on {where}, which show none"
    if change.code == "none before":
        return f"leaves {share_text(change.after)} of {what} on {where} unexplained, where nothing was before"
    ratio = change.after / change.before
    runs = " and ".join(worse_in_words(key) for key in change.worse)
    if change.idle and not runs:
        runs = f"the free run of {listed(change.idle)} does not get better"
    if runs:
        # Nothing is called closed that free runs deny.
        return {
            "unchanged": f"leaves what is unexplained of {what} on {where} as it is, and {runs}",
            "wider": f"raises what is unexplained of {what} on {where} {risen(ratio)}, and {runs}",
            "closed": f"lowers what is unexplained of {what} on {where} by {closed_share(1 - ratio)}, but {runs}",
        }[change.code]
    return {
        "unchanged": f"leaves the gap on {where} as it is",
        "wider": f"widens the gap on {where} {risen(ratio)}",
        "closed": f"closes {closed_share(1 - ratio)} of the gap on {where}",
    }[change.code]


def _answer(study: StudyResult) -> str:
    criteria, verdict = study.criteria, study.verdict
    closed = closed_in_words(study.gap, study.train.target_in_words(*study.maps, article="the "), study.criteria)
    if verdict == "no gap":
        if left := _left_in_practice(study):
            return f"Nothing of size is missing: simulation and measurements agree.{left}"
        clause = _likely(study, "Nothing is missing", probability_of_answer(study))
        return f"{clause}: simulation and measurements agree to within the noise."
    if verdict == "instrument":
        clause = _likely(study, "No effect is missing, it is the measurement", probability_of_answer(study))
        return f"{clause}: {'; '.join(measurement_in_words(study)) or 'what of it the data cannot say'}."
    off = corrections_above(study, criteria.missing)
    if verdict == "recalibrate":
        return _recalibrate(study, off, closed)
    if any(row["probability"] >= criteria.named and answer(study, row["equation"]) != UNKNOWN_KIND for row in off):
        # Most of a gap may be a coefficient's, whatever is added.
        closed = f"and setting {'a coefficient' if len(off) == 1 else 'coefficients'} right {closed}"
    besides = ""
    if off:
        word = _number_word(off)
        what = f"A {word} of the simulation is" if len(off) == 1 else f"{word.capitalize()}s of the simulation are"
        besides = f" {what} off besides: {'; '.join(_should_be(study, row) for row in off)}."
    return f"{_missing(study, closed)}{besides}"


def _likely(study: StudyResult, text: str, p: float, more: str = "") -> str:
    """Return a clause as sure as its probability makes it, with `more` in the same brackets."""
    inside = [] if p >= study.criteria.named else [f"probability {probability_text(p)}"]
    if inside:
        how = "Most likely" if p >= study.criteria.missing else "Perhaps"
        text = f"{how} {text[0].lower()}{text[1:]}"
    inside += [more] if more else []
    return f"{text} ({'; '.join(inside)})" if inside else text


def _recalibrate(study: StudyResult, off: Sequence[Mapping[str, Any]], closed: str) -> str:
    right = "; ".join(
        _by_one_factor(study, each) if isinstance(each, CommonFactor) else _should_be(study, each)
        for each in by_common_factor(study, off)
    )
    one = len(off) == 1
    word = _number_word(off)
    what = f"a {word} of the simulation is" if one else f"{word}s of the simulation are"
    clause = f"No effect is missing; {what} off"
    unsaid = "which one the data cannot say"
    if not off and (tied := tied_parameters(study)):
        clause, unsaid = "No effect is missing; a parameter of the simulation is off", f"{tied}, {unsaid}"
    clause = _likely(study, clause, probability_of_answer(study), right or unsaid)
    return f"{clause}, and setting {'it' if one else 'them'} right {closed}.{_left_in_practice(study)}"


def _left_in_practice(study: StudyResult) -> str:
    """Return a sentence about what remains without a name where it is too small to matter; "" where nothing does."""
    practical = [name for name, small in study.settings.get("agree in practice", {}).items() if small]
    if not practical:
        return ""
    remains = "; ".join(text for name in practical if (text := remembered(study, name)))
    kind = f"; it {remains}" if remains else ""
    return f" What is left is below {share_text(study.criteria.negligible)} of what is modelled{kind}."


def _added(study: StudyResult, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the effects that were added, in words; those that may be one law together as that law."""
    label, sure, texts = study.train.target_label, study.criteria.named, []
    laws: dict[Any, float] = study.quantities["probability"].to_dict() if len(study.quantities) else {}
    doubted = {each.equation for each in study.reasons if each.code in (ONE_LAW, ONE_LAW_AND_MORE)}
    groups: dict[Any, list[Mapping[str, Any]]] = {}
    for row in rows:
        key = (row["equation"], row.get("quantity", ""))
        if key[0] in doubted and laws.get(key, 0.0) >= sure and row["probability"] < sure:
            groups.setdefault(key, []).append(row)
    for row in rows:
        key = (row["equation"], row.get("quantity", ""))
        group = groups.get(key, [])
        if len(group) > 1 and any(row is each for each in group):
            if row is not group[0]:
                continue
            names = [f"{within(each['name'])} {probability_text(each['probability'])}" for each in group]
            of = key[1].replace(", ", " and ") or "nothing, a constant,"
            p, where = probability_text(laws[key]), label(row["equation"])
            texts.append(f"a law of {of} in {where} (probability {p}; {listed(names)} together, or one without a name)")
            continue
        tied = " or ".join(within(name_of(study, slug)) for slug in row["tied_with"])
        tied = f", not to be told from {tied}" if tied else ""
        turned = f", {turned}" if (turned := reversed_text(row)) else ""
        p = probability_text(row["probability"])
        texts.append(f"{within(named_in(study, row))} in {label(row['equation'])} (probability {p}{tied}{turned})")
    return texts


def _missing(study: StudyResult, closed: str) -> str:
    """Return what is missing, under a verdict that something is."""
    rows = study.effects.query("status == 'added'").to_dict("records")
    if study.verdict == "partly named":
        # What is added beside them and may as well not be is in the tables.
        rows = [row for row in rows if row["probability"] > study.criteria.missing] or rows
    texts = _added(study, rows)
    it = "it" if len(texts) == 1 else "them"
    if study.verdict == UNKNOWN_KIND or not texts:
        unnamed = _without_name(study)
        too = f" The simulation lacks {' and '.join(texts)} too; adding {it} {closed}." if texts else ""
        return f"{unnamed}.{too}"
    if study.verdict == "one of":
        return _one_of(study, rows, texts, closed)
    lacks = f"The simulation lacks {' and '.join(texts)}"
    if study.verdict == "named":
        return f"{lacks}; adding {it} {closed}."
    if remembers := "; ".join(text for name in study.maps if (text := remembered(study, name))):
        return f"{lacks}, and something else that {remembers}; adding what has a name {closed}."
    # Of several equations another may lack more.
    if len(study.maps) == 1 and study.reasons and all(each.code in OF_SHAPE for each in study.reasons):
        return f"{lacks}; adding {it} {closed}."
    if study.against:
        return f"{lacks}, but that is not all; adding {it} {closed}."
    return f"{lacks}, and {_rest(study)}; adding what has a name {closed}."


def _without_name(study: StudyResult) -> str:
    """Return that something without a name is missing, and what is known of it."""
    label, names = study.train.target_label, list(study.maps)
    nameless = [name for name in names if answer(study, name) == UNKNOWN_KIND] if len(names) > 1 else []
    where = f" in {' and '.join(map(label, nameless))}" if nameless else ""
    # Of several equations those without a name are spoken of here.
    names = nameless or names
    texts = {name: remembered(study, name) for name in names}
    remembers = "; ".join(
        f"it {text} in {label(name)}" if len(names) > 1 else f"it {text}" for name, text in texts.items() if text
    )
    shape = "the maps show its shape"
    if remembers:
        shape = remembers if all(texts.values()) else f"{shape}, and {remembers}"
    what = f"Something is missing{where} that the catalogue does not have"
    if study.settings.get("catalogue") == NO_CATALOGUE:
        what = f"Something is missing{where}, for which no effect was weighed"
    p = probability_of_answer(study) if study.verdict == UNKNOWN_KIND else 1.0
    return f"{_likely(study, what, p)}; {shape}"


def _one_of(study: StudyResult, rows: Sequence[Mapping[str, Any]], texts: Sequence[str], closed: str) -> str:
    """Return the likeliest effects with what could stand in their places."""
    instead = study.effects.query("status == 'one of'").to_dict("records")
    others = [f"{within(named_in(study, row))} ({probability_text(row['probability'])})" for row in instead]
    faults = [name for name in dict.fromkeys(each for row in rows for each in row["tied_with"]) if fault_kind(name)]
    others += [f"an error of the sensor ({name})" for name in faults]
    criteria = study.criteria
    if all(row["probability"] < criteria.missing for row in rows) and LAG in map(fault_kind, faults):
        fault = f"Most likely a sensor is at fault ({', '.join(faults)})"
        return f"{fault}, or else there is {' and '.join(texts)}; adding the effect, which does the same, {closed}."
    place = f", or in its place {' or '.join(others)}" if others else ""
    sure = [text for text, row in zip(texts, rows, strict=False) if row["probability"] >= criteria.named]
    if not 0 < len(sure) < len(texts) == len(rows):
        p, what = probability_missing(study), " and ".join(texts)
        said = f"{_likely(study, 'Something is missing', p)}{', most likely' if p >= criteria.named else ':'}"
        return f"{said} {what}{place}; adding the likeliest {closed}."
    unsure = " and ".join(text for text in texts if text not in sure)
    # That there is nothing besides may be as likely as that it is one of them.
    any_of_them = sum(row["probability"] for row in rows if row["probability"] < criteria.named)
    any_of_them += sum(row["probability"] for row in instead)
    more = ", and perhaps"
    if any_of_them >= criteria.named and not faults:
        more = "; something else is missing besides, most likely"
    it = "it" if len(texts) == 1 else "them"
    return f"The simulation lacks {' and '.join(sure)}{more} {unsure}{place}; adding {it} {closed}."


def _rest(study: StudyResult) -> str:
    """Return what is missing besides what was added, as surely as it is known; older files know no probability."""
    p = max(study.settings.get("rest beside the answer", {}).values(), default=1.0)
    what = "something else that the catalogue does not have"
    return what if p >= study.criteria.missing else f"perhaps {what} (probability {probability_text(p)})"


def _number_word(off: Sequence[Mapping[str, Any]]) -> str:
    """Return the word for numbers of the simulation: parameters if all have names; tables before had no such column."""
    return "parameter" if off and all(row.get("parameter") for row in off) else "coefficient"


def tied_parameters(study: StudyResult) -> str:
    """Return the named parameters of which any might be off instead of the others, in words; "" if there are none."""
    table: Any = study.corrections.reset_index()
    if "parameter" not in table:
        return ""
    likely = table[table["parameter"] & (table["probability"] >= study.criteria.tied * table["probability"].max())]
    return " or ".join(likely["term"].astype(str)) if len(likely) > 1 else ""


def _by_one_factor(study: StudyResult, each: CommonFactor) -> str:
    """Return the right coefficients of an equation that are all off by one factor."""
    gains = "".join(f", or else {numbers_in(row['text'])}, which does the same" for row in each.gains)
    right = listed([f"{formula(row['term'])} {number(row['nominal'] + row['mean'], 4)}" for row in each.rows])
    factor = f"{number(each.factor, 4)} times what they are"
    why = "as where a mass, an inertia or a capacity is wrong"
    return f"all in {study.train.target_label(each.equation)} should be {factor}, {why}{gains}: {right}"


def _should_be(study: StudyResult, row: Mapping[str, Any]) -> str:
    """Return the right coefficient, and the errors of sensors that do the same as a wrong one."""
    share = abs(row["mean"] / row["nominal"]) if row["nominal"] else 1.0
    # As many digits as show that the corrected coefficient is another one.
    digits = min(max(4, 2 - math.floor(math.log10(share))), 15) if share > 0 else 4
    right, wrong = number(row["nominal"] + row["mean"], digits), number(row["nominal"], digits)
    twins = sensors_like(study, row)
    instead = f", or else it is the {' or the '.join(twins)}, which does the same" if twins else ""
    unsure = row["probability"] < study.criteria.named
    p = f" (probability {probability_text(row['probability'])})" if unsure else ""
    # Tables of earlier versions have no parameters.
    if row.get("parameter"):
        now = estimate(row["nominal"] + row["mean"], row["sd"], row["unit"])
        unit = unit_text(row["unit"])
        return f"{row['term']} should be {now}, not {wrong}{f' {unit}' if unit else ''}{p}{instead}"
    label = study.train.target_label(row["equation"])
    return f"{formula(row['term'])} in {label} should have {right}, not {wrong}{p}{instead}"
