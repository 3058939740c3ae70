"""The verdict of a study in one sentence."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from bayes_greybox.discovery.answer.checks.doubts import SAMPLES_TELL
from bayes_greybox.discovery.answer.instrument import IN_MODEL
from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.discovery.decision.decide import AND_MORE, ONE_LAW
from bayes_greybox.discovery.decision.vetoes import NAMES_ALONE, worse_in_words, worsened
from bayes_greybox.discovery.linearise.near import LARGEST_ERROR
from bayes_greybox.discovery.sensor_errors.channels import GAIN, LAG, is_fault
from bayes_greybox.discovery.study import NO_CATALOGUE, StudyResult
from bayes_greybox.physics.catalogue.names import within

from .formatting import formula, listed, number, numbers_in, probability_text, share_text
from .remainder import remembered
from .study import (
    LEAST_CLOSED,
    LIKELY,
    answer,
    closed_share,
    name_of,
    named_in,
    not_helped,
    not_weighed,
    reversed_text,
    risen,
    rows_of,
    same_as,
)

SURE, TIED = Criteria().named, Criteria().tied
"""Probability from which on something is said for sure, and share from which on it is tied."""

ALIKE = 0.1
"""Coefficients whose relative changes differ by less than this share of them are off by one factor."""


def sentence(study: StudyResult) -> str:
    """Say the verdict so that someone who never heard of evidence knows what to do.

    What was found of the measurement, and what speaks against the verdict, is said with it.

    Args:
        study: The study.
    """
    parts = [_answer(study)]
    found = measurement_in_words(study)
    if found and study.verdict != "instrument":
        parts.append(f"Of the measurement: {'; '.join(found)}.")
    if study.verdict == "unknown":
        # What is missing may be among them.
        parts += [f"{text}." for text in not_weighed(study)]
    if study.against:
        parts.append(f"Against it: {'; '.join(study.against)}.")
    return " ".join(parts)


def measurement_in_words(study: StudyResult) -> list[str]:
    """What the study takes for true about sensors and noise."""
    if not len(study.instrument):
        return []
    # Several equations may be judged on the samples of one sensor.
    found = study.instrument.loc[study.instrument["status"] == IN_MODEL, "text"]
    return [numbers_in(text) for text in dict.fromkeys(found)]


def _answer(study: StudyResult) -> str:
    closed = closed_in_words(study.gap, study.train.target_in_words(*study.maps, article="the "))
    p = _probability(study)
    if study.verdict == "no gap" and (left := _left_in_practice(study)):
        return f"Nothing of size is missing: simulation and measurements agree.{left}"
    if study.verdict == "no gap":
        return f"{_likely('Nothing is missing', p)}: simulation and measurements agree to within the noise."
    if study.verdict == "instrument":
        found = "; ".join(measurement_in_words(study)) or "what of it the data cannot say"
        return f"{_likely('No effect is missing, it is the measurement', p)}: {found}."
    if study.verdict == "recalibrate":
        off = _corrections(study, LIKELY)
        right = "; ".join(_all_should_be(study, off)) or "which one the data cannot say"
        what, it = "coefficients of the simulation are", "them"
        if len(off) == 1:
            what, it = "the coefficient of the simulation is", "it"
        clause = _likely(f"No effect is missing; {what} off", p)
        told = f"{clause} ({right})" if p >= SURE else f"{clause.removesuffix(')')}; {right})"
        return f"{told}, and setting {it} right {closed}.{_left_in_practice(study)}"
    said = _said(study)
    off = _corrections(study, LIKELY)
    if any(row["probability"] >= SURE and answer(study, row["equation"]) != "unknown" for row in off):
        # Most of a gap may be a coefficient's, whatever is added.
        closed = f"and setting {'a coefficient' if len(off) == 1 else 'coefficients'} right {closed}"
    besides = ""
    if off:
        what = "A coefficient of the simulation is" if len(off) == 1 else "Coefficients of the simulation are"
        besides = f" {what} off besides: {'; '.join(_should_be(study, row) for row in off)}."
    return f"{_missing(study, said, closed)}{besides}"


def _left_in_practice(study: StudyResult) -> str:
    """Return a sentence of what remains without a name where it is too small to matter; "" where nothing does."""
    practical = [name for name, small in study.settings.get("agree in practice", {}).items() if small]
    if not practical:
        return ""
    share = share_text(study.settings["thresholds"]["negligible"])
    remains = "; ".join(text for name in practical if (text := remembered(study, name)))
    kind = f"; it {remains}" if remains else ""
    return f" What is left is below {share} of what is modelled{kind}."


def _probability(study: StudyResult) -> float:
    """Probability of a verdict that needs no effect, of all equations that have it."""
    total = 1.0
    for name in study.maps:
        if study.settings.get("agree in practice", {}).get(name):
            # What remains is too small to ask whether it is there.
            continue
        known = rows_of(study.hypotheses, name)["probability"].to_dict()
        own = answer(study, name)
        if own == study.verdict and own in known:
            # Of sensors that were found late beforehand, all that is weighed is put right already.
            late = known.get("no gap", 0.0) if own == "instrument" else 0.0
            total *= known[own] + (late if late > known[own] else 0.0)
    return total


def _likely(text: str, p: float) -> str:
    """A clause as sure as its probability makes it."""
    if p >= SURE:
        return text
    how = "Most likely" if p >= LIKELY else "Perhaps"
    return f"{how} {text[0].lower()}{text[1:]} (probability {probability_text(p)})"


def _of_its_shape(study: StudyResult) -> bool:
    """Whether all that is doubted is the shape of what was found; of several equations another may lack more."""
    ends = (ONE_LAW, SAMPLES_TELL)
    return len(study.maps) == 1 and bool(study.against) and all(text.endswith(ends) for text in study.against)


def _said(study: StudyResult) -> list[str]:
    """Effects that were added, in words; those that may be one law together as that law."""
    label, found = study.train.target_label, []
    rows = study.effects.query("status == 'added'").to_dict("records")
    if study.verdict == "partly named":
        # What is added beside them and may as well not be is in the tables.
        rows = [row for row in rows if row["probability"] > LIKELY] or rows
    sure: dict[Any, float] = study.quantities["probability"].to_dict() if len(study.quantities) else {}
    # Of several equations each says in which it doubts; files of before know no quantities.
    about = {name: f"in {label(name)}: " if len(study.maps) > 1 else "" for name in study.maps}
    one = {name for name, where in about.items() if {where + ONE_LAW, where + AND_MORE} & set(study.against)}
    groups = {id(row): (row["equation"], row.get("quantity", "")) for row in rows}
    for row in rows:
        key = groups[id(row)]
        together = [other for other in rows if groups[id(other)] == key and other["probability"] < SURE]
        if row["equation"] in one and row in together and len(together) > 1 and sure.get(key, 0.0) >= SURE:
            if row is not together[0]:
                continue
            parts = [f"{within(each['name'])} {probability_text(each['probability'])}" for each in together]
            of = key[1].replace(", ", " and ") or "nothing, a constant,"
            p, where = probability_text(sure[key]), label(row["equation"])
            found.append(f"a law of {of} in {where} (probability {p}; {listed(parts)} together, or one without a name)")
            continue
        tied = [within(name_of(study, slug)) for slug in row["tied_with"]]
        tied = f", not to be told from {' or '.join(tied)}" if tied else ""
        p, turned = probability_text(row["probability"]), reversed_text(row)
        turned = f", {turned}" if turned else ""
        found.append(f"{within(named_in(study, row))} in {label(row['equation'])} (probability {p}{tied}{turned})")
    return found


def _missing(study: StudyResult, said: Sequence[str], closed: str) -> str:
    """What is missing, under a verdict that something is.

    Args:
        study: The study.
        said: Effects that were added, in words.
        closed: What became of the gap.
    """
    label = study.train.target_label
    if study.verdict == "unknown" or not said:
        shapeless = [name for name in study.maps if answer(study, name) == "unknown"] if len(study.maps) > 1 else []
        where = f" in {' and '.join(map(label, shapeless))}" if shapeless else ""
        # Of several equations the ones that are spoken of here
        said_of = shapeless or list(study.maps)
        told = {name: remembered(study, name) for name in said_of}
        remembers = "; ".join(
            f"it {text} in {label(name)}" if len(said_of) > 1 else f"it {text}" for name, text in told.items() if text
        )
        shape = "the maps show its shape"
        if remembers:
            shape = remembers if all(told.values()) else f"{shape}, and {remembers}"
        p = _probability(study) if study.verdict == "unknown" else 1.0
        what = f"Something is missing{where} that the catalogue does not have"
        if study.settings.get("catalogue") == NO_CATALOGUE:
            what = f"Something is missing{where}, for which no effect was weighed"
        unnamed = f"{_likely(what, p)}; {shape}"
        if not said:
            return f"{unnamed}."
        it = "it" if len(said) == 1 else "them"
        return f"{unnamed}. The simulation lacks {' and '.join(said)} too; adding {it} {closed}."
    lacks = f"The simulation lacks {' and '.join(said)}"
    it = "it" if len(said) == 1 else "them"
    if study.verdict == "named":
        return f"{lacks}; adding {it} {closed}."
    if study.verdict == "one of":
        others = [
            f"{within(named_in(study, row))} ({probability_text(row['probability'])})"
            for row in study.effects.query("status == 'one of'").to_dict("records")
        ]
        tied = [name for names in study.effects.query("status == 'added'")["tied_with"] for name in names]
        faults = list(filter(is_fault, dict.fromkeys(tied)))
        others += [f"an error of the sensor ({name})" for name in faults]
        unlikely = bool((study.effects.query("status == 'added'")["probability"] < 0.5).all())
        if unlikely and any(name.startswith(f"{LAG} of ") for name in faults):
            fault = f"Most likely a sensor is at fault ({', '.join(faults)})"
            return f"{fault}, or else there is {' and '.join(said)}; adding the effect, which does the same, {closed}."
        instead = f", or in its place {' or '.join(others)}" if others else ""
        rows = study.effects.query("status == 'added'").to_dict("records")
        sure = [text for text, row in zip(said, rows, strict=False) if row["probability"] >= SURE]
        if 0 < len(sure) < len(said) == len(rows):
            unsure = " and ".join(text for text in said if text not in sure)
            # That there is nothing besides may be as likely as it is.
            any_of_them = sum(row["probability"] for row in rows if row["probability"] < SURE) + sum(
                study.effects.query("status == 'one of'")["probability"]
            )
            besides = any_of_them >= SURE and not faults
            more = "; something else is missing besides, most likely" if besides else ", and perhaps"
            return f"The simulation lacks {' and '.join(sure)}{more} {unsure}{instead}; adding {it} {closed}."
        return f"Something is missing, most likely {' and '.join(said)}{instead}; adding the likeliest {closed}."
    if remembers := "; ".join(text for name in study.maps if (text := remembered(study, name))):
        return f"{lacks}, and something else that {remembers}; adding what has a name {closed}."
    if _of_its_shape(study):
        return f"{lacks}; adding {it} {closed}."
    if study.against:
        return f"{lacks}, but that is not all; adding {it} {closed}."
    return f"{lacks}, and {_rest(study)}; adding what has a name {closed}."


def _rest(study: StudyResult) -> str:
    """What is missing besides what was added, as surely as it is known; files of before know no probability."""
    p = max(study.settings.get("rest beside the answer", {}).values(), default=1.0)
    what = "something else that the catalogue does not have"
    return what if p >= LIKELY else f"perhaps {what} (probability {probability_text(p)})"


def _corrections(study: StudyResult, least: float) -> list[dict[str, Any]]:
    """Corrections of the simulation's coefficients that are more probable than this, and not of nothing.

    One that is there for another's sake, as all are beside a gain, may come to zero.
    """
    table = study.corrections
    likely = table[(table["probability"] > least) & (table["lower"] * table["upper"] >= 0)]
    return likely.reset_index().to_dict("records")


def _all_should_be(study: StudyResult, off: Sequence[Mapping[str, Any]]) -> list[str]:
    """The right coefficients; those of an equation that are all off by one factor as that."""
    said = []
    for name in dict.fromkeys(row["equation"] for row in off):
        rows = [row for row in off if row["equation"] == name]
        ratios = [row["mean"] / row["nominal"] for row in rows]
        whole = len(rows) == len(rows_of(study.corrections, name)) > 1
        if not whole or max(ratios) - min(ratios) > ALIKE * abs(sum(ratios)) / len(ratios):
            said += [_should_be(study, row) for row in rows]
            continue
        label, factor = study.train.target_label(name), number(1 + sum(ratios) / len(ratios), 4)
        # What a sensor does to one channel does not do what this does; that of the whole rate does.
        gains = [
            row
            for row in study.instrument.to_dict("records")
            if (row.get("equation"), row.get("suspect"), row.get("channel")) == (name, GAIN, label)
            and row["status"] != IN_MODEL
            and row["probability"] >= TIED
        ]
        instead = "".join(f", or else {numbers_in(row['text'])}, which does the same" for row in gains)
        each = listed([f"{formula(row['term'])} {number(row['nominal'] + row['mean'], 4)}" for row in rows])
        said.append(
            f"all in {label} should be {factor} times what they are, as where a mass, an inertia or a capacity is "
            f"wrong{instead}: {each}"
        )
    return said


def _should_be(study: StudyResult, row: Mapping[str, Any]) -> str:
    """The right coefficient, and the errors of sensors that do the same as a wrong one."""
    digits = _digits(row)
    right, wrong = number(row["nominal"] + row["mean"], digits), number(row["nominal"], digits)
    own = f"recalibration of {row['term']}"
    twins = [
        key
        for key, other in same_as(study, row["equation"]).items()
        if other["what"] == own and abs(row["mean"]) <= LARGEST_ERROR * abs(other["change"])
    ]
    instead = f", or else it is the {' or the '.join(twins)}, which does the same" if twins else ""
    label = study.train.target_label(row["equation"])
    p = f" (probability {probability_text(row['probability'])})" if row["probability"] < SURE else ""
    return f"{formula(row['term'])} in {label} should have {right}, not {wrong}{p}{instead}"


def _digits(row: Mapping[str, Any]) -> int:
    """Return as many digits as show that a corrected coefficient is another one."""
    share = abs(row["mean"] / row["nominal"]) if row["nominal"] else 1.0
    return min(max(4, 2 - math.floor(math.log10(share))), 15) if share > 0 else 4


def closed_in_words(gap: pd.DataFrame, what: str = "the rate") -> str:
    """What became of the gap, on held-out data where the rates were measured there.

    Args:
        gap: The gap before and after, as a study has it.
        what: What is explained or not: the rate, or outputs by name.
    """
    shares = gap.xs("unexplained share", level="metric")[["before", "after"]]
    # f, which takes up anything, is nothing that has a name and was added.
    if NAMES_ALONE in gap.index.get_level_values("metric"):
        alone = gap.xs(NAMES_ALONE, level="metric")[["before", "after"]]
        shares = pd.concat([alone, shares.loc[shares.index.difference(alone.index)]])
    # What is at rest has no rate to explain a share of.
    shares = shares.dropna()
    parts = shares.index.get_level_values("data")
    held_out = "test" in parts
    where = "held-out data" if held_out else "the training data"
    before, after = shares[parts == ("test" if held_out else "train")].sum()
    if before <= after < LEAST_CLOSED:
        # Next to nothing, whatever multiple of it is left; what precise data show of a small gap may well be closed.
        return f"closes no gap on {where}, which show none"
    if not before > 0:
        return f"leaves {share_text(after)} of {what} on {where} unexplained, where nothing was before"
    unchanged = abs(1 - after / before) < LEAST_CLOSED
    worse, idle = worsened(gap), not_helped(gap)
    if worse or idle:
        # What is claimed closed is closed in the free run too.
        runs = " and ".join(worse_in_words(key) for key in worse)
        runs = runs or f"the free run of {listed(idle)} does not get better"
        if unchanged:
            return f"leaves what is unexplained of {what} on {where} as it is, and {runs}"
        if after > before:
            return f"raises what is unexplained of {what} on {where} {risen(after / before)}, and {runs}"
        size = closed_share(1 - after / before)
        return f"lowers what is unexplained of {what} on {where} by {size}, but {runs}"
    if unchanged:
        return f"leaves the gap on {where} as it is"
    if after > before:
        return f"widens the gap on {where} {risen(after / before)}"
    return f"closes {closed_share(1 - after / before)} of the gap on {where}"
