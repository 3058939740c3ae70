"""What a study answered beside what was hidden."""

import pandas as pd

from benchmarks.answers import Answer

EFFECTS = pd.DataFrame(
    {
        "slug": ["spring", "drag", "friction"],
        "probability": [0.95, 0.92, 0.3],
        "lower": [1.0, -2.0, 0.0],
        "upper": [2.0, -1.0, 1.0],
        "tied_with": [["pendulum"], [], ["drag"]],
        "status": ["added", "", ""],
    }
)
SUSPECTS = pd.DataFrame({"suspect": ["late", "offset"], "status": ["in the model", ""]})


def answered(verdict: str, truth: dict[str, float], effects: pd.DataFrame = EFFECTS) -> Answer:
    return Answer(truth, verdict, effects, SUSPECTS)


def test_of_what_was_added_names_ties_and_intervals_are_told():
    answer = answered("named", {"spring": 1.5, "friction": 0.5})
    assert answer.names == {"spring"} and answer.added == {"spring": 0.95}
    assert answer.tied == {"spring", "pendulum"}
    # What was not found has no interval.
    assert answer.covered == {"spring": True} and answered("named", {"spring": 3.0}).covered == {"spring": False}
    assert answer.instrument == ["late"]


def test_a_wrong_name_is_a_sure_one_or_one_that_a_verdict_names():
    assert answered("named", {"spring": 1.5}).wrong == []
    assert answered("named", {}).wrong == ["spring"]
    assert answered("one of", {"spring": 1.5}).wrong == ["drag"]
    assert answered("one of", {}).wrong == ["drag", "spring"]


def test_of_nothing_that_was_weighed_nothing_is_told():
    answer = answered("no gap", {"spring": 1.5}, EFFECTS.iloc[:0])
    assert not answer.names and not answer.tied and not answer.covered and not answer.wrong and not answer.added
