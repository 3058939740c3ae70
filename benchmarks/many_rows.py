"""Up to 10⁸ rows in generated chunks: what two passes over them cost, that sampling costs the same, and peak memory.

python -m benchmarks.many_rows             10⁶, 10⁷ and 10⁸ rows
python -m benchmarks.many_rows 1000000     any others
"""

import resource
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from bayes_greybox.data.streams.asked import CHUNK_ROWS, PART_ROWS
from bayes_greybox.data.streams.row_stream import RowStream
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.sampling import sample_posterior
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.priors import Laplace
from bayes_greybox.model.program import Program
from bayes_greybox.model.streams.taken import taken

SIZES = (10**6, 10**7, 10**8)
"""Rows."""

SAMPLING = Sampling(draws=500, tune=500, chains=2)
"""Chains that are timed."""

TRUE = {"y**3": -1.0, "ydot**3": -0.2}
"""Coefficients of the oscillator, and zero of the others."""


class Oscillator(NamedTuple):
    """Accelerations −y³ − 0.2 ẏ³ with 2 % noise at random states, some at a time; a source of rows.

    Attributes:
        n_row: How many.
    """

    n_row: int

    @property
    def where(self) -> str:
        """Nowhere."""
        return "a generator"

    @property
    def n_part(self) -> int:
        """Parts, of as many rows as those of a file."""
        return -(-self.n_row // PART_ROWS)

    def whole_runs(self) -> "Oscillator":
        """The same: rows of rates have no runs."""
        return self

    def chunks(self, part: int) -> Iterator[Trajectories]:
        """Rows of a part."""
        for start in range(part * PART_ROWS, min((part + 1) * PART_ROWS, self.n_row), CHUNK_ROWS):
            n, rng = min(CHUNK_ROWS, self.n_row - start), np.random.default_rng([start, 0])
            y, v = rng.uniform(-1, 1, n), rng.uniform(-0.7, 0.7, n)
            a = TRUE["y**3"] * y**3 + TRUE["ydot**3"] * v**3
            yield Trajectories.from_arrays(
                np.arange(start, start + n) * 1e-3,
                states={"y": y, "ydot": v},
                derivatives={"ydot": a + 0.0076 * rng.standard_normal(n)},
            )


class Cost(NamedTuple):
    """What a fit cost, each in seconds of wall time and of the processor.

    Attributes:
        n_row: Rows.
        ranges: The first pass, with the sample.
        statistics: The second pass.
        sampling: NUTS and exact draws, once compiled.
        megabytes: Largest resident memory of the process so far.
        off: Largest distance of a coefficient's mean from the truth, in its posterior standard deviations.
    """

    n_row: int
    ranges: tuple[float, float]
    statistics: tuple[float, float]
    sampling: tuple[float, float]
    megabytes: float
    off: float


def cost(n_row: int) -> Cost:
    """Fit so many rows.

    Args:
        n_row: Rows.
    """
    model = Program(
        dictionary={"ydot": ["y", "ydot", "y**2", "ydot**2", "y**3", "ydot**3"]}, prior=Laplace(), noise_floor=1e-4
    )
    clocks = [_now()]
    with threadpool_limits(1):
        model, data, rows = taken(model, RowStream(Oscillator(n_row)))
        clocks.append(_now())
        assert rows is not None
        whole = rows.statistics(model)
        clocks.append(_now())
        ranges, statistics = (_between(a, b) for a, b in pairwise(clocks))
        # The first compiles.
        sample_posterior(model, data, SAMPLING, progress=False, whole=whole)
        clocks.append(_now())
        fit = sample_posterior(model, data, SAMPLING, progress=False, whole=whole)
        sampling = _between(clocks[-1], _now())
    theta = fit.values("ydot")["theta"]
    truth = np.array([TRUE.get(name, 0.0) for name in fit.equations["ydot"].frame.dictionary.names])
    off = float(np.max(np.abs(theta.mean(axis=0) - truth) / theta.std(axis=0)))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return Cost(n_row, ranges, statistics, sampling, peak, off)


def main(sizes: tuple[int, ...]) -> None:
    """Print a row of a table for each number of rows.

    Args:
        sizes: Numbers of rows, in increasing order, as memory is that of the largest so far.
    """
    print("| rows | ranges | statistics | rows a second | sampling | peak memory, MB | farthest coefficient, sd |")
    print("|---|---|---|---|---|---|---|")
    for n_row in sizes:
        found = cost(n_row)
        rate = n_row / (found.ranges[1] + found.statistics[1])
        timed = " | ".join(f"{wall:.1f} ({cpu:.1f})" for wall, cpu in (found.ranges, found.statistics))
        wall, cpu = found.sampling
        cells = (f"{n_row:.0e}", timed, f"{rate:,.0f}", f"{wall:.1f} ({cpu:.1f})", f"{found.megabytes:.0f}")
        print(f"| {' | '.join(cells)} | {found.off:.1f} |", flush=True)
    print("Seconds of wall time, in brackets of the processor, by which rows a second are counted.")


def _now() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()


def _between(start: tuple[float, float], end: tuple[float, float]) -> tuple[float, float]:
    return end[0] - start[0], end[1] - start[1]


if __name__ == "__main__":
    main(tuple(map(int, sys.argv[1:])) or SIZES)
