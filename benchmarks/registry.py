"""The benchmarks by name, with the options that each has."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from bayes_greybox.running.errors import InputError

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


def run_benchmark(name: str, wanted: Wanted) -> Parts:
    """Run a benchmark by its name, and return its tables.

    Args:
        name: Of the benchmark.
        wanted: What is asked of it.

    Raises:
        InputError: No benchmark of the name; an option that it does not have.
    """
    run = RUNS.get(name)
    if run is None:
        raise InputError(f"There is no benchmark '{name}'; there are {', '.join(RUNS)}.")
    for option in ("cases", "only", "replicates", "workers", "families", "displacement", "cap"):
        if option not in run.options and getattr(wanted, option) is not None:
            has = ", ".join(f"--{each}" for each in (*run.options, "seed"))
            raise InputError(f"--{option} does not apply to {name}; leave it out. It has {has}.")
    return run.tables(wanted)


def _hidden_effects(wanted: Wanted) -> Parts:
    from .hidden_effects.assumptions.cases import assumption_cases
    from .hidden_effects.cases import all_cases, subset
    from .hidden_effects.run import run
    from .tables import benchmark_tables

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
    from .hidden_effects.cases import subset
    from .hidden_effects.run import run
    from .hidden_effects.solvers import displacement_oracle, displacement_peers
    from .hidden_effects.solvers.displacement import displacement_cases, study_displacement
    from .hidden_effects.solvers.peers import available
    from .tables import benchmark_tables

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
    from bayes_greybox.report.plots import calibration, save_figures

    from .calibration import run, subset
    from .tables import calibration_tables

    def finished(name: str, found: "Calibration") -> None:
        save_figures({name: calibration(found)}, wanted.folder / "figures")

    cases = subset(wanted.cases)
    table = run(wanted.folder, cases, replicates=wanted.replicates or 500, finished=finished, **wanted.shown)
    return [*calibration_tables(table)]


def _confounding(wanted: Wanted) -> Parts:
    from bayes_greybox.report.plots import plot_confounding, save_figures

    from .confounding.run import REPLICATES, all_cells, run
    from .tables import confounding_tables

    cells = all_cells(wanted.replicates or REPLICATES, wanted.seed)
    scores = run(wanted.folder, cells, progress=wanted.progress)
    save_figures({"confounding": plot_confounding(scores.terms)}, wanted.folder)
    return [*confounding_tables(scores)]


def _sampled_systems(wanted: Wanted) -> Parts:
    from .sampled_systems.run import REPLICATES, run
    from .sampled_systems.systems import systems
    from .tables import sampled_tables

    replicates = wanted.replicates or REPLICATES
    return [*sampled_tables(run(wanted.folder, wanted.names(systems()), replicates=replicates, **wanted.shown))]


def _sampled_traps(wanted: Wanted) -> Parts:
    from .sampled_traps.run import run, traps
    from .tables import trap_tables

    return [*trap_tables(run(wanted.folder, cases=wanted.names(traps()), **wanted.shown))]


def _sampled_coverage(wanted: Wanted) -> Parts:
    from .sampled_systems.coverage import REPEATS, run
    from .tables import coverage_tables

    return [*coverage_tables(run(wanted.folder, repeats=wanted.replicates or REPEATS, **wanted.shown))]


def _hudson_bay(wanted: Wanted) -> Parts:
    from bayes_greybox.report.terminal.tables import frame_table

    from .hudson_bay.run import run

    quantities, samplers = run(wanted.folder, **wanted.shown)
    title = "Errors over the reference's standard deviations; standard deviations over its own"
    return [frame_table(title, quantities), frame_table("Samplers", samplers)]


def _speed(wanted: Wanted) -> Parts:
    from .speed.drawn import CAP, Settings
    from .speed.floor import floor
    from .speed.problems import problems
    from .speed.run import run
    from .tables import speed_tables

    settings = Settings(seed=wanted.seed, cap=wanted.cap or CAP)
    table = run(wanted.folder, problems()[: wanted.cases], settings=settings, progress=wanted.progress)
    return [*speed_tables(table, floor(wanted.folder, progress=wanted.progress))]


def _static_maps(wanted: Wanted) -> Parts:
    from .static_maps.maps import maps
    from .static_maps.run import REPLICATES, run
    from .tables import map_tables

    replicates = wanted.replicates or REPLICATES
    return [*map_tables(run(wanted.folder, wanted.names(maps()), replicates=replicates, **wanted.shown))]


def _memory_effects(wanted: Wanted) -> Parts:
    from .memory_effects.machines import machines
    from .memory_effects.run import REPLICATES, run
    from .tables import memory_tables

    replicates = wanted.replicates or REPLICATES
    return [*memory_tables(run(wanted.folder, wanted.names(machines()), replicates=replicates, **wanted.shown))]


def _spring_pendulum(wanted: Wanted) -> Parts:
    from .spring_pendulum.run import REPLICATES, cases, run
    from .tables import pendulum_tables

    replicates = wanted.replicates or REPLICATES
    return [*pendulum_tables(run(wanted.folder, wanted.names(cases()), replicates=replicates, **wanted.shown))]


def _next_experiment(wanted: Wanted) -> Parts:
    from .next_experiment.run import run
    from .tables import way_tables

    return [*way_tables(*run(wanted.folder, wanted.cases, **wanted.shown))]


def _weak_odes(wanted: Wanted) -> Parts:
    from .tables import weak_tables
    from .weak_odes.run import REPLICATES, run
    from .weak_odes.systems import weak_systems

    replicates = wanted.replicates or REPLICATES
    return [*weak_tables(run(wanted.folder, wanted.names(weak_systems()), replicates=replicates, **wanted.shown))]


def _weak_coverage(wanted: Wanted) -> Parts:
    from .tables import weak_tables
    from .weak_odes.run import COVERED, REPEATS, run
    from .weak_odes.systems import NOISES

    counted = wanted.replicates or REPEATS
    return [*weak_tables(run(wanted.folder, COVERED, noises=NOISES[:1], replicates=counted, **wanted.shown))]


def _published_odes(wanted: Wanted) -> Parts:
    from .published_odes.run import REPLICATES, run
    from .tables import ode_tables

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
