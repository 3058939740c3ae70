"""Remedies in the words of who types a command: keys of the file for those that read one, options for init."""

import re

import numpy as np
import pandas as pd
import pytest
from shell import refuse

from bayes_greybox.cli.spelling import as_typed
from bayes_greybox.config import load_config

CONFIG = """
[data]
path = "run.csv"
time = "t"
states = ["y"]
inputs = ["F"]

[simulation]
y = "F - y"
"""

SPELT = {
    'give its encoding, such as encoding="latin-1" or encoding="utf-16".': '[data] encoding = "latin-1"; or [data] '
    'encoding = "utf-16"',
    "GreyBox(dictionary={'level1_cm': []}, ...)": "[dictionary] level1_cm = []",
    "use GreyBox(rows=bg.TrajectoryRows()).": '[rows] kind = "trajectory"',
    "resample the runs evenly, data.resample(2)": "[data] resample = 2",
    "derivatives=..., or data.differentiate()": '[data] derivatives = { state = "column of its rate" }; or '
    '[data.differentiate] method = "savgol"',
    "bg.FMU(..., states={'column': 'variable'})": "[simulation] states",
    "roles={'position': ...}": '[study.roles] position = "column"',
    'leave it out (constant="keep" allows it in held-out data)': '[data] constant = "keep"',
    "pass dayfirst=True or dayfirst=False": "[data] dayfirst = true; or [data] dayfirst = false",
    "give the column one there: inputs={'Kraft_N': 'Kraft N', 'T': 'T'}.": '[data] inputs = { Kraft_N = "Kraft N", '
    'T = "T" }',
    """there: states={'Höhe_mm': 'Höhe {mm}', "x5s": "5's"}.""": '[data] states = { "Höhe_mm" = "Höhe {mm}", '
    'x5s = "5\'s" }',
    "bg.RegularisedHorseshoe(), or skiprows=1": '[prior] kind = "regularised_horseshoe"; or [data] skiprows = 1',
}


@pytest.mark.parametrize("python", SPELT)
def test_a_file_has_keys_for_what_python_has_arguments(python):
    for command in ("fit", "discover", "compare", "next"):
        assert as_typed(command, python) == f"{python} In a file: {SPELT[python]}."
    assert as_typed("report", python) == python


def test_init_has_options():
    said = as_typed("init", 'pass decimal="," and thousands=".", skiprows=2, or dayfirst=True or dayfirst=False')
    assert said == 'pass --decimal "," and --thousands ".", --skiprows 2, or --dayfirst or --monthfirst'
    assert as_typed("fit", "There is no file.") == "There is no file."


NAMES = (
    '"old/skiprows=3/decimal=_run.csv" has no column', "Column 'dt=1 s' holds", 'Column "discrepancy=None, dt=" holds',
    "There is no file 'it\\'s bg.FMU(..., step=1)'", 'Run "dayfirst=True or dayfirst=False" is short',
)  # fmt: skip
"""Names of files and columns that read like Python."""


@pytest.mark.parametrize("name", NAMES)
def test_what_is_quoted_is_a_name(name):
    for command in ("init", "fit"):
        assert as_typed(command, f"{name}.") == f"{name}."
    # The sensor's remedy stands behind it all the same.
    message = f'{name} the sensor\'s words; give sep=";" or skiprows=1'
    assert as_typed("init", message) == f'{name} the sensor\'s words; give --sep ";" or --skiprows 1'
    assert as_typed("fit", message) == f'{message} In a file: [data] sep = ";"; or [data] skiprows = 1.'


@pytest.fixture
def here(tmp_path, monkeypatch):
    t = np.linspace(0.0, 6.0, 61)
    pd.DataFrame({"t": t, "y": np.sin(t), "F": np.cos(t), "z": t**2}).to_csv(tmp_path / "run.csv", index=False)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_an_equation_of_an_input_is_refused_before_any_work(here, capsys):
    (here / "run.toml").write_text(CONFIG + '\n[dictionary]\ny = ["1"]\nF = ["1"]\n')
    said = refuse(capsys, "discover", "run.toml")
    assert "[dictionary] still has a line for 'F', which [data] has among its inputs" in said
    assert "delete that line" in said
    (here / "run.toml").write_text(CONFIG + 'F = "1"\n')
    assert "[simulation] still has a line for 'F'" in refuse(capsys, "discover", "run.toml")


def test_a_rate_that_is_only_named_is_asked_for(here, capsys):
    (here / "run.toml").write_text(CONFIG.replace("F - y", "v"))
    assert 'add a line v = "..." with what your simulation says' in refuse(capsys, "discover", "run.toml")


def test_a_column_that_cannot_stand_in_formulas_is_told_the_line_that_names_it(here, capsys):
    table = pd.read_csv(here / "run.csv").rename(columns={"F": "Kraft N"})
    table.to_csv(here / "run.csv", index=False)
    (here / "run.toml").write_text(CONFIG.replace('["F"]', '["Kraft N", "z"]'))
    said = refuse(capsys, "discover", "run.toml")
    (line,) = re.findall(r"In a file: \[data\] (inputs = \{.*\})", said)
    assert line == 'inputs = { Kraft_N = "Kraft N", z = "z" }'
    # As it was told, the file is read.
    (here / "run.toml").write_text(CONFIG.replace('inputs = ["F"]', line).replace("F - y", "Kraft_N - y"))
    train, _ = load_config(here / "run.toml").read_data()
    assert train.input_names == ("Kraft_N", "z")


def test_two_equations_of_samples_are_told_the_line_of_the_file(here, capsys):
    two = CONFIG.replace('["y"]', '["y", "z"]') + 'z = "y - z"\n'
    (here / "run.toml").write_text(two)
    assert "In a file: [dictionary] y = []; or [data] derivatives" in refuse(capsys, "discover", "run.toml")


def test_terms_of_what_is_no_state_are_refused_before_any_work(here, capsys):
    with_rates = CONFIG + '\n[data.differentiate]\n\n[dictionary]\ny = ["1"]\nw = ["1"]\n'
    (here / "run.toml").write_text(with_rates)
    assert "There is no state 'w' whose equation could be learned" in refuse(capsys, "discover", "run.toml")


def test_samples_are_put_on_even_times(here, capsys):
    table = pd.read_csv(here / "run.csv").drop(index=[20, 41])
    table.to_csv(here / "run.csv", index=False)
    uneven = CONFIG + "\n[data.differentiate]\n"
    (here / "run.toml").write_text(uneven)
    told = re.search(r"In a file: \[data\] (resample = \S+?)[;.]? ", refuse(capsys, "discover", "run.toml") + " ")
    assert told is not None
    (here / "run.toml").write_text(uneven.replace("[data]", f"[data]\n{told.group(1)}"))
    train, _ = load_config(here / "run.toml").read_data()
    assert train.filter is not None and "resampled every 0.1" in " ".join(train.remarks)
    stream = CONFIG.replace("[data]", "[data]\nstream = true\nresample = 0.1")
    (here / "run.toml").write_text(stream)
    assert "resample does not apply to rows that are read in chunks" in refuse(capsys, "fit", "run.toml")
