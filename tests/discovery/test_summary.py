"""A study in codes and numbers, which reports put into words."""

from dataclasses import replace

import pandas as pd

from bayes_greybox.discovery.contradictions import findings
from bayes_greybox.discovery.summary import answer, gap_change, tied_sets


def test_the_answer_is_a_row_of_the_hypotheses(study):
    assert answer(study, "ydot") == "cubic-stiffness" and ("ydot", "cubic-stiffness") in study.hypotheses.index
    bare = replace(study, effects=study.effects.assign(status=""))
    assert answer(replace(bare, verdict="no gap"), "ydot") == "no gap"
    several = replace(bare, verdict="named", maps={**study.maps, "y": study.maps["ydot"]})
    assert answer(several, "ydot") == "unknown"
    two = study.effects.head(3).assign(status=["added", "added", ""], tied_with=[("a",), (), ()])
    chosen = replace(study, effects=two)
    first, second = two["slug"][:2]
    assert answer(chosen, "ydot") == " + ".join(sorted((first, second)))
    assert tied_sets(chosen, "ydot") == [" + ".join(sorted((second, "a")))]
    # Of several equations each has a verdict of its own.
    assert answer(replace(several, verdicts={"ydot": "no gap"}), "ydot") == "no gap"


def change(before, after, run=(0.5, 0.1)):
    """The change of an unexplained share beside a free run's error, on held-out data."""
    keys = [("test", "unexplained share", "x"), ("test", "free-run NRMSE", "x")]
    index = pd.MultiIndex.from_tuples(keys, names=["data", "metric", "variable"])
    table = pd.DataFrame([(before, after, after), (*run, run[1])], columns=["before", "after", "lower"], index=index)
    return gap_change(table)


def test_the_change_of_a_gap_has_a_code():
    assert [change(*ends).code for ends in ((0.4, 0.1), (0.4, 0.5), (0.4, 0.40001))] == ["closed", "wider", "unchanged"]
    assert change(1e-7, 1e-5).code == "none shown" and change(0.0, 0.1).code == "none before"
    denied = change(0.4, 0.1, (0.1, 0.5))
    assert denied.worse == (("test", "free-run NRMSE", "x"),) and not denied.idle
    assert change(0.4, 0.1, (0.1, 0.1)).idle == ("x",)


def test_findings_are_coded_by_the_criteria_of_the_study(study):
    codes = {each.code: each.against for each in findings(study)}
    assert codes["check"] is False and codes["runner-up"] is False and codes["sampler"] is False
    table = study.hypotheses.assign(probability=0.0)
    table.loc[("ydot", "cubic-stiffness"), "probability"] = 0.8
    table.loc[("ydot", "power-law-stiffness"), "probability"] = 0.2
    doubted = replace(study, hypotheses=table)
    assert {each.code: each.against for each in findings(doubted)}["runner-up"] is True
    lax = replace(doubted, settings={**study.settings, "thresholds": {"named": 0.7}})
    assert {each.code: each.against for each in findings(lax)}["runner-up"] is False
