"""How long the commands keep a user waiting, to the first line, the first bar, the verdict and the end, and for what.

    python -m benchmarks.stopwatch --folder runs/stopwatch

Every command runs in a terminal of its own, once with nothing compiled before (cold) and once again (warm). What it
shows is read as it comes; silence is the time in which no character comes, also none of a bar's clock. A second table
says where the seconds went (see `account`); "CPU" is those of all cores, which a busy machine stretches less.
"""

import argparse
import json
import os
import re
import select
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from bayes_greybox.running.compiling import FOLDER
from bayes_greybox.running.errors import InputError
from benchmarks.account import ACCOUNT

COMMANDS = {
    "fit": ("fit", "configs/first.toml", "-o", "{folder}/fit"),
    "report": ("report", "{folder}/fit/run.nc", "-o", "{folder}/fit.html"),
    "discover": ("discover", "configs/discover_spring.toml", "-o", "{folder}/discover"),
    "compare": ("compare", "configs/compare_priors.toml", "-o", "{folder}/compare"),
}
"""Commands, from the folder of a checkout."""

VERDICT = {
    "fit": r"Converged|Not converged",
    "discover": r"NAMED:|NO GAP:|UNKNOWN:|PARTLY NAMED:|ONE OF:|RECALIBRATE:|INSTRUMENT:",
    "compare": r"elpd",
    "report": r"The report is",
}
"""What says that the answer is there."""

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


def waited(words: Sequence[str], verdict: str, environment: Mapping[str, str]) -> dict[str, float]:
    """Run a command in a terminal of its own.

    Args:
        words: Of the command, after the program's name.
        verdict: Pattern that says that the answer is there.
        environment: Variables beside those of this process.

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
    seen, last = "", start
    first = bar = said = float("nan")
    silence = 0.0
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
        if first != first:
            first = now - start
        if bar != bar and BAR in part:
            bar = now - start
        if said != said and re.search(verdict, seen):
            said = now - start
    end = time.perf_counter()
    _, status = os.waitpid(child, 0)
    silence = max(silence, end - last)
    return {
        "first line": first, "first bar": bar, "verdict": said, "end": end - start, "silence": silence,
        "exit code": os.waitstatus_to_exitcode(status),
    }  # fmt: skip


def stopwatch(folder: Path, names: Sequence[str] = tuple(COMMANDS)) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Every command cold and warm: how long one waits, and where the seconds go.

    Args:
        folder: For results and compiled programs; what is in it of an earlier run goes.
        names: Of the commands; report needs what fit wrote.

    Raises:
        InputError: Not the folder of a checkout.
    """
    if not Path("configs/first.toml").is_file():
        raise InputError("The stopwatch runs the configurations of a checkout: start it from its folder.")
    table: dict[tuple[str, str], dict[str, float]] = {}
    accounts: dict[tuple[str, str], dict[str, float]] = {}
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        words = [word.format(folder=folder) for word in COMMANDS[name]]
        cache = folder / "compiled" / name
        shutil.rmtree(cache, ignore_errors=True)
        for state in ("cold", "warm"):
            file = folder / f"{name}-{state}.json"
            file.unlink(missing_ok=True)
            table[name, state] = waited(words, VERDICT[name], {FOLDER: str(cache), ACCOUNT: str(file.resolve())})
            accounts[name, state] = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    return _table(table), _table(accounts).fillna(0.0)


def _table(rows: dict[tuple[str, str], dict[str, float]]) -> pd.DataFrame:
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis(["command", "programs"])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("runs/stopwatch"))
    parser.add_argument("names", nargs="*", default=list(COMMANDS))
    given = parser.parse_args()
    for found in stopwatch(given.folder, given.names):
        print(found.round(1).to_string(), end="\n\n")
