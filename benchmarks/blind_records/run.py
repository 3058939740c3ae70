"""Studies of the blind records with default settings, as their owner would ask for them."""

from typing import TYPE_CHECKING

from benchmarks.answers import studied
from benchmarks.judged import answer, score, show
from benchmarks.runner import Asked, Benchmark, Case, Record

from . import sampled_records  # noqa: F401 - its records are among those of that name
from .records import names, record

if TYPE_CHECKING:
    from bayes_greybox.missing_effects import Study

    from .records import Record as BlindRecord

HELD_OUT_SHARE = 0.3
"""Last part of each table, held out as in the README."""


def cases(asked: Asked) -> list[Case]:
    """Return the chosen records."""
    return [Case(name, (name,), {"record": name}) for name in asked.names(names(), "record")]


def study_of(made: "BlindRecord") -> "Study":
    """Return the study of a record; nothing is sampled."""
    import bayes_greybox as bg

    settings = dict(made.study_kwargs)
    reading = {
        key: settings.pop(key) for key in ("states", "inputs", "derivatives", "units", "missing") if key in settings
    }
    learned, rows = settings.pop("learn", None), bg.TrajectoryRows() if settings.pop("sampled", False) else None
    train, test = bg.read(made.table, time="t", **reading).split(1 - HELD_OUT_SHARE)
    asked = {"dictionary": {learned: []} if learned else None, "rows": rows}
    model = bg.GreyBox(simulation=made.equations, **{key: value for key, value in asked.items() if value is not None})
    return studied(model, train, test=test, **settings)[0]


def judged(name: str) -> Record:
    """Return the judgement of the study of a record."""
    return answer(record(name), study_of)


BLIND_RECORDS = Benchmark(
    "blind-records",
    "studies records that were made to fool a study by someone who had not seen its code.",
    {"cases": None, "only": None, "workers": 1},
    cases,
    judged,
    score,
    show,
)
