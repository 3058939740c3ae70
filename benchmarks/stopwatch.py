"""Waiting times of the commands, to the first line, the first bar, the verdict and the end, and their causes.

Every command runs in a terminal of its own, once with nothing compiled before (cold) and once again (warm). Its output
is read as it comes; silence is the time in which no character comes, also none of a bar's clock. A second table says
where the seconds went (see `account`); "CPU" is those of all cores, which a busy machine stretches less.
"""

import json
import math
import os
import re
import select
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from bayes_greybox.running.compiling import FOLDER
from bayes_greybox.running.errors import InputError
from benchmarks.account import ACCOUNT
from benchmarks.runner import Asked, Benchmark, Case, Record, Tables

COMMANDS = {
    "fit": ("fit", "configs/first.toml", "-o", "{folder}/fit"),
    "report": ("report", "{folder}/fit/run.nc", "-o", "{folder}/fit.html"),
    "discover": ("discover", "configs/discover_spring.toml", "-o", "{folder}/discover"),
    "compare": ("compare", "configs/compare_priors.toml", "-o", "{folder}/compare"),
}
"""Commands, from the folder of a checkout; report needs the file that fit wrote."""

VERDICT = {
    "fit": r"Converged|Not converged",
    "discover": r"NAMED:|NO GAP:|UNKNOWN:|PARTLY NAMED:|ONE OF:|RECALIBRATE:|INSTRUMENT:",
    "compare": r"elpd",
    "report": r"The report is",
}
"""Patterns of the lines that give the answer."""

PROGRAM = """
import sys
from benchmarks.account import run

def command():
    from bayes_greybox.cli import command

    return command()

sys.exit(run(command))
"""
"""The command bayes-greybox, with an account of its seconds."""

BAR = "━"
"""Character of bars."""


def cases(asked: Asked) -> list[Case]:
    """Return the chosen commands, cold and warm.

    Raises:
        InputError: This is not the folder of a checkout.
    """
    names = asked.names(COMMANDS, "command")
    if not Path("configs/first.toml").is_file():
        raise InputError("The stopwatch runs the configurations of a checkout: start it from its folder.")
    return [
        Case(f"{name}/{state}", (asked.folder, name, state), {"command": name, "programs": state})
        for name in names
        for state in ("cold", "warm")
    ]


def timed(folder: Path, name: str, state: str) -> dict[str, Any]:
    """Return waiting times and the account of a command; results and compiled programs go to the folder."""
    words = [word.format(folder=folder) for word in COMMANDS[name]]
    cache, file = folder / "compiled" / name, folder / f"{name}-{state}.json"
    if state == "cold":
        shutil.rmtree(cache, ignore_errors=True)
    file.unlink(missing_ok=True)
    found = waited(words, VERDICT[name], {FOLDER: str(cache), ACCOUNT: str(file.resolve())})
    return {**found, "account": json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}}


def waited(words: Sequence[str], verdict: str, environment: Mapping[str, str]) -> dict[str, float]:
    """Run a command in a terminal of its own.

    Returns:
        Seconds to the first character, the first bar, the verdict (NaN where they never came) and the end; the longest
        silence before the end; and the exit code.
    """
    import pty  # there is none on Windows

    start = time.perf_counter()
    child, screen = pty.fork()
    if child == 0:
        os.environ.update(environment, TERM="xterm-256color", COLUMNS="120")
        os.execv(sys.executable, [sys.executable, "-c", PROGRAM, *words])
    seen, last, silence = "", start, 0.0
    first = bar = answer = math.nan
    while True:
        select.select([screen], [], [], 1.0)
        try:
            part = os.read(screen, 65536).decode(errors="replace")
        except OSError:
            # The other end is closed.
            break
        if not part:
            break
        now = time.perf_counter()
        silence, last, seen = max(silence, now - last), now, (seen + part)[-20_000:]
        if math.isnan(first):
            first = now - start
        if math.isnan(bar) and BAR in part:
            bar = now - start
        if math.isnan(answer) and re.search(verdict, seen):
            answer = now - start
    end = time.perf_counter()
    _, status = os.waitpid(child, 0)
    return {
        "first line": first, "first bar": bar, "verdict": answer, "end": end - start,
        "silence": max(silence, end - last), "exit code": os.waitstatus_to_exitcode(status),
    }  # fmt: skip


def score(records: list[Record]) -> Tables:
    """Return waiting times, and seconds by cause."""
    names = ["command", "programs"]
    columns = [*names, "first line", "first bar", "verdict", "end", "silence", "exit code"]
    accounts = [{**{name: record[name] for name in names}, **record["account"]} for record in records]
    return {
        "waited": pd.DataFrame(records, columns=columns).set_index(names),
        "accounts": pd.DataFrame(accounts).set_index(names).fillna(0.0),
    }


def show(tables: Tables) -> dict[str, pd.DataFrame]:
    """Return both tables."""
    waited, accounts = (table.reset_index("programs").round(1) for table in tables.values())
    return {"Seconds of waiting": waited, "Seconds by cause": accounts}


STOPWATCH = Benchmark(
    "stopwatch",
    "times the commands, cold and warm, to the first line, the verdict and the end; from the folder of a checkout.",
    {"only": None},
    cases,
    timed,
    score,
    show,
    resumes=False,
)
