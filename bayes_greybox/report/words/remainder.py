"""Words for what is missing without a name: its kind, and what it depends on."""

from bayes_greybox.discovery.grid.noise.points import LAW
from bayes_greybox.discovery.sensor_errors.channels import DRIFT
from bayes_greybox.discovery.study import StudyResult

from .formatting import probability_text
from .study import LIKELY, answer, rows_of

WHAT_REMAINS = {
    "a law of the states": "is a law of the states",
    "something in time": "is something in time, of the machine or of its sensor",
    "something that remembers": "remembers",
}
"""Words for each kind of what remains, by its name in the table."""


def remembered(study: StudyResult, equation: str) -> str:
    """Return what an effect without a name likely does or depends on, "is a law of y (probability 0.97)", or "".

    Args:
        study: The study.
        equation: The equation that lacks it.
    """
    known = rows_of(study.memory, equation)["probability"].to_dict()
    likely = {name: p for name, p in known.items() if p > LIKELY}
    kinds = [name for name in likely if name in WHAT_REMAINS]
    verbs = {DRIFT: "changes with time", LAW: "follows another law"}
    # What a memory is of says more than that it is one; files of before know no kinds.
    told = [name for name in likely if name not in WHAT_REMAINS]
    laws = rows_of(study.quantities, equation)["probability"].to_dict() if len(study.quantities) else {}
    laws = {str(name): float(p) for name, p in laws.items() if name and p > LIKELY}
    said = [
        f"{verbs.get(name.split(' of ')[0], 'remembers')} ({name}, probability {probability_text(likely[name])})"
        for name in told
    ]
    if answer(study, equation) == "unknown":
        # Several effects of one quantity may be one law that has no name: the law is sure, its name is not.
        law = [f"a law of {of.replace(', ', ' and ')} (probability {probability_text(p)})" for of, p in laws.items()]
        said = [f"is {' and '.join(law)}", *said] if law else said
    if said:
        return "; ".join(said)
    return "; ".join(f"{WHAT_REMAINS[name]} (probability {probability_text(likely[name])})" for name in kinds)
