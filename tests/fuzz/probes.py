"""What is asked of every reader of input that nobody vouches for: an answer or one sentence, soon, and nothing else.

Shared by the tests of this folder, which draw inputs by hypothesis, and by `targets/`, which let atheris search.
"""

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

import bayes_greybox as bg
from bayes_greybox.config import load_config
from bayes_greybox.criticism.kept.file import load_checked
from bayes_greybox.inference.kept import unsummed
from bayes_greybox.physics.catalogue.loading import load_catalogue
from bayes_greybox.physics.formula.expressions import evaluate, parse_expression
from bayes_greybox.physics.formula.printing import to_latex, to_text

SOON = 1.0
"""Processor seconds that reading may take."""

# What is imported, or read once, where it is first used has its time here.
load_catalogue("all")
_ = bg.GreyBox

NAMES = ("y", "v", "F")
COLUMNS = {name: np.linspace(-2.0, 3.0, 7) + k for k, name in enumerate(NAMES)}
for write in (to_text, to_latex, lambda expr: evaluate(expr, COLUMNS)):
    write(parse_expression("sin(1) + y"))

CODE = ("os.system", "os.exec", "os.posix_spawn", "os.fork", "subprocess.Popen", "socket.connect")
"""Events of `sys.audit` that mean that text of an input was run."""

TRACE = "pwned"
"""Name of the file that code in the inputs would open."""

_watched: list[list[str]] = []


def _hear(event: str, arguments: tuple) -> None:
    if event == "subprocess.Popen" and unsummed.READER in arguments[1]:
        # The package's own reader of files, which runs nothing that they say.
        return
    if _watched and (event in CODE or (event == "open" and TRACE in str(arguments[0]))):
        _watched[-1].append(f"{event} {str(arguments)[:80]}")


sys.addaudithook(_hear)


@contextmanager
def soon() -> Iterator[None]:
    """Refuse what takes long; of processor time, as other programs may have the processor."""
    start = time.process_time()
    yield
    spent = time.process_time() - start
    assert spent < SOON, f"took {spent:.1f} s"


@contextmanager
def no_code() -> Iterator[None]:
    """Refuse that anything is executed."""
    _watched.append([])
    try:
        yield
    finally:
        heard = _watched.pop()
    assert not heard, heard


def sentence(error: bg.InputError) -> str:
    """The text of a refusal, which must be one that can be printed."""
    text = str(error)
    assert text.strip() and text[0] != "<" and "Traceback" not in text, text
    text.encode("utf-8", "replace")
    return text


def expression(text: str) -> None:
    """Read a formula; what was read is printed, is read back as the same, and has values."""
    with soon(), no_code():
        try:
            found = parse_expression(text, NAMES)
        except bg.InputError as error:
            sentence(error)
            return
    with soon():
        to_latex(found)
        printed = to_text(found)
    with np.errstate(all="ignore"):
        values = evaluate(found, COLUMNS)
        assert np.shape(values) == np.shape(COLUMNS["y"])
        if len(printed) <= 2000:
            # Of the same value where both have one: -200.0 is read as a whole number, and so is v**1.0, for which v may
            # then be negative.
            try:
                again = evaluate(parse_expression(printed, NAMES), COLUMNS)
            except bg.InputError as error:
                # SymPy gathers powers of numbers into exponents that nobody may write.
                sentence(error)
                return
            known = np.isfinite(values) & np.isfinite(again)
            np.testing.assert_allclose(again[known], values[known], rtol=1e-6, err_msg=f"{text} is printed {printed}")


def config(text: bytes, folder: Path) -> None:
    """Read a configuration and build what it asks for, without its data."""
    file = folder / "config.toml"
    file.write_bytes(text)
    before = set(folder.rglob("*"))
    with soon(), no_code():
        try:
            found = load_config(file)
            _ = found.folder, found.text
            for ask in (found.build_model, found.build_studied_model, found.study_arguments):
                try:
                    ask()
                except bg.InputError as error:
                    sentence(error)
        except bg.InputError as error:
            sentence(error)
    assert set(folder.rglob("*")) == before


def catalogue(text: bytes, folder: Path) -> None:
    """Read a catalogue of one's own."""
    file = folder / "mine.toml"
    file.write_bytes(text)
    with soon(), no_code():
        try:
            load_catalogue(file)
        except bg.InputError as error:
            sentence(error)


def saved(file: Path) -> None:
    """Load a saved file; what loads has the tables of its draws."""
    before = {each: os.stat(each).st_mtime_ns for each in file.parent.iterdir()}
    with no_code():
        try:
            found = load_checked(file)
        except bg.InputError as error:
            assert str(file) in sentence(error)
            found = None
        try:
            # Numbers may have become others that no model can be fitted to.
            assert found is None or found.draws(next(iter(found.equations))).theta.ndim == 2
        except bg.InputError as error:
            sentence(error)
    assert {each: os.stat(each).st_mtime_ns for each in file.parent.iterdir()} == before
