"""Studies of the records of four fields with default settings, as their owner would ask for them."""

from typing import TYPE_CHECKING, Any

from benchmarks.answers import studied
from benchmarks.judged import answer, score, show
from benchmarks.runner import Asked, Benchmark, Case, Record

from .record import FieldRecord
from .records import RECORDS

if TYPE_CHECKING:
    from bayes_greybox.missing_effects import Study


def cases(asked: Asked) -> list[Case]:
    """Return the chosen records."""
    return [Case(name, (name,), {"record": name}) for name in asked.names(RECORDS, "record")]


def study_of(record: FieldRecord) -> "Study":
    """Return the study of a record; nothing is sampled."""
    # Imported here: these bring JAX, which the modules that make the data do without.
    import bayes_greybox as bg

    made = record.measured()
    data = bg.Trajectories.from_arrays(
        made.time,
        states=dict(made.states) or None,
        inputs=dict(made.inputs),
        outputs=dict(made.outputs) or None,
        units=dict(made.units),
    )
    train, test = data.split(made.split) if made.split else (data, None)
    said: dict[str, Any] = {"starts": dict(made.starts)} if made.starts else {}
    if made.held:
        said["rows"] = bg.DerivativeRows(interpolation="zoh")
    model = bg.GreyBox(simulation=dict(made.simulation), parameters=dict(made.parameters), **said)
    roles = dict(made.roles) or None
    return studied(model, train, test=test, catalogue=record.kind, roles=roles)[0]


def judged(name: str) -> Record:
    """Return the judgement of the study of a record."""
    return answer(RECORDS[name], study_of)


FIELD_RECORDS = Benchmark(
    "field-records",
    "studies batteries, houses, drugs and vehicles that were made to fool a study, with what sensors do there.",
    {"cases": None, "only": None, "workers": 1},
    cases,
    judged,
    score,
    show,
)
