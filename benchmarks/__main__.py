"""Run a benchmark from a checkout: `python -m benchmarks NAME`."""

import sys
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from bayes_greybox.cli.ending import DONE, log_to_stderr, run_app, show
from bayes_greybox.cli.options import NoProgress, Quiet, Verbose

from .registry import RUNS, Wanted, run_benchmark


class Families(StrEnum):
    """Families of cases of hidden-effects."""

    all = "all"
    effects = "effects"
    assumptions = "assumptions"


app = typer.Typer(
    name="python -m benchmarks",
    epilog="Exit codes: 0 done, 2 bad input, 130 stopped.",
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@app.command()
def benchmark(
    name: Annotated[str, typer.Argument(help=f"One of {', '.join(RUNS)}.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Folder for the results.")] = None,
    cases: Annotated[int | None, typer.Option(min=1, help="Number of cases; all of them by default.")] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            help="A kind of cases by its name, once for each (benchmarks of named kinds); --cases counts these."
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes that work side by side (hidden-effects); 2 by default.")
    ] = None,
    replicates: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Replicates of each case (all but hidden-effects, next-experiment, sampled-traps, hudson-bay and "
            "speed).",
        ),
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
    cap: Annotated[
        float | None,
        typer.Option(min=1.0, help="Seconds of each sampler on each problem (speed) at most; 600 by default."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the cases.")] = 0,
    no_progress: NoProgress = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> int:
    """Run one of the benchmarks.

    A run that was stopped goes on where it was. hidden-effects hides known effects from simulations and counts
    how often the study finds them. calibration draws truths from every prior with every kernel and tests whether
    they lie among the posterior draws as they should. confounding fits repeated data under each kernel and says what
    orthogonality gives and costs. sampled-systems studies systems of which one state has a sensor: decays, an
    axis, a beam, an oscillator under noise of several kinds, two masses, tanks, predators and prey. sampled-traps
    tempts the study to wrong names: sensors and inputs that lie, machines that no catalogue has, with controls.
    sampled-coverage counts how often intervals of coefficients hold the truth in samples. published-odes finds
    parameters of differential equations from noisy samples, beside published results. static-maps studies forces
    and flows that were measured beside what they depend on, without any derivative. memory-effects hides hysteresis,
    relaxation, lags and absorbers in oscillators whose position is sampled. spring-pendulum studies the public
    demonstration of neural FMUs (extra [fmu], a C compiler): friction that an FMU lacks. next-experiment has ties told
    apart by the experiment that the study asks for, by the D-optimal one and by one at random. weak-odes finds the
    terms of differential equations from noisy samples of all states, and weak-coverage counts their intervals.
    hudson-bay compares the exact trajectory posterior with a reference, and with the model written by hand. speed has
    NumPyro, PyMC with nutpie and PySINDy (extra [peers]) draw from the posteriors that this package draws from, each in
    a process of its own, and compares a gradient with LAPACK's share of it, the pass over the rows with a matrix
    product.
    """
    log_to_stderr(verbose)
    seen = "" if displacement is None else f"-displacement-{displacement:g}"
    folder = output or Path("runs") / f"benchmark-{name}{seen}"
    wanted = Wanted(
        folder,
        seed,
        not (no_progress or quiet),
        cases=cases,
        only=tuple(only) if only else None,
        replicates=replicates,
        workers=workers,
        families=None if families is None else families.value,
        displacement=displacement,
        cap=cap,
    )
    tables = run_benchmark(name, wanted)
    show(*([folder] if quiet else [*tables, f"\nResults are in {folder}."]))
    return DONE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: Words after the program's name; those of the process by default.

    Returns:
        The exit code.
    """
    return run_app(app, "python -m benchmarks", arguments)


if __name__ == "__main__":
    sys.exit(main())
