"""Run a benchmark from a checkout: `python -m benchmarks NAME`."""

import sys
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from bayes_greybox.cli.ending import DONE, log_to_stderr, run_app, show
from bayes_greybox.cli.options import NoProgress, Quiet, Verbose
from bayes_greybox.report.terminal.tables import frame_table

from .registry import BENCHMARKS, run_benchmark


class Families(StrEnum):
    """Families of cases of hidden-effects."""

    all = "all"
    effects = "effects"
    assumptions = "assumptions"


HELP = "\n\n".join(
    [
        "Run one of the benchmarks; each goes on where it was stopped, but for many-rows, many-runs and stopwatch.",
        *(
            f"{name} {benchmark.about} Options: {', '.join(f'--{option}' for option in benchmark.options)}."
            for name, benchmark in BENCHMARKS.items()
        ),
    ]
)
"""Text of --help."""

app = typer.Typer(
    name="python -m benchmarks",
    epilog="Exit codes: 0 done, 2 bad input, 130 stopped.",
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@app.command(help=HELP)
def benchmark(
    context: typer.Context,
    name: Annotated[str, typer.Argument(help=f"One of {', '.join(BENCHMARKS)}.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Folder for the results.")] = None,
    no_progress: NoProgress = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
    # Options of some benchmarks; the defaults are theirs.
    cases: Annotated[int | None, typer.Option(min=1, help="Number of cases; all of them by default.")] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(help="A kind of cases by its name, once for each; --cases counts these."),
    ] = None,
    replicates: Annotated[int | None, typer.Option(min=1, help="Replicates of each case.")] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Processes side by side; 1 by default, 2 of hidden-effects."),
    ] = None,
    families: Annotated[
        Families | None,
        typer.Option(
            help="Cases of hidden-effects: those where all assumptions hold (effects), those where one is broken "
            "(assumptions), or all, the default."
        ),
    ] = None,
    displacement: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Cases of hidden-effects seen by one sensor of the position alone, with this noise over its spread.",
        ),
    ] = None,
    cap: Annotated[float | None, typer.Option(min=1.0, help="Most seconds of each sampler on each problem.")] = None,
    size: Annotated[
        list[int] | None, typer.Option(min=1, help="Number of rows or of runs, once for each (many-rows, many-runs).")
    ] = None,
    data: Annotated[Path | None, typer.Option(help="Folder of the files of the measured records.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the cases; 0 by default.")] = None,
) -> int:
    """Run one of the benchmarks."""
    log_to_stderr(verbose)
    seen = "" if displacement is None else f"-displacement-{displacement:g}"
    folder = output or Path("runs") / f"benchmark-{name}{seen}"
    shared = ("name", "output", "no_progress", "quiet", "verbose")
    # An option that may be given more than once is empty where it is not given.
    options = {key: None if value in ([], ()) else value for key, value in context.params.items() if key not in shared}
    tables = run_benchmark(name, {**options, "folder": folder, "progress": not (no_progress or quiet)})
    printed = [frame_table(title, table) for title, table in tables.items()]
    show(*([folder] if quiet else [*printed, f"\nResults are in {folder}."]))
    return DONE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns:
        The exit code.
    """
    return run_app(app, "python -m benchmarks", arguments)


if __name__ == "__main__":
    sys.exit(main())
