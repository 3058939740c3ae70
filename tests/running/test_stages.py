"""Stages of long work: one display however deep, silence where it is asked for, words where there is no terminal."""

import io
import time

import pytest
from rich.console import Console

from bayes_greybox.running import stages as module
from bayes_greybox.running.stages import announce, stage, stages


@pytest.fixture
def shown(monkeypatch):
    """What the display writes: to a terminal if asked for."""
    out = io.StringIO()
    terminal = {"force_terminal": False}
    monkeypatch.setattr(module, "Console", lambda stderr: Console(file=out, width=100, **terminal))
    out.terminal = terminal
    return out


def test_stages_within_join_the_display_around_them(shown):
    shown.terminal["force_terminal"] = True
    with stages(True), stage("Outer"), stages(True), stage("Inner", 3) as line:
        line.advance(2, "2 divergences")
    text = shown.getvalue()
    assert "Outer" in text and "Inner" in text and "2/3" in text and "2 divergences" in text


def test_what_is_asked_to_be_silent_is_silent_inside_a_display(shown):
    with stages(True), stages(False), stage("Hidden"):
        announce("nothing")
    assert shown.getvalue() == ""


def test_without_a_display_stages_cost_nothing_and_say_nothing(shown):
    with stage("Alone", 5) as line:
        line.advance()
        announce("nothing")
    assert shown.getvalue() == ""


def test_a_log_says_how_long_took_what_took_long(shown, monkeypatch):
    monkeypatch.setattr(module, "WORTH_SAYING", 0.05)
    with stages(True):
        with stage("Short"):
            pass
        with stage("Long"):
            time.sleep(0.06)
        with stage("Untold", said=False):
            time.sleep(0.06)
        with pytest.raises(ValueError, match="broken"), stage("Failed"):
            time.sleep(0.06)
            raise ValueError("broken")
        announce("The answer")
    assert shown.getvalue() == "Long: 0 s\nThe answer\n"


def test_a_display_ends_with_what_opened_it(shown):
    with pytest.raises(ValueError, match="broken"), stages(True):
        raise ValueError("broken")
    announce("late")
    assert shown.getvalue() == ""


def test_a_log_is_told_now_and_then_what_a_long_stage_is_at(shown, monkeypatch):
    monkeypatch.setattr(module, "SAID_FIRST", 0.02)
    monkeypatch.setattr(module, "SAID_EVERY", 0.02)
    with stages(True), stage("Outer"):
        with stage("Inner", 3) as line:
            line.advance(2, "v: weighing")
            until = time.monotonic() + 5.0
            while "Inner" not in shown.getvalue() and time.monotonic() < until:
                time.sleep(0.01)
        # A stage that is over is not told of.
        said = shown.getvalue().count("Inner")
        time.sleep(0.1)
    assert "Inner, 2/3, v: weighing: 0 s so far" in shown.getvalue()
    assert shown.getvalue().count("Inner") == said and "Outer: 0 s so far" in shown.getvalue()


def test_a_log_is_soon_told_what_a_long_stage_is_at(shown, monkeypatch):
    assert module.SAID_FIRST <= 2.0
    monkeypatch.setattr(module, "SAID_FIRST", 0.02)
    with stages(True), stage("Outer"):
        until = time.monotonic() + 5.0
        while not shown.getvalue() and time.monotonic() < until:
            time.sleep(0.01)
        # Not again and again.
        time.sleep(0.1)
    assert shown.getvalue() == "Outer: 0 s so far\n"


def test_the_answer_of_what_is_printed_behind_it_is_not_told_before(shown):
    with stages(True, answers=False), stages(True):
        announce("NAMED", answer=True)
        announce("no draws in the folder")
    with stages(True):
        announce("NAMED", answer=True)
    assert shown.getvalue() == "no draws in the folder\nNAMED\n"


def test_a_terminal_has_its_clock_in_the_line(shown, monkeypatch):
    monkeypatch.setattr(module, "SAID_FIRST", 0.01)
    shown.terminal["force_terminal"] = True
    with stages(True), stage("Inner"):
        time.sleep(0.1)
    assert "so far" not in shown.getvalue()
