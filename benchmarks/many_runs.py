"""Many short runs whose states are sampled, in generated chunks: what passes over their paths cost, and peak memory.

python -m benchmarks.many_runs weak                     1,000, 10,000 and 100,000 runs
python -m benchmarks.many_runs trajectory 100 1000      rows of samples, of any numbers of runs
"""

import resource
import sys
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from bayes_greybox.data.streams.row_stream import RowStream
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.kinds import ROW_KINDS
from bayes_greybox.model.streams.statistics import equations_of
from bayes_greybox.model.streams.taken import taken

SIZES = (1_000, 10_000, 100_000)
"""Runs."""

LENGTH, TOGETHER, PART = 50, 40, 2_000
"""Samples of a run, runs of a chunk, and of a part."""

TRUE = {"x": 1.0, "x**2": -0.5, "x**3": 0.0}
"""Coefficients."""


class Growth(NamedTuple):
    """Logistic growth dx/dt = x − x²/2 from random starts, sampled with noise of 0.01; a source of whole runs.

    Attributes:
        n_run: How many.
    """

    n_run: int

    @property
    def where(self) -> str:
        """Nowhere."""
        return "a generator"

    @property
    def n_part(self) -> int:
        """Parts."""
        return -(-self.n_run // PART)

    def whole_runs(self) -> "Growth":
        """These are."""
        return self

    def chunks(self, part: int) -> Iterator[Trajectories]:
        """Runs of a part."""
        for first in range(part * PART, min((part + 1) * PART, self.n_run), TOGETHER):
            n, rng = min(TOGETHER, self.n_run - first), np.random.default_rng([first, 1])
            t, start = 0.1 * np.arange(LENGTH), rng.uniform(0.05, 1.0, n)
            # x = 2/(1 + (2/x₀ − 1) e^−t)
            x = 2.0 / (1.0 + (2.0 / start[:, None] - 1.0) * np.exp(-t)) + 0.01 * rng.standard_normal((n, LENGTH))
            names = [str(first + k) for k in range(n)]
            yield Trajectories.from_arrays([t] * n, states={"x": list(x)}, run_names=names)


class Cost(NamedTuple):
    """What all runs cost.

    Attributes:
        seconds: Of wall time, from the sample to the statistics.
        processor: Of the processor's time.
        megabytes: Largest resident memory of the process so far.
        off: Largest distance of a coefficient from the truth, in its standard deviations.
    """

    seconds: float
    processor: float
    megabytes: float
    off: float


def cost(kind: str, n_run: int) -> Cost:
    """Statistics of so many runs, and the least-squares estimate from them.

    Args:
        kind: "weak" or "trajectory".
        n_run: Runs.
    """
    model = Program(dictionary={"x": list(TRUE)}, discrepancy=None, rows=ROW_KINDS[kind]())
    wall, processor = time.perf_counter(), time.process_time()
    with threadpool_limits(1):
        model, sample, rows = taken(model, RowStream(Growth(n_run)))
        assert rows is not None
        statistics = rows.statistics(model)
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    (equation,) = equations_of(model, sample, statistics).values()
    off = equation.moved([(term, TRUE[term.text]) for term in equation.frame.dictionary.terms])
    return Cost(wall, processor, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, off)


def main(kind: str, sizes: tuple[int, ...]) -> None:
    """Print a row of a table for each number of runs.

    Args:
        kind: Of rows.
        sizes: Numbers of runs, in increasing order, as memory is that of the largest so far.
    """
    print("| rows | runs | samples | seconds | runs a second | peak memory, MB | farthest coefficient, sd |")
    print("|---|---|---|---|---|---|---|")
    for n_run in sizes:
        found = cost(kind, n_run)
        timed = f"{found.seconds:.1f} ({found.processor:.1f})"
        cells = (kind, f"{n_run:,}", f"{n_run * LENGTH:,}", timed, f"{n_run / found.processor:,.0f}")
        print(f"| {' | '.join(cells)} | {found.megabytes:.0f} | {found.off:.1f} |", flush=True)
    print("Seconds of wall time, in brackets of the processor, by which runs a second are counted.")


if __name__ == "__main__":
    main(sys.argv[1], tuple(map(int, sys.argv[2:])) or SIZES)
