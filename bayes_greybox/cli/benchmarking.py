"""The command benchmark."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayes_greybox.data.errors import InputError

from .ending import DONE, log_to_stderr, show
from .options import Benchmark, Families, NoProgress, Quiet, Verbose

if TYPE_CHECKING:
    from bayes_greybox.criticism.calibration.calibrate import Calibration

Parts = list[Any]
"""Tables to print, in order."""


def benchmark(
    name: Annotated[Benchmark, typer.Argument(help="Which benchmark.")],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Folder for the results.")] = None,
    cases: Annotated[int | None, typer.Option(min=1, help="Number of cases; all of them by default.")] = None,
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
    tables = run_benchmark(
        name.value,
        folder,
        cases=cases,
        workers=workers,
        replicates=replicates,
        seed=seed,
        progress=not (no_progress or quiet),
        families=None if families is None else families.value,
        displacement=displacement,
        cap=cap,
    )
    show(*([folder] if quiet else [*tables, f"\nResults are in {folder}."]))
    return DONE


def run_benchmark(
    name: str,
    folder: Path,
    *,
    cases: int | None,
    workers: int | None,
    replicates: int | None,
    seed: int,
    progress: bool,
    families: str | None = None,
    displacement: float | None = None,
    cap: float | None = None,
) -> Parts:
    """Run a benchmark by its name, and return its tables; options that it does not have are refused."""
    if name != "hidden-effects" and workers is not None:
        raise InputError(f"--workers does not apply to {name}, which uses every core; leave it out.")
    if name != "hidden-effects" and families is not None:
        raise InputError(f"--families does not apply to {name}; leave it out.")
    if displacement is not None and (name != "hidden-effects" or families is not None):
        raise InputError("--displacement has cases of its own, of hidden-effects: leave --families out.")
    if name != "speed" and cap is not None:
        raise InputError(f"--cap does not apply to {name}; leave it out.")
    if name == "speed":
        if replicates is not None:
            raise InputError("--replicates does not apply to speed; --cases sets how many problems there are.")
        return _speed(folder, cases, cap, seed, progress)
    if name == "calibration":
        return _calibrate(folder, cases, replicates or 500, seed, progress)
    if name == "confounding":
        if cases is not None:
            raise InputError("--cases does not apply to confounding; --replicates sets its size.")
        return _confounding(folder, replicates, seed, progress)
    if name == "sampled-systems":
        return _sampled_systems(folder, cases, replicates, seed, progress)
    if name == "sampled-traps":
        if replicates is not None:
            raise InputError("--replicates does not apply to sampled-traps; --cases sets how many are run.")
        return _sampled_traps(folder, cases, seed, progress)
    if name == "sampled-coverage":
        if cases is not None:
            raise InputError("--cases does not apply to sampled-coverage; --replicates sets its size.")
        return _sampled_coverage(folder, replicates, seed, progress)
    if name == "published-odes":
        if cases is not None:
            raise InputError("--cases does not apply to published-odes; --replicates sets its size.")
        return _published_odes(folder, replicates, seed, progress)
    if name == "hudson-bay":
        if cases is not None or replicates is not None:
            raise InputError("hudson-bay is one data set: leave --cases and --replicates out.")
        return _hudson_bay(folder, seed, progress)
    if name == "static-maps":
        return _static_maps(folder, cases, replicates, seed, progress)
    if name == "memory-effects":
        return _memory_effects(folder, cases, replicates, seed, progress)
    if name == "spring-pendulum":
        return _spring_pendulum(folder, cases, replicates, seed, progress)
    if name == "next-experiment":
        if replicates is not None:
            raise InputError("--replicates does not apply to next-experiment; --cases sets how many are run.")
        return _next_experiment(folder, cases, seed, progress)
    if name == "weak-odes":
        return _weak_odes(folder, cases, replicates, seed, progress)
    if name == "weak-coverage":
        if cases is not None:
            raise InputError("--cases does not apply to weak-coverage; --replicates sets its size.")
        return _weak_coverage(folder, replicates, seed, progress)
    if replicates is not None:
        raise InputError("--replicates does not apply to hidden-effects; --cases sets how many are run.")
    from bayes_greybox.benchmarks.hidden_effects.assumptions.cases import assumption_cases
    from bayes_greybox.benchmarks.hidden_effects.cases import all_cases, subset
    from bayes_greybox.benchmarks.hidden_effects.run import run
    from bayes_greybox.benchmarks.tables import benchmark_tables

    if displacement is not None:
        return _displacement(folder, displacement, cases, workers, seed, progress)
    kept = () if families == "assumptions" else all_cases(seed)
    broken = () if families == "effects" else assumption_cases(seed)
    chosen = (*kept, *broken)
    chosen = chosen if cases is None else subset(chosen, cases, seed)
    scores = run(folder, chosen, workers=workers or 2, progress=progress)
    return [*benchmark_tables(scores)]


def _displacement(
    folder: Path, noise: float, cases: int | None, workers: int | None, seed: int, progress: bool
) -> Parts:
    from bayes_greybox.benchmarks.hidden_effects.cases import subset
    from bayes_greybox.benchmarks.hidden_effects.run import run
    from bayes_greybox.benchmarks.hidden_effects.solvers import displacement_oracle, displacement_peers
    from bayes_greybox.benchmarks.hidden_effects.solvers.displacement import displacement_cases, study_displacement
    from bayes_greybox.benchmarks.hidden_effects.solvers.peers import available
    from bayes_greybox.benchmarks.tables import benchmark_tables

    every = displacement_cases(seed)
    chosen = every if cases is None else subset(every, cases, seed)
    solve, oracle, rivals = (
        partial(ask, noise=noise) for ask in (study_displacement, displacement_oracle.ask, displacement_peers.ask)
    )
    scores = run(
        folder, chosen, solve=solve, oracle=oracle, rivals=rivals, workers=workers or 2, peers=available(),
        progress=progress,
    )  # fmt: skip
    return [*benchmark_tables(scores)]


def _calibrate(folder: Path, cases: int | None, replicates: int, seed: int, progress: bool) -> Parts:
    from bayes_greybox.benchmarks.calibration import run, subset
    from bayes_greybox.benchmarks.tables import calibration_tables
    from bayes_greybox.report.plots import calibration, save_figures

    def finished(name: str, found: "Calibration") -> None:
        save_figures({name: calibration(found)}, folder / "figures")

    table = run(folder, subset(cases), replicates=replicates, seed=seed, progress=progress, finished=finished)
    return [*calibration_tables(table)]


def _confounding(folder: Path, replicates: int | None, seed: int, progress: bool) -> Parts:
    from bayes_greybox.benchmarks.confounding.run import REPLICATES, all_cells, run
    from bayes_greybox.benchmarks.tables import confounding_tables
    from bayes_greybox.report.plots import plot_confounding, save_figures

    scores = run(folder, all_cells(replicates or REPLICATES, seed), progress=progress)
    save_figures({"confounding": plot_confounding(scores.terms)}, folder)
    return [*confounding_tables(scores)]


def _sampled_systems(folder: Path, cases: int | None, replicates: int | None, seed: int, progress: bool) -> Parts:
    from bayes_greybox.benchmarks.sampled_systems.run import REPLICATES, run
    from bayes_greybox.benchmarks.sampled_systems.systems import systems
    from bayes_greybox.benchmarks.tables import sampled_tables

    names = list(systems())[:cases]
    table = run(folder, names, replicates=replicates or REPLICATES, seed=seed, progress=progress)
    return [*sampled_tables(table)]


def _sampled_traps(folder: Path, cases: int | None, seed: int, progress: bool) -> Parts:
    from bayes_greybox.benchmarks.sampled_traps.run import run, traps
    from bayes_greybox.benchmarks.tables import trap_tables

    table = run(folder, cases=list(traps())[:cases], seed=seed, progress=progress)
    return [*trap_tables(table)]


def _sampled_coverage(folder: Path, replicates: int | None, seed: int, progress: bool) -> Parts:
    from bayes_greybox.benchmarks.sampled_systems.coverage import REPEATS, run
    from bayes_greybox.benchmarks.tables import coverage_tables

    table = run(folder, repeats=replicates or REPEATS, seed=seed, progress=progress)
    return [*coverage_tables(table)]


def _hudson_bay(folder: Path, seed: int, progress: bool) -> Parts:
    from bayes_greybox.benchmarks.hudson_bay.run import run
    from bayes_greybox.report.terminal.tables import frame_table

    quantities, samplers = run(folder, seed=seed, progress=progress)
    title = "Errors over the reference's standard deviations; standard deviations over its own"
    return [frame_table(title, quantities), frame_table("Samplers", samplers)]


def _speed(folder: Path, cases: int | None, cap: float | None, seed: int, progress: bool) -> Parts:
    from bayes_greybox.benchmarks.speed.drawn import CAP, Settings
    from bayes_greybox.benchmarks.speed.floor import floor
    from bayes_greybox.benchmarks.speed.problems import problems
    from bayes_greybox.benchmarks.speed.run import run
    from bayes_greybox.benchmarks.tables import speed_tables

    table = run(folder, problems()[:cases], settings=Settings(seed=seed, cap=cap or CAP), progress=progress)
    return [*speed_tables(table, floor(folder, progress=progress))]


def _static_maps(folder: Path, cases: int | None, replicates: int | None, seed: int, progress: bool) -> Parts:
    from bayes_greybox.benchmarks.static_maps.maps import maps
    from bayes_greybox.benchmarks.static_maps.run import REPLICATES, run
    from bayes_greybox.benchmarks.tables import map_tables

    table = run(folder, list(maps())[:cases], replicates=replicates or REPLICATES, seed=seed, progress=progress)
    return [*map_tables(table)]


def _memory_effects(folder: Path, cases: int | None, replicates: int | None, seed: int, progress: bool) -> Parts:
    from bayes_greybox.benchmarks.memory_effects.machines import machines
    from bayes_greybox.benchmarks.memory_effects.run import REPLICATES, run
    from bayes_greybox.benchmarks.tables import memory_tables

    names = list(machines())[:cases]
    table = run(folder, names, replicates=replicates or REPLICATES, seed=seed, progress=progress)
    return [*memory_tables(table)]


def _spring_pendulum(folder: Path, cases: int | None, replicates: int | None, seed: int, progress: bool) -> Parts:
    from bayes_greybox.benchmarks.spring_pendulum import run
    from bayes_greybox.benchmarks.tables import pendulum_tables

    names = list(run.cases())[:cases]
    table = run.run(folder, names, replicates=replicates or run.REPLICATES, seed=seed, progress=progress)
    return [*pendulum_tables(table)]


def _next_experiment(folder: Path, cases: int | None, seed: int, progress: bool) -> Parts:
    from bayes_greybox.benchmarks.next_experiment.run import run
    from bayes_greybox.benchmarks.tables import way_tables

    return [*way_tables(*run(folder, cases, seed=seed, progress=progress))]


def _weak_odes(folder: Path, cases: int | None, replicates: int | None, seed: int, progress: bool) -> Parts:
    from bayes_greybox.benchmarks.tables import weak_tables
    from bayes_greybox.benchmarks.weak_odes.run import REPLICATES, run
    from bayes_greybox.benchmarks.weak_odes.systems import weak_systems

    names = list(weak_systems())[:cases]
    table = run(folder, names, replicates=replicates or REPLICATES, seed=seed, progress=progress)
    return [*weak_tables(table)]


def _weak_coverage(folder: Path, replicates: int | None, seed: int, progress: bool) -> Parts:
    from bayes_greybox.benchmarks.tables import weak_tables
    from bayes_greybox.benchmarks.weak_odes.run import COVERED, REPEATS, run
    from bayes_greybox.benchmarks.weak_odes.systems import NOISES

    counted = replicates or REPEATS
    table = run(folder, COVERED, noises=NOISES[:1], replicates=counted, seed=seed, progress=progress)
    return [*weak_tables(table)]


def _published_odes(folder: Path, replicates: int | None, seed: int, progress: bool) -> Parts:
    from bayes_greybox.benchmarks.published_odes.run import REPLICATES, run
    from bayes_greybox.benchmarks.tables import ode_tables

    table = run(folder, replicates=replicates or REPLICATES, seed=seed, progress=progress)
    return [*ode_tables(table)]
