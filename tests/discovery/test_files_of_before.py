"""Codes of studies whose files have texts alone."""

from types import SimpleNamespace

import pandas as pd

from bayes_greybox.discovery.decision.reasons import Reason
from bayes_greybox.discovery.study_file import add_codes


def older(against, equations=("x",), memory=(), left_out=None):
    """Fields of a study as an older file has them."""
    index = pd.MultiIndex.from_tuples([("x", name) for name in memory] or [("x", "drift of x")])
    return {
        "against": against, "maps": dict.fromkeys(equations), "left_out": left_out or {},
        "memory": pd.DataFrame({"probability": [0.5] * len(index)}, index=index),
        "train": SimpleNamespace(target_label=lambda name: f"d({name})/dt"),
    }  # fmt: skip


def test_reasons_are_coded_by_the_texts_that_older_versions_wrote():
    law = "several effects of the same quantity may be one that the catalogue does not have"
    filtered = "rates that a filter computed do not show how drag is where it bends: study the samples, without "
    values = older(
        (law, f"{law}, and something is left besides", f"{filtered}differentiate", "residuals hang together")
    )
    add_codes(values)
    assert [reason.code for reason in values["reasons"]] == ["one law", "one law and more", "unseen shape", "check"]
    assert [reason.text for reason in values["reasons"]] == list(values["against"])
    several = older((f"in d(z)/dt: {law}", "the free run of x gets worse"), ("x", "z"))
    add_codes(several)
    assert [(reason.code, reason.equation) for reason in several["reasons"]] == [("one law", "z"), ("check", "")]


def test_what_remains_has_its_kind_and_its_channel():
    values = older((), memory=("a law of the states", "something in time", "something that remembers", "drift of y"))
    add_codes(values)
    assert values["memory"]["kind"].tolist() == ["law", "time", "memory", "drift"]
    assert values["memory"]["channel"].tolist() == ["", "", "", "y"]


def test_roles_that_no_column_plays_are_read_from_the_reasons():
    why = {("x", "sine"): "no column plays the role 'position' (that)", ("x", "gain"): "zero on all the data"}
    values = older((), left_out=why)
    add_codes(values)
    assert values["lacking_roles"] == {("x", "sine"): "position"}


def test_codes_of_newer_files_stay():
    values = older(()) | {"reasons": (Reason("check", "z"),), "lacking_roles": {("x", "a"): "level"}}
    add_codes(values)
    assert values["reasons"] == (Reason("check", "z"),) and values["lacking_roles"] == {("x", "a"): "level"}
