"""The verdict of a study in one sentence."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from bayes_greybox.discovery import summary
from bayes_greybox.discovery.candidates import found_of_sensors, rivals
from bayes_greybox.discovery.decision.probabilities import INSTRUMENT, NO_GAP, RECALIBRATE, STOPS, UNKNOWN_KIND
from bayes_greybox.discovery.decision.vetoes import worse_in_words
from bayes_greybox.discovery.study import StudyResult
from bayes_greybox.physics.catalogue.names import within

from .formatting import estimate, formula, listed, number, numbers_in, probability_text, share_text, unit_text
from .missing import Closed, likely, missing_in_words
from .study import closed_share, name_of, remembered, risen


def sentence(study: StudyResult) -> str:
    """Return the verdict so that someone who never heard of evidence knows what was found, the headline first."""
    return " ".join(statements(study))


def headline(study: StudyResult) -> str:
    """Return the finding in one sentence: what is missing and how sure, or between what that is open."""
    return statements(study)[0]


def statements(study: StudyResult) -> list[str]:
    """Return the headline, what adding the answer does, what was found of the measurement, and what contradicts it.

    Behind a headline that is likely and not sure stands the likeliest other explanation.
    """
    parts = [*_answer(study)]
    parts[1:1] = _next_likeliest(study)
    measured = measurement_in_words(study)
    if measured and study.verdict != "instrument":
        parts.append(f"Of the measurement: {'; '.join(measured)}.")
    against = [text for text in study.against if not any(text in part for part in parts)]
    if against:
        parts.append(f"Against it: {'; '.join(against)}.")
    return parts


def _next_likeliest(study: StudyResult) -> list[str]:
    """Return the likeliest explanation beside an answer without effects that is likely and not sure, as a sentence."""
    p = summary.probability_of_answer(study) if study.verdict in STOPS and len(study.maps) == 1 else 1.0
    if not study.criteria.missing <= p < study.criteria.named:
        return []
    (equation,) = study.maps
    # Delays are put right before hypotheses are weighed: no gap then means the same.
    others = [each for each in rivals(study, equation) if (study.verdict, each[0]) != (INSTRUMENT, NO_GAP)]
    stops = {
        NO_GAP: "that nothing is missing",
        UNKNOWN_KIND: "something that the catalogue does not have",
        RECALIBRATE: "a coefficient of the simulation that is off",
        INSTRUMENT: "an error of the measurement",
    }
    texts = [(stops[name] if name in STOPS else within(name_of(study, name)), q) for name, q in others[:1]]
    return [f"Next likeliest: {text} ({probability_text(q)})." for text, q in texts]


def measurement_in_words(study: StudyResult) -> list[str]:
    """Return what the study takes for true about sensors and noise."""
    found = found_of_sensors(study)
    # Several equations may be judged on the samples of one sensor.
    return [numbers_in(text) for text in dict.fromkeys(found["text"])] if len(found) else []


def _closed(change: summary.GapChange, what: str) -> Closed:
    where = "held-out data" if change.part == "test" else "the training data"
    if change.code == "none shown":
        # Next to nothing, whatever multiple of it is left; what precise data show of a small gap may well be closed.
        return Closed(f"closes no gap on {where}, which show none")
    if change.code == "none before":
        return Closed(f"leaves {share_text(change.after)} of {what} on {where} unexplained, where nothing was before")
    ratio = change.after / change.before
    runs = " and ".join(worse_in_words(key) for key in change.worse)
    if change.idle and not runs:
        runs = f"the free run of {listed(change.idle)} does not get better"
    if runs:
        # Nothing is called closed that free runs deny.
        unexplained = f"what is unexplained of {what} on {where}"
        text = {
            "unchanged": f"leaves {unexplained} as it is, and {runs}",
            "wider": f"raises {unexplained} {risen(ratio)}, and {runs}",
            "closed": f"lowers {unexplained} by {closed_share(1 - ratio)}, but {runs}",
        }[change.code]
        return Closed(text, denied=True)
    return Closed({
        "unchanged": f"leaves the gap on {where} as it is",
        "wider": f"widens the gap on {where} {risen(ratio)}",
        "closed": f"closes {closed_share(1 - ratio)} of the gap on {where}",
    }[change.code])  # fmt: skip


def _answer(study: StudyResult) -> list[str]:
    criteria, verdict = study.criteria, study.verdict
    change = summary.gap_change(study.gap, criteria, summary.rows_by_part(study))
    closed = _closed(change, study.train.target_in_words(*study.maps, article="the "))
    if verdict == "no gap":
        if left := _left_in_practice(study):
            return ["Nothing of size is missing: simulation and measurements agree.", *left]
        clause = likely(study, "Nothing is missing", summary.probability_of_answer(study))
        return [f"{clause}: simulation and measurements agree to within the noise."]
    if verdict == "instrument":
        clause = likely(study, "No effect is missing, it is the measurement", summary.probability_of_answer(study))
        return [f"{clause}: {'; '.join(measurement_in_words(study)) or 'what of it the data cannot say'}."]
    off = summary.corrections_above(study, criteria.missing)
    if verdict == "recalibrate":
        return _recalibrate(study, off, closed)
    if any(
        row["probability"] >= criteria.named and summary.answer(study, row["equation"]) != UNKNOWN_KIND for row in off
    ):
        # Most of a gap may be a coefficient's, whatever is added.
        right = f"and setting {'a coefficient' if len(off) == 1 else 'coefficients'} right"
        closed = closed._replace(text=f"{right} {closed.text}")
    besides = []
    if off:
        word = _number_word(off)
        what = f"A {word} of the simulation is" if len(off) == 1 else f"{word.capitalize()}s of the simulation are"
        besides = [f"{what} off besides: {'; '.join(_should_be(study, row) for row in off)}."]
    return [*missing_in_words(study, closed), *besides]


def _recalibrate(study: StudyResult, off: Sequence[Mapping[str, Any]], closed: Closed) -> list[str]:
    right = "; ".join(
        _by_one_factor(study, each) if isinstance(each, summary.CommonFactor) else _should_be(study, each)
        for each in summary.by_common_factor(study, off)
    )
    one = len(off) <= 1
    word = _number_word(off)
    what = f"a {word} of the simulation is" if one else f"{word}s of the simulation are"
    clause = f"No effect is missing; {what} off"
    unsaid = "which one the data cannot say"
    if not off and (tied := tied_parameters(study)):
        clause, unsaid = "No effect is missing; a parameter of the simulation is off", f"{tied}, {unsaid}"
    clause, it = likely(study, clause, summary.probability_of_answer(study), right or unsaid), "it" if one else "them"
    said = [f"{clause}, and setting {it} right {closed.text}."]
    if closed.denied:
        said = [f"{clause}.", closed.alone(f"setting {it} right")]
    return [*said, *_left_in_practice(study)]


def _left_in_practice(study: StudyResult) -> list[str]:
    """Return a sentence about what remains without a name where it is too small to matter; none where nothing does."""
    practical = [name for name, small in study.settings.get("agree in practice", {}).items() if small]
    if not practical:
        return []
    remains = "; ".join(text for name in practical if (text := remembered(study, name)))
    kind = f"; it {remains}" if remains else ""
    return [f"What is left is below {share_text(study.criteria.negligible)} of what is modelled{kind}."]


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


def _by_one_factor(study: StudyResult, each: summary.CommonFactor) -> str:
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
    twins = summary.sensors_like(study, row)
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
