"""The command benchmark."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from bayes_greybox.data.errors import InputError

from .ending import DONE, log_to_stderr, show
from .options import Benchmark, Families, NoProgress, Quiet, Verbose

if TYPE_CHECKING:
    from bayes_greybox.criticism.calibration.calibrate import Calibration

Parts = list[Any]
"""Tables to print, in order."""


@dataclass(frozen=True)
class Wanted:
    """What is asked of a benchmark; None: its own default.

    Attributes:
        folder: For the results.
        seed: Of the cases.
        progress: Whether to show a progress bar.
        cases: How many.
        only: Kinds of cases by name.
        replicates: Of each case.
        workers: Processes side by side.
        families: Of cases.
        displacement: Noise of the position's sensor over its spread.
        cap: Seconds of a sampler.
    """

    folder: Path
    seed: int
    progress: bool
    cases: int | None = None
    only: tuple[str, ...] | None = None
    replicates: int | None = None
    workers: int | None = None
    families: str | None = None
    displacement: float | None = None
    cap: float | None = None

    @property
    def shown(self) -> dict[str, Any]:
        """Seed and progress bar, which all have."""
        return {"seed": self.seed, "progress": self.progress}

    def names(self, known: Iterable[str]) -> list[str]:
        """Kinds of cases: those that are named, or all; of these the first ones.

        Args:
            known: All kinds.
        """
        return list(dict.fromkeys(self.only or known))[: self.cases]


class Run(NamedTuple):
    """A benchmark.

    Attributes:
        tables: Runs it.
        options: Attributes of `Wanted` that it has besides seed and progress.
    """

    tables: Callable[[Wanted], Parts]
    options: tuple[str, ...] = ()


def benchmark(
    name: Annotated[Benchmark, typer.Argument(help="Which benchmark.")],
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
    """Run one of the package's benchmarks.

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
    folder = output or Path("runs") / f"benchmark-{name.value}{seen}"
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
    tables = run_benchmark(name.value, wanted)
    show(*([folder] if quiet else [*tables, f"\nResults are in {folder}."]))
    return DONE


def run_benchmark(name: str, wanted: Wanted) -> Parts:
    """Run a benchmark by its name, and return its tables.

    Args:
        name: Of the benchmark.
        wanted: What is asked of it.

    Raises:
        InputError: An option that it does not have.
    """
    run = RUNS[name]
    for option in ("cases", "only", "replicates", "workers", "families", "displacement", "cap"):
        if option not in run.options and getattr(wanted, option) is not None:
            has = ", ".join(f"--{each}" for each in (*run.options, "seed"))
            raise InputError(f"--{option} does not apply to {name}; leave it out. It has {has}.")
    return run.tables(wanted)


def _hidden_effects(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.hidden_effects.assumptions.cases import assumption_cases
    from bayes_greybox.benchmarks.hidden_effects.cases import all_cases, subset
    from bayes_greybox.benchmarks.hidden_effects.run import run
    from bayes_greybox.benchmarks.tables import benchmark_tables

    if wanted.displacement is not None:
        if wanted.families is not None:
            raise InputError("--displacement has cases of its own, of hidden-effects: leave --families out.")
        return _displacement(wanted, wanted.displacement)
    kept = () if wanted.families == "assumptions" else all_cases(wanted.seed)
    broken = () if wanted.families == "effects" else assumption_cases(wanted.seed)
    chosen = (*kept, *broken)
    chosen = chosen if wanted.cases is None else subset(chosen, wanted.cases, wanted.seed)
    return [*benchmark_tables(run(wanted.folder, chosen, workers=wanted.workers or 2, progress=wanted.progress))]


def _displacement(wanted: Wanted, noise: float) -> Parts:
    from bayes_greybox.benchmarks.hidden_effects.cases import subset
    from bayes_greybox.benchmarks.hidden_effects.run import run
    from bayes_greybox.benchmarks.hidden_effects.solvers import displacement_oracle, displacement_peers
    from bayes_greybox.benchmarks.hidden_effects.solvers.displacement import displacement_cases, study_displacement
    from bayes_greybox.benchmarks.hidden_effects.solvers.peers import available
    from bayes_greybox.benchmarks.tables import benchmark_tables

    every = displacement_cases(wanted.seed)
    chosen = every if wanted.cases is None else subset(every, wanted.cases, wanted.seed)
    solve, oracle, rivals = (
        partial(ask, noise=noise) for ask in (study_displacement, displacement_oracle.ask, displacement_peers.ask)
    )
    scores = run(
        wanted.folder, chosen, solve=solve, oracle=oracle, rivals=rivals, workers=wanted.workers or 2,
        peers=available(), progress=wanted.progress,
    )  # fmt: skip
    return [*benchmark_tables(scores)]


def _calibrate(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.calibration import run, subset
    from bayes_greybox.benchmarks.tables import calibration_tables
    from bayes_greybox.report.plots import calibration, save_figures

    def finished(name: str, found: "Calibration") -> None:
        save_figures({name: calibration(found)}, wanted.folder / "figures")

    cases = subset(wanted.cases)
    table = run(wanted.folder, cases, replicates=wanted.replicates or 500, finished=finished, **wanted.shown)
    return [*calibration_tables(table)]


def _confounding(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.confounding.run import REPLICATES, all_cells, run
    from bayes_greybox.benchmarks.tables import confounding_tables
    from bayes_greybox.report.plots import plot_confounding, save_figures

    cells = all_cells(wanted.replicates or REPLICATES, wanted.seed)
    scores = run(wanted.folder, cells, progress=wanted.progress)
    save_figures({"confounding": plot_confounding(scores.terms)}, wanted.folder)
    return [*confounding_tables(scores)]


def _sampled_systems(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.sampled_systems.run import REPLICATES, run
    from bayes_greybox.benchmarks.sampled_systems.systems import systems
    from bayes_greybox.benchmarks.tables import sampled_tables

    replicates = wanted.replicates or REPLICATES
    return [*sampled_tables(run(wanted.folder, wanted.names(systems()), replicates=replicates, **wanted.shown))]


def _sampled_traps(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.sampled_traps.run import run, traps
    from bayes_greybox.benchmarks.tables import trap_tables

    return [*trap_tables(run(wanted.folder, cases=wanted.names(traps()), **wanted.shown))]


def _sampled_coverage(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.sampled_systems.coverage import REPEATS, run
    from bayes_greybox.benchmarks.tables import coverage_tables

    return [*coverage_tables(run(wanted.folder, repeats=wanted.replicates or REPEATS, **wanted.shown))]


def _hudson_bay(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.hudson_bay.run import run
    from bayes_greybox.report.terminal.tables import frame_table

    quantities, samplers = run(wanted.folder, **wanted.shown)
    title = "Errors over the reference's standard deviations; standard deviations over its own"
    return [frame_table(title, quantities), frame_table("Samplers", samplers)]


def _speed(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.speed.drawn import CAP, Settings
    from bayes_greybox.benchmarks.speed.floor import floor
    from bayes_greybox.benchmarks.speed.problems import problems
    from bayes_greybox.benchmarks.speed.run import run
    from bayes_greybox.benchmarks.tables import speed_tables

    settings = Settings(seed=wanted.seed, cap=wanted.cap or CAP)
    table = run(wanted.folder, problems()[: wanted.cases], settings=settings, progress=wanted.progress)
    return [*speed_tables(table, floor(wanted.folder, progress=wanted.progress))]


def _static_maps(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.static_maps.maps import maps
    from bayes_greybox.benchmarks.static_maps.run import REPLICATES, run
    from bayes_greybox.benchmarks.tables import map_tables

    replicates = wanted.replicates or REPLICATES
    return [*map_tables(run(wanted.folder, wanted.names(maps()), replicates=replicates, **wanted.shown))]


def _memory_effects(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.memory_effects.machines import machines
    from bayes_greybox.benchmarks.memory_effects.run import REPLICATES, run
    from bayes_greybox.benchmarks.tables import memory_tables

    replicates = wanted.replicates or REPLICATES
    return [*memory_tables(run(wanted.folder, wanted.names(machines()), replicates=replicates, **wanted.shown))]


def _spring_pendulum(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.spring_pendulum.run import REPLICATES, cases, run
    from bayes_greybox.benchmarks.tables import pendulum_tables

    replicates = wanted.replicates or REPLICATES
    return [*pendulum_tables(run(wanted.folder, wanted.names(cases()), replicates=replicates, **wanted.shown))]


def _next_experiment(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.next_experiment.run import run
    from bayes_greybox.benchmarks.tables import way_tables

    return [*way_tables(*run(wanted.folder, wanted.cases, **wanted.shown))]


def _weak_odes(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.tables import weak_tables
    from bayes_greybox.benchmarks.weak_odes.run import REPLICATES, run
    from bayes_greybox.benchmarks.weak_odes.systems import weak_systems

    replicates = wanted.replicates or REPLICATES
    return [*weak_tables(run(wanted.folder, wanted.names(weak_systems()), replicates=replicates, **wanted.shown))]


def _weak_coverage(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.tables import weak_tables
    from bayes_greybox.benchmarks.weak_odes.run import COVERED, REPEATS, run
    from bayes_greybox.benchmarks.weak_odes.systems import NOISES

    counted = wanted.replicates or REPEATS
    return [*weak_tables(run(wanted.folder, COVERED, noises=NOISES[:1], replicates=counted, **wanted.shown))]


def _published_odes(wanted: Wanted) -> Parts:
    from bayes_greybox.benchmarks.published_odes.run import REPLICATES, run
    from bayes_greybox.benchmarks.tables import ode_tables

    return [*ode_tables(run(wanted.folder, replicates=wanted.replicates or REPLICATES, **wanted.shown))]


NAMED = ("cases", "only", "replicates")
"""Options of a benchmark of named kinds with replicates."""

RUNS = {
    "hidden-effects": Run(_hidden_effects, ("cases", "workers", "families", "displacement")),
    "calibration": Run(_calibrate, ("cases", "replicates")),
    "confounding": Run(_confounding, ("replicates",)),
    "sampled-systems": Run(_sampled_systems, NAMED),
    "sampled-traps": Run(_sampled_traps, ("cases", "only")),
    "sampled-coverage": Run(_sampled_coverage, ("replicates",)),
    "published-odes": Run(_published_odes, ("replicates",)),
    "static-maps": Run(_static_maps, NAMED),
    "memory-effects": Run(_memory_effects, NAMED),
    "spring-pendulum": Run(_spring_pendulum, NAMED),
    "next-experiment": Run(_next_experiment, ("cases",)),
    "weak-odes": Run(_weak_odes, NAMED),
    "weak-coverage": Run(_weak_coverage, ("replicates",)),
    "hudson-bay": Run(_hudson_bay),
    "speed": Run(_speed, ("cases", "cap")),
}
"""Benchmarks by name."""
