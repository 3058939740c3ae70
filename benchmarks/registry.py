"""All benchmarks by name."""

from collections.abc import Mapping
from typing import Any

from bayes_greybox.running.errors import InputError

from .batteries.run import BATTERIES
from .blind_records.run import BLIND_RECORDS
from .calibration import CALIBRATION
from .compartments.run import COMPARTMENTS
from .confounding.run import CONFOUNDING
from .field_records.run import FIELD_RECORDS
from .hidden_effects.run import HIDDEN_EFFECTS
from .hudson_bay.run import HUDSON_BAY
from .measured_records.run import MEASURED_RECORDS
from .memory_effects.run import MEMORY_EFFECTS
from .named_parameters.run import NAMED_PARAMETERS
from .next_experiment.run import NEXT_EXPERIMENT
from .published_odes.run import PUBLISHED_ODES
from .runner import Asked, Benchmark, Tables, perform
from .sampled_systems.coverage import SAMPLED_COVERAGE
from .sampled_systems.run import SAMPLED_SYSTEMS
from .sampled_traps.run import SAMPLED_TRAPS
from .scale import MANY_ROWS, MANY_RUNS
from .speed.run import SPEED
from .spring_pendulum.run import SPRING_PENDULUM
from .static_maps.run import STATIC_MAPS
from .stopwatch import STOPWATCH
from .two_mass_houses.run import TWO_MASS_HOUSES
from .vehicles.run import VEHICLES
from .weak_odes.run import WEAK_COVERAGE, WEAK_ODES

BENCHMARKS: dict[str, Benchmark] = {
    benchmark.name: benchmark
    for benchmark in (
        HIDDEN_EFFECTS, CALIBRATION, CONFOUNDING, SAMPLED_SYSTEMS, SAMPLED_TRAPS, SAMPLED_COVERAGE, PUBLISHED_ODES,
        STATIC_MAPS, MEMORY_EFFECTS, NAMED_PARAMETERS, TWO_MASS_HOUSES, BATTERIES, COMPARTMENTS, VEHICLES,
        SPRING_PENDULUM, NEXT_EXPERIMENT,
        WEAK_ODES, WEAK_COVERAGE, HUDSON_BAY, BLIND_RECORDS, FIELD_RECORDS, MEASURED_RECORDS, SPEED, MANY_ROWS,
        MANY_RUNS, STOPWATCH,
    )
}  # fmt: skip
"""Benchmarks by name, in the order in which they are listed."""


def run_benchmark(name: str, options: Mapping[str, Any]) -> Tables:
    """Run a benchmark by its name, and return its tables for a terminal, by title.

    The options are folder, progress, and those of the benchmark; None stands for its default.

    Raises:
        InputError: No benchmark has the name; the benchmark does not understand an option.
    """
    benchmark = BENCHMARKS.get(name)
    if benchmark is None:
        raise InputError(f"There is no benchmark '{name}'; there are {', '.join(BENCHMARKS)}.")
    chosen = {option: value for option, value in options.items() if value is not None}
    for option in chosen:
        if option not in (*benchmark.options, "folder", "progress"):
            understood = ", ".join(f"--{each}" for each in benchmark.options)
            raise InputError(f"--{option} does not apply to {name}; leave it out. It has {understood}.")
    asked = Asked(**{**benchmark.options, **chosen})
    return benchmark.show(perform(benchmark, benchmark.cases(asked), asked))
