"""The command line of the benchmarks."""

import pickle
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from shell import refuse

from benchmarks import registry
from benchmarks.__main__ import main
from benchmarks.hidden_effects.assumptions.cases import assumption_cases
from benchmarks.hidden_effects.cases import all_cases, subset
from benchmarks.registry import BENCHMARKS
from benchmarks.runner import Asked


def test_a_benchmark_gets_its_options_and_shows_what_must_hold(monkeypatch, capsys):
    calls = []
    columns = ["cases", "study", "oracle", "stlsq", "ensemble", "right or tied", "closed", "seconds"]
    families = pd.DataFrame([[12, 0.9167, np.nan, 0.5, 0.5, 1.0, 0.99, 3.21]], index=["catalogue"], columns=columns)
    bars = pd.DataFrame({"reached": [0.9167], "least": [0.95], "holds": [False]}, index=["nulls kept silent"])

    def perform(benchmark, cases, asked):
        assert benchmark is BENCHMARKS["hidden-effects"]
        calls.append((asked.folder, tuple(case.arguments[0] for case in cases), (asked.workers, asked.progress)))
        return {"families": families, "bars": bars, "assumptions": pd.DataFrame()}

    monkeypatch.setattr(registry, "perform", perform)
    words = ["hidden-effects", "--cases", "20", "--workers", "1", "--seed", "3", "-o", "b"]
    assert main([*words, "--no-progress"]) == 0
    assert main(["hidden-effects"]) == 0
    out = capsys.readouterr().out
    (output, cases, settings), (default, every, _) = calls
    assert (output, settings) == (Path("b"), (1, False))
    assert cases == subset((*all_cases(3), *assumption_cases(3)), 20, 3)
    assert (default, every) == (Path("runs/benchmark-hidden-effects"), (*all_cases(0), *assumption_cases(0)))
    assert main(["hidden-effects", "--families", "effects"]) == 0
    assert main(["hidden-effects", "--families", "assumptions"]) == 0
    assert [kept for _, kept, _ in calls[2:]] == [all_cases(0), assumption_cases(0)]
    capsys.readouterr()
    assert "does not apply" in refuse(capsys, "confounding", "--families", "all", main=main)
    assert "0.917" in out and "nulls kept silent" in out and "Results are in b." in out and "nan" not in out


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["hiden-effects"], "hidden-effects"),
        (["confounding", "--families", "all"], "--families does not apply to confounding"),
        (["hidden-effects", "--cases", "0"], "Invalid value for '--cases'"),
    ],
)
def test_wrong_use_is_refused_in_one_sentence(capsys, words, sentence):
    assert sentence in refuse(capsys, *words, main=main)


def test_it_explains_itself(capsys):
    assert main(["--help"]) == main([]) == 0
    out = capsys.readouterr().out
    assert "Usage: python -m benchmarks" in out and all(f"  {name} " in out for name in BENCHMARKS)


def test_every_benchmark_keeps_the_protocol():
    for name, benchmark in BENCHMARKS.items():
        assert benchmark.name == name and benchmark.about.endswith(".")
        Asked(Path(), **benchmark.options)
        # A worker imports it by its name.
        assert pickle.loads(pickle.dumps(benchmark.run)) is benchmark.run


@pytest.mark.parametrize("name", sorted(set(BENCHMARKS) - {"measured-records", "spring-pendulum", "stopwatch"}))
def test_cases_have_keys_of_their_own_and_can_be_pickled(name, tmp_path):
    benchmark = BENCHMARKS[name]
    cases = benchmark.cases(Asked(tmp_path, **benchmark.options))
    assert len({case.key for case in cases}) == len(cases) > 0
    assert pickle.loads(pickle.dumps(cases[0])).key == cases[0].key


def test_the_package_says_where_they_are(capsys):
    told = refuse(capsys, "benchmark", "hidden-effects", "--seed", "3")
    assert told.endswith("run from a checkout of the repository: python -m benchmarks hidden-effects --seed 3")
