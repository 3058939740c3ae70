"""Coded requests of a study to its reader: what its verdict asks for, which reports put into words."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from .answer.instrument import IN_MODEL
from .answer.where import WINDOW
from .decision.probabilities import INSTRUMENT, NO_GAP, RECALIBRATE, UNKNOWN_KIND
from .grid.points import LATENT_FORCE
from .sensor_errors.channels import ERRORS
from .study import NO_CATALOGUE, StudyResult
from .summary import corrections_above, not_weighed, remainders

KEEP, ADOPT, TELL_APART, SET, CHOOSE, CORRECT, ALLOW = (
    "keep", "adopt", "tell apart", "set", "choose", "correct", "allow"
)  # fmt: skip
"""Keep the simulation; adopt what was found; tell explanations apart; set a coefficient, or choose; correct a sensor,
or allow for its noise."""

TRY, DOUBT, EVENT, REST, SHAPE, WEIGH, ROLE = "try", "doubt", "event", "rest", "shape", "weigh", "role"
"""Try the model on other data; doubt the verdict; ask for events; look at the rest, or its shape; weigh effects; give a
role."""


@dataclass(frozen=True)
class Request:
    """One thing that a study asks of its reader: a code, and values to say it with."""

    code: str
    values: Mapping[str, Any] = field(default_factory=dict)


def requests(study: StudyResult) -> Iterator[Request]:
    """Yield what a verdict asks of the reader, the most important first; there is always something."""
    reasons = dict.fromkeys(reason.code for reason in study.reasons)
    if study.verdict == NO_GAP and not reasons:
        yield Request(KEEP)
    if study.verdict == "named":
        yield Request(ADOPT)
        if study.test is None:
            yield Request(TRY)
    yield from (Request(DOUBT, {"reason": code}) for code in reasons)
    yield from _experiments(study)
    yield from _coefficients(study)
    yield from _sensors(study)
    if study.verdict == "partly named" and not reasons:
        yield Request(REST)
    if study.verdict == UNKNOWN_KIND:
        yield from _events(study)
        yield Request(WEIGH if study.settings.get("catalogue") == NO_CATALOGUE else SHAPE)
        yield from (Request(ROLE, {"role": role, "count": count}) for role, count in not_weighed(study).items())


def _events(study: StudyResult) -> Iterator[Request]:
    for name in study.maps:
        if any(each.kind == LATENT_FORCE for each in remainders(study, name)):
            rows = study.where[(study.where["equation"] == name) & (study.where["kind"] == WINDOW)]
            # What goes on most of the time is no event.
            rows = rows[rows["sample_share"] <= 0.5]
            if len(rows):
                yield Request(EVENT, {"equation": name, "when": list(rows["description"])})


def _experiments(study: StudyResult) -> Iterator[Request]:
    """Yield the experiments that tell tied effects apart; they are ranked where an explanation predicts a run."""
    ranked = any(not study.train.is_output(name) for name in study.explanations)
    for tie in study.ties:
        yield Request(TELL_APART, {**tie, "ranked": ranked})
    if study.verdict == "one of" and not study.ties:
        yield Request(
            TELL_APART, {"slugs": (), "advice": "more data of the same kind, or less noise", "ranked": ranked}
        )


def _coefficients(study: StudyResult) -> Iterator[Request]:
    if study.verdict in (NO_GAP, INSTRUMENT):
        return
    off = corrections_above(study, study.criteria.missing)
    yield from (Request(SET, {"row": row}) for row in off)
    if study.verdict == RECALIBRATE and not off:
        yield Request(CHOOSE)


def _sensors(study: StudyResult) -> Iterator[Request]:
    """Yield sensors to correct, each once; noise is only allowed for."""
    rows = [row for row in study.instrument.to_dict("records") if row["status"] == IN_MODEL]
    wrong = {row["text"]: row for row in rows if row.get("suspect") in ERRORS}
    yield from (Request(CORRECT, {"row": row}) for row in wrong.values())
    if study.verdict == INSTRUMENT and not wrong:
        yield Request(ALLOW)
