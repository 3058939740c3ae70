"""Costs of many rows and of many short runs, in generated chunks: passes over them, sampling, and peak memory.

Up to 10⁸ rows of rates are passed over twice, and sampling costs the same for all. Of short runs the states are
sampled.
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
import pandas as pd

from bayes_greybox.data.streams.asked import CHUNK_ROWS, PART_ROWS
from bayes_greybox.data.trajectories import Trajectories
from benchmarks.runner import Benchmark, Case, Record, Tables

RUN_SAMPLES, TOGETHER, RUNS_A_PART = 50, 40, 2_000
"""Samples of a run, runs of a chunk, and of a part."""

OSCILLATOR = {"y**3": -1.0, "ydot**3": -0.2}
"""Coefficients of the oscillator, and zero of the others."""

GROWTH = {"x": 1.0, "x**2": -0.5, "x**3": 0.0}
"""Coefficients of the growth."""


@dataclass(frozen=True)
class Generated:
    """A source of so many rows, or of so many short runs."""

    n: int
    a_part: ClassVar[int] = PART_ROWS

    @property
    def where(self) -> str:
        """Place of the data."""
        return "a generator"

    @property
    def n_part(self) -> int:
        """Number of parts."""
        return -(-self.n // self.a_part)

    def whole_runs(self) -> Self:
        """Return the same: rows of rates have no runs, and runs are whole."""
        return self


class Oscillator(Generated):
    """Accelerations −y³ − 0.2 ẏ³ with 2 % noise at random states."""

    def chunks(self, part: int) -> Iterator[Trajectories]:
        """Yield the rows of a part."""
        for start in range(part * PART_ROWS, min((part + 1) * PART_ROWS, self.n), CHUNK_ROWS):
            n, rng = min(CHUNK_ROWS, self.n - start), np.random.default_rng([start, 0])
            y, v = rng.uniform(-1, 1, n), rng.uniform(-0.7, 0.7, n)
            a = OSCILLATOR["y**3"] * y**3 + OSCILLATOR["ydot**3"] * v**3
            yield Trajectories.from_arrays(
                np.arange(start, start + n) * 1e-3,
                states={"y": y, "ydot": v},
                derivatives={"ydot": a + 0.0076 * rng.standard_normal(n)},
            )


class Growth(Generated):
    """Logistic growth dx/dt = x − x²/2 from random starts, sampled with noise of 0.01."""

    a_part = RUNS_A_PART

    def chunks(self, part: int) -> Iterator[Trajectories]:
        """Yield the runs of a part."""
        for first in range(part * RUNS_A_PART, min((part + 1) * RUNS_A_PART, self.n), TOGETHER):
            n, rng = min(TOGETHER, self.n - first), np.random.default_rng([first, 1])
            t, start = 0.1 * np.arange(RUN_SAMPLES), rng.uniform(0.05, 1.0, n)
            # x = 2/(1 + (2/x₀ − 1) e^−t)
            x = 2.0 / (1.0 + (2.0 / start[:, None] - 1.0) * np.exp(-t)) + 0.01 * rng.standard_normal((n, RUN_SAMPLES))
            names = [str(first + k) for k in range(n)]
            yield Trajectories.from_arrays([t] * n, states={"x": list(x)}, run_names=names)


class Clock:
    """A clock that tells the time since it was last asked."""

    def __init__(self) -> None:
        """Start."""
        self._last = time.perf_counter(), time.process_time()

    def lap(self, name: str) -> dict[str, float]:
        """Return seconds of wall time and of the processor since the last lap."""
        before, self._last = self._last, (time.perf_counter(), time.process_time())
        return {f"{name}, s": self._last[0] - before[0], f"{name}, CPU": self._last[1] - before[1]}


def fit_of_rows(n_row: int) -> dict[str, Any]:
    """Fit so many rows: the first pass, with the sample, gives ranges, the second statistics."""
    # Imported here: these bring JAX.
    from bayes_greybox.data.streams.row_stream import RowStream
    from bayes_greybox.inference.sampling import sample_posterior
    from bayes_greybox.inference.settings import Sampling
    from bayes_greybox.model.priors import Laplace
    from bayes_greybox.model.program import Program
    from bayes_greybox.model.streams.taken import taken

    terms = ["y", "ydot", "y**2", "ydot**2", "y**3", "ydot**3"]
    model = Program(dictionary={"ydot": terms}, prior=Laplace(), noise_floor=1e-4)
    sampling = Sampling(draws=500, tune=500, chains=2)
    clock = Clock()
    model, data, rows = taken(model, RowStream(Oscillator(n_row)))
    ranges = clock.lap("ranges")
    assert rows is not None
    whole = rows.statistics(model)
    statistics = clock.lap("statistics")
    # The first compiles.
    sample_posterior(model, data, sampling, progress=False, whole=whole)
    clock.lap("compiling")
    fit = sample_posterior(model, data, sampling, progress=False, whole=whole)
    sampled = clock.lap("sampling")
    theta = fit.values("ydot")["theta"]
    truth = np.array([OSCILLATOR.get(name, 0.0) for name in fit.equations["ydot"].frame.dictionary.names])
    return {
        **ranges,
        **statistics,
        "rows a second": n_row / (ranges["ranges, CPU"] + statistics["statistics, CPU"]),
        **sampled,
        "peak memory, MB": _peak(),
        "farthest coefficient, sd": float(np.max(np.abs(theta.mean(axis=0) - truth) / theta.std(axis=0))),
    }


def statistics_of_runs(kind: str, n_run: int) -> dict[str, Any]:
    """Take statistics of so many runs, "weak" or "trajectory", and the least-squares estimate from them."""
    # Imported here: these bring JAX.
    from bayes_greybox.data.streams.row_stream import RowStream
    from bayes_greybox.model.program import Program
    from bayes_greybox.model.rows.kinds import ROW_KINDS
    from bayes_greybox.model.streams.statistics import equations_of
    from bayes_greybox.model.streams.taken import taken

    model = Program(dictionary={"x": list(GROWTH)}, discrepancy=None, rows=ROW_KINDS[kind]())
    clock = Clock()
    model, sample, rows = taken(model, RowStream(Growth(n_run)))
    assert rows is not None
    statistics = rows.statistics(model)
    passed = clock.lap("statistics")
    (equation,) = equations_of(model, sample, statistics).values()
    return {
        "samples": n_run * RUN_SAMPLES,
        **passed,
        "runs a second": n_run / passed["statistics, CPU"],
        "peak memory, MB": _peak(),
        "farthest coefficient, sd": equation.moved(
            [(term, GROWTH[term.text]) for term in equation.frame.dictionary.terms]
        ),
    }


def score(records: list[Record]) -> Tables:
    """Return one row for each number of rows or of runs; memory is that of the largest so far."""
    rows = [{key: value for key, value in record.items() if key not in ("key", "version")} for record in records]
    return {"costs": pd.DataFrame(rows).set_index("size")}


def _peak() -> float:
    """Return the largest resident memory of this process so far, in MB."""
    import resource  # there is none on Windows

    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # Bytes on macOS, else kilobytes.
    return used / (2**20 if sys.platform == "darwin" else 1024)


MANY_ROWS = Benchmark(
    "many-rows",
    "fits up to 10⁸ generated rows of rates, in chunks: costs of both passes, of sampling, and peak memory.",
    {"size": (10**6, 10**7, 10**8)},
    lambda asked: [Case(f"{n}", (n,), {"size": n}) for n in sorted(asked.size or ())],
    fit_of_rows,
    score,
    lambda tables: {"Seconds of wall time, and of the processor (CPU), by which rates count": tables["costs"]},
    threads=1,
    resumes=False,
)

MANY_RUNS = replace(
    MANY_ROWS,
    name="many-runs",
    about="takes statistics of many generated short runs, rows weak by default, or trajectory: costs and peak memory.",
    options={"only": ("weak",), "size": (1_000, 10_000, 100_000)},
    cases=lambda asked: [
        Case(f"{kind}/{n}", (kind, n), {"size": n, "rows": kind})
        for kind in asked.names(("weak", "trajectory"), "kind of rows")
        for n in sorted(asked.size or ())
    ],
    run=statistics_of_runs,
)
