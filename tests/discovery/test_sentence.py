"""The verdict in one sentence, from tables that are written down by hand."""

import numpy as np
import pandas as pd
import pytest
from bayes_greybox.discovery.sentence import sentence
from tiny_equation import CUBE, SQUARE, tiny_data, tiny_evaluations

from bayes_greybox.discovery.coefficients import Coefficients
from bayes_greybox.discovery.equation import EquationStudy
from bayes_greybox.discovery.rounds import Finding

INDEX = ["data", "metric", "variable"]


def gap_table(**parts):
    """Unexplained shares before and after, by part and beside a metric that is not spoken of."""
    rows = {}
    for part, (before, after) in parts.items():
        rows[(part, "unexplained share", "x")] = (before, after)
        rows[(part, "free-run NRMSE", "x")] = (9.0, 0.1)
    table = pd.DataFrame.from_dict(rows, orient="index", columns=["before", "after"])
    table.index = pd.MultiIndex.from_tuples(table.index, names=INDEX)
    return table


CLOSED = gap_table(test=(0.4, 0.1))


def effects(*rows):
    """(name, probability, tied with) of each effect that was added, and one that was not."""
    table = [("x", name, p, tied, "added") for name, p, tied in rows] + [("x", "Diode", 0.3, (), "")]
    return pd.DataFrame(table, columns=["equation", "name", "probability", "tied_with", "status"])


def said(verdict, added=(), gap=CLOSED, findings=None):
    return sentence(findings or {}, tiny_data(), verdict, effects(*added), gap)


def recalibrated(draws):
    """Findings of an equation with the terms −x and 0.5 cos(x), whose corrections have these draws, user's units."""
    known = tiny_evaluations([CUBE, SQUARE], simulation={"x": "-x + 0.5*cos(x)"})
    statistics = known.statistics
    own = statistics.of_kind("correction")
    place = {statistics.columns[i].term.name: k for k, i in enumerate(own)}
    scaled = np.zeros((100, 2))
    for name, values in draws.items():
        k = place[name]
        scaled[:, k] = np.asarray(values) * statistics.columns[own[k]].scale / statistics.target_scale
    study = object.__new__(EquationStudy)
    coefficients = Coefficients(tuple(own), scaled, np.zeros((100, 0), int), np.ones(100))
    finding = object.__new__(Finding)
    finding.__dict__.update(verdict="recalibrate", base=())
    study.__dict__.update(statistics=statistics, evaluations=known, coefficients=coefficients, finding=finding)
    return {"x": study}


def test_no_gap_says_that_nothing_is_missing():
    assert said("no gap").startswith("Nothing is missing")


def test_the_unknown_says_that_the_catalogue_does_not_have_it():
    text = said("unknown")
    assert "the catalogue does not have" in text and "maps" in text


def test_a_named_effect_is_said_with_its_equation_and_probability():
    assert "cubic spring in d(x)/dt (probability 0.87)" in said("named", [("Cubic spring", 0.87, ())])


def test_only_what_was_added_is_said():
    assert "diode" not in said("named", [("Cubic spring", 0.87, ())])


def test_what_an_effect_closes_is_said():
    text = said("named", [("Cubic spring", 0.87, ())])
    assert text.endswith("adding it closes 75 % of the gap on held-out data.")


def test_several_effects_are_all_said():
    text = said("named", [("Cubic spring", 0.87, ()), ("Drag", 0.62, ())])
    assert "cubic spring in d(x)/dt (probability 0.87) and drag in d(x)/dt (probability 0.62)" in text
    assert "adding them closes" in text


@pytest.mark.parametrize(
    ("p", "words"),
    [(1.0, "above 0.99"), (0.996, "above 0.99"), (0.9901, "above 0.99"), (0.989, "0.99"), (0.4, "0.40")],
)
def test_a_probability_is_never_rounded_to_certainty(p, words):
    assert f"(probability {words})" in said("named", [("Cubic spring", p, ())])


def test_effects_that_cannot_be_told_apart_are_said():
    text = said("named", [("Cubic spring", 0.6, ("pendulum", "dead-zone"))])
    assert "not to be told from pendulum, dead-zone" in text


def test_partly_named_says_that_something_else_is_missing_too():
    text = said("partly named", [("Cubic spring", 0.87, ())])
    assert "cubic spring" in text and "something else that the catalogue does not have" in text
    assert text.endswith("adding what has a name closes 75 % of the gap on held-out data.")


def test_recalibration_says_the_right_coefficient_and_the_wrong_one():
    text = said("recalibrate", findings=recalibrated({"x": np.full(100, -0.25)}))
    assert "No effect is missing" in text
    assert "x in d(x)/dt should have -1.25, not -1" in text
    assert "setting them right closes 75 % of the gap" in text


def test_recalibration_passes_over_coefficients_that_are_rather_right():
    draws = {"x": np.full(100, -0.25), "cos(x)": np.where(np.arange(100) < 40, 0.1, 0.0)}
    assert "cos" not in said("recalibrate", findings=recalibrated(draws))


def test_recalibration_lists_all_coefficients_that_are_rather_wrong():
    draws = {"x": np.full(100, -0.25), "cos(x)": np.where(np.arange(100) < 60, 0.1, 0.0)}
    text = said("recalibrate", findings=recalibrated(draws))
    # The mean over all draws, those without a correction included.
    assert "should have -1.25, not -1" in text and "should have 0.56, not 0.5" in text


def test_recalibration_admits_that_it_does_not_know_the_coefficient():
    draws = {"x": np.where(np.arange(100) < 50, -0.25, 0.0), "cos(x)": np.where(np.arange(100) < 50, 0.0, 0.1)}
    assert "which one the data cannot say" in said("recalibrate", findings=recalibrated(draws))


def test_a_gap_that_grows_is_said_to_widen():
    text = said("named", [("Cubic spring", 0.87, ())], gap_table(test=(0.2, 0.3)))
    assert text.endswith("adding it widens the gap on held-out data by 50 %.")


def test_a_gap_that_is_closed_all_but_wholly_is_not_rounded_to_wholly():
    text = said("named", [("Cubic spring", 0.87, ())], gap_table(test=(1.0, 0.001)))
    assert "closes more than 99 % of the gap" in text


def test_without_a_gap_on_held_out_data_none_is_left():
    text = said("named", [("Cubic spring", 0.87, ())], gap_table(test=(0.0, 0.0)))
    assert "leaves no gap on held-out data" in text


def test_the_gap_on_held_out_data_counts_where_there_are_any():
    text = said("named", [("Cubic spring", 0.87, ())], gap_table(train=(1.0, 0.9), test=(0.4, 0.1)))
    assert "closes 75 % of the gap on held-out data" in text


def test_without_held_out_data_the_gap_is_that_on_the_training_data():
    text = said("named", [("Cubic spring", 0.87, ())], gap_table(train=(1.0, 0.9)))
    assert "closes 10 % of the gap on the training data" in text


def test_the_gaps_of_several_equations_are_added_up():
    gap = pd.concat([CLOSED, CLOSED.rename(index={"x": "z"}) * [1.0, 4.0]])
    # 0.4 and 0.4 before, 0.1 and 0.4 after.
    assert "widens" not in said("named", [("Cubic spring", 0.87, ())], gap)
    assert "closes 38 % of the gap" in said("named", [("Cubic spring", 0.87, ())], gap)
