"""What counts as right, and the tables made of it."""

import json

import numpy as np
import pytest
from hidden_cases import effect, row

from benchmarks.hidden_effects.scoring import case_scores
from benchmarks.hidden_effects.scoring.score import score


@pytest.mark.parametrize(
    ("family", "truth", "verdict", "names", "right"),
    [
        ("catalogue", ("a",), "named", ["a"], True),
        ("catalogue", ("a",), "named", ["a", "b"], True),
        ("catalogue", ("a",), "named", ["b", "a"], False),
        ("catalogue", ("a",), "unknown", [], False),
        ("null", (), "no gap", [], True),
        ("null", (), "recalibrate", [], False),
        ("mis-calibrated", (), "recalibrate", [], True),
        ("off-catalogue", ("x",), "partly named", ["a"], True),
        ("off-catalogue", ("x",), "named", ["a"], False),
        ("off-catalogue", ("x",), "failed", [], False),
        ("two effects", ("a", "b"), "partly named", ["b", "c", "a"], True),
        ("two effects", ("a", "b"), "named", ["a"], False),
    ],
)
def test_what_counts_as_right(family, truth, verdict, names, right):
    assert case_scores.is_right(family, truth, verdict, names) is right


def test_scores_of_rows_made_by_hand():
    rows = [
        row(
            effects=[effect("a", mean=1.05)], oracle={"a": 0.99, "none": 0.01}, stlsq={"verdict": "named", "names": []}
        ),
        row(effects=[effect("b", 0.6, mean=1.5)], oracle={"b": 0.7, "a": 0.3}, ratio=0.5),
        row("null", (), "no gap", oracle={"none": 1.0}),
        row("two effects", ("a", "b"), effects=[effect("a", mean=1.3), effect("b", mean=1.17)]),
        row("off-catalogue", ("x",), "partly named", [effect("c", 0.5)]),
    ]
    scores = score(rows)
    assert scores["families"].loc["catalogue", ["cases", "study", "oracle", "stlsq"]].tolist() == [2, 0.5, 0.5, 0.0]
    assert scores["families"].loc["catalogue", ["exact", "stlsq exact"]].tolist() == [0.5, 0.0]
    assert scores["families"].loc["off-catalogue", "exact"] == 1.0
    assert scores["families"].loc["catalogue", "closed"] == pytest.approx(1.0)
    assert scores["families"].loc["all", "study"] == pytest.approx(0.8)
    assert np.isnan(scores["families"].loc["all", "oracle"])
    assert scores["ratios"]["cases"].tolist() == [1, 0, 1, 0]
    assert scores["verdicts"].loc["off-catalogue", "partly named"] == 1.0
    # True coefficients are 1: of the three found, 1.05 ± 0.1 holds it, 1.3 ± 0.1 and 1.17 ± 0.1 do not.
    assert scores["coverage"].loc["all"].tolist() == pytest.approx([3, 1 / 3, 1 / 3])
    assert scores["bars"].loc["nulls kept silent", "holds"]
    assert scores["bars"].loc["accuracy less the oracle's, all sizes", "holds"] is not None
    json.dumps(json.loads(scores["cases"].to_json()))
    # Where samples were measured, the gap is in samples, and so is what the true model closes of it.
    study = {"verdict": "named", "effects": [], "closed": {"sample NMSE": 0.6}, "closable": 0.8}
    assert score([{**rows[0], "study": study}])["families"].loc["catalogue", "closed"] == pytest.approx(0.75)
    # No name was stated, so there is no error of their probabilities to judge.
    bars = score([row("null", (), "no gap", oracle={"none": 1.0})])["bars"]
    silent = bars.loc["expected calibration error of stated names"]
    assert np.isnan(silent["reached"]) and silent["holds"] is None


def test_calibration_error_by_hand():
    probability = np.array([0.95, 0.95, 0.95, 0.95, 0.65, 0.65])
    right = np.array([True, True, True, False, True, False])
    curve = case_scores.reliability_curve(probability, right)
    assert curve["ece"].sum() == pytest.approx(4 / 6 * abs(0.75 - 0.95) + 2 / 6 * abs(0.5 - 0.65))
    assert curve["cases"].sum() == 6
    assert case_scores.reliability_curve(np.array([]), np.array([], bool))["ece"].sum() == 0.0


@pytest.mark.parametrize(
    ("tied", "oracle", "excused"),
    [
        (("a",), {"b": 0.6, "a": 0.4}, True),
        (("a",), {"a": 0.99, "b": 0.01}, False),
        (("c", "d"), {"b": 0.6, "a": 0.4}, False),
        (("a", "c", "d"), {"b": 0.6, "a": 0.4}, False),
    ],
)
def test_a_tie_excuses_only_what_the_oracle_cannot_separate(tied, oracle, excused):
    found = case_scores.case_scores(row(effects=[effect("b", tied_with=tied)], oracle=oracle))
    assert found["study"] is False
    assert found["right or tied"] is excused
