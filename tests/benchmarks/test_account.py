"""The account of a command's seconds: each counts once, and all of them."""

import json
import os
import subprocess
import sys

import pytest

from benchmarks.account import ACCOUNT, Interval, accounted
from benchmarks.stopwatch import PROGRAM


def test_a_second_counts_for_the_innermost_thing_that_was_going_on():
    found = accounted(
        [
            Interval("checks", 2.0, 9.0),
            Interval("compiling", 3.0, 6.0),
            Interval("kept programs", 4.0, 5.0),
            # It began before the account did.
            Interval("imports", -1.0, 1.0),
        ],
        Interval("rest", 0.0, 10.0),
    )
    assert found == pytest.approx({"imports": 1.0, "checks": 4.0, "compiling": 2.0, "kept programs": 1.0, "rest": 2.0})


def test_of_two_that_began_together_the_shorter_lies_within():
    found = accounted([Interval("sampling", 0.0, 4.0), Interval("tracing", 0.0, 1.0)], Interval("rest", 0.0, 4.0))
    assert found == pytest.approx({"tracing": 1.0, "sampling": 3.0})


def test_a_command_is_accounted_for_to_the_last_second(tmp_path):
    file = tmp_path / "account.json"
    words = [sys.executable, "-c", PROGRAM, "datasets"]
    subprocess.run(words, env={**os.environ, ACCOUNT: str(file)}, check=True, capture_output=True)
    seconds = json.loads(file.read_text(encoding="utf-8"))
    whole, _ = seconds.pop("all"), seconds.pop("CPU")
    assert seconds["imports"] > 0
    assert sum(seconds.values()) == pytest.approx(whole, abs=0.01 * len(seconds))
