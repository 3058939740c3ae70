"""Cutting, thinning and resampling of runs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

import numpy as np
from jaxtyping import Int

from bayes_greybox.data.columns import split_cuts
from bayes_greybox.data.noise.protocol import RowNoise, rows_within
from bayes_greybox.data.noise.weighted import WhiteNoise
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.limits import is_finite

from .resampling import decimated, even_times, interpolated, rows_named
from .stacked import Runs

AnyRuns = TypeVar("AnyRuns", bound="CutRuns")  # class of the data that are cut, and of the result


@dataclass(frozen=True, eq=False, repr=False)
class CutRuns(Runs):
    """Runs of which parts can be taken; each part records in `remarks` what was done."""

    def take(self: AnyRuns, run: int | str) -> AnyRuns:
        """Return one run, by number or name; a run that there is not is refused."""
        if isinstance(run, str) and run in self.run_names:
            index = self.run_names.index(run)
        elif isinstance(run, int | np.integer) and -self.n_run <= run < self.n_run:
            index = run % self.n_run
        else:
            raise InputError(f"There is no run {run!r}; there are {', '.join(self.run_names)}.")
        return self._restrict([(0, n if i == index else 0) for i, n in enumerate(self.run_lengths)])

    def leave_out(self: AnyRuns, runs: str | Sequence[str]) -> AnyRuns:
        """Return the other runs, as in `run_names`.

        Raises:
            InputError: There is no such run, or no other is left.
        """
        names = [runs] if isinstance(runs, str) else [*runs]
        for name in names:
            if name not in self.run_names:
                raise InputError(f"There is no run {name!r} to leave out; there are {', '.join(self.run_names)}.")
        if set(names) == set(self.run_names):
            raise InputError("No run is left: keep at least one.")
        kept = zip(self.run_names, self.run_lengths, strict=True)
        rest = self._restrict([(0, 0 if name in names else n) for name, n in kept])
        return rest.remarked(f"runs that were left out: {', '.join(names)}")

    def keep(self: AnyRuns, rows: Any) -> AnyRuns:
        """Keep some rows; a run that has none of them is left out.

        Args:
            rows: Numbers of rows from 0, a slice, or True for each row that stays.

        Raises:
            InputError: Rows that there are not; none stays; rows of a filter, whose noise depends on their neighbours.
        """
        rows = rows_named(rows, self.n_obs)
        if np.all(rows):
            return self
        if not np.any(rows):
            raise InputError("No row is left: keep at least one.")
        if any(not noise.local for noise in self.noise.values()):
            raise InputError("Rows of filtered rates share samples: leave rows out before data.differentiate().")
        kept = self._at(np.flatnonzero(rows), {})
        white = {name: WhiteNoise(kept.run_lengths) for name in self.noise}
        return replace(kept, noise=white, dropped=self.dropped + int(np.sum(~rows)))

    def resample(self: AnyRuns, step: float, method: Literal["cubic", "linear", "held"] = "cubic") -> AnyRuns:
        """Interpolate the same runs at evenly spaced times, each from its first sample on.

        Noise of neighbouring rows is no longer independent: a row between two samples has part of the noise of both.

        Args:
            step: Distance of the times, at most 1.5 times the usual one of the samples; see `decimate` for larger ones.
            method: "cubic" (spline through the samples), "linear" or "held", for all columns.

        Raises:
            InputError: Rates that were computed before; a gap, in which nothing is invented; a step that is too large.
        """
        if method not in ("cubic", "linear", "held"):
            raise InputError(f'method must be "cubic", "linear" or "held", not {method!r}.')
        if not (is_finite(step) and step > 0.0):
            raise InputError(f"step must be positive and a number, not {step!r}.")
        times = [even_times(self.time[rows], step, name) for name, rows in self._blocks("resample")]
        by = {"cubic": "a cubic spline", "linear": "lines", "held": "holding each sample"}[method]
        remark = f"resampled every {step:g} by {by} through the samples of each run: {self.n_obs} rows to "
        return self._at_times(times, lambda i, t, x: interpolated(t, x, times[i], method), remark)

    def decimate(self: AnyRuns, factor: int) -> AnyRuns:
        """Keep one of so many rows of each run, behind a low pass that removes faster motion than they can show.

        The filter is SciPy's finite one of `scipy.signal.decimate`, symmetric and therefore without delay: half the
        amplitude at the new Nyquist frequency. The 10 rows at either edge of a run, where it has no samples, are left
        out and counted in `dropped`.

        Args:
            factor: Rows that become one, 2 or more.

        Raises:
            InputError: Rates that were computed before; uneven stamps; a run too short.
        """
        if not isinstance(factor, int | np.integer) or isinstance(factor, bool) or factor < 2:
            raise InputError(f"factor must be a whole number, 2 or more, not {factor!r}.")
        factor = int(factor)
        stamps = [(name, self.time[rows]) for name, rows in self._blocks("decimate")]
        times = [decimated(time, time, factor, name)[0] for name, time in stamps]
        remark = f"decimated by {factor} behind a symmetric low pass, the rows at edges left out: {self.n_obs} rows to "
        data = self._at_times(times, lambda i, t, x: decimated(t, x, factor, self.run_names[i])[1], remark)
        return replace(data, dropped=self.dropped + sum(-(-n // factor) for n in self.run_lengths) - data.n_obs)

    def trim(self: AnyRuns, start: float | None = None, end: float | None = None) -> AnyRuns:
        """Keep the rows from one time to another, both included, of every run; a run that has none is left out.

        None as a limit is the first or last time of each run.

        Raises:
            InputError: There is no limit, or no row within.
        """
        if start is None and end is None:
            raise InputError("trim needs start, end or both, in the unit of the time.")
        for name, limit in (("start", start), ("end", end)):
            if limit is not None and not (is_finite(limit) or limit in (-np.inf, np.inf)):
                raise InputError(f"{name} must be a number, in the unit of the time, not {limit!r}.")
        inside = (self.time >= (-np.inf if start is None else start)) & (self.time <= (np.inf if end is None else end))
        if not np.any(inside):
            raise InputError(
                f"No row lies between {start} and {end}: the times of the data run from {self.time.min():.12g} to "
                f"{self.time.max():.12g}."
            )
        parts = [np.flatnonzero(inside[rows]) for rows in self.run_rows]
        bounds = [(int(part[0]), int(part[-1]) + 1) if len(part) else (0, 0) for part in parts]
        where = " ".join(f"{word} {at:.12g}" for word, at in (("from", start), ("to", end)) if at is not None)
        kept = self._restrict(bounds)
        return kept.remarked(f"trimmed to times {where}: {self.n_obs} rows to {kept.n_obs}")

    def drop(self: AnyRuns, rows: Any) -> AnyRuns:
        """Leave out some rows, named as in `keep` and under the same conditions."""
        named = rows_named(rows, self.n_obs)
        kept = self.keep(~named)
        return kept.remarked(f"{int(np.sum(named))} of {self.n_obs} rows dropped on request") if np.any(named) else kept

    def remarked(self: AnyRuns, *remarks: str) -> AnyRuns:
        """Return the same data with more remarks on what was done to them."""
        return replace(self, remarks=(*self.remarks, *remarks))

    def split(self: AnyRuns, fraction: float, by: Literal["time", "trajectory"] = "time") -> tuple[AnyRuns, AnyRuns]:
        """Split into a first part to fit and a second part to test.

        Rows that a filter of width w computed share samples with their w − 1 neighbours on either side; split
        before `differentiate` if the parts must not share any.

        Args:
            fraction: share of the first part, between 0 and 1.
            by: "time" cuts every run once, keeping rows contiguous; "trajectory" gives whole runs, in order.

        Raises:
            InputError: if a part would be empty, or the rows of a run cannot be parted.
        """
        cuts = split_cuts(self.run_lengths, self.run_names, fraction, by)
        first = self._restrict([(0, cut) for cut in cuts])
        second = self._restrict([(cut, n) for cut, n in zip(cuts, self.run_lengths, strict=True)])
        return first, replace(second, before=first)

    @property
    def _computed(self) -> bool:
        """True if rates were computed from neighbouring rows."""
        return bool(self.noise)

    def _blocks(self, what: str) -> list[tuple[str, np.ndarray]]:
        """Return name and rows of each run, if the data are still as they were measured."""
        if self._computed:
            raise InputError(f"Rates of these data were computed from neighbouring rows: {what} before differentiate.")
        return list(zip(self.run_names, self.run_rows, strict=True))

    def _at_times(
        self: AnyRuns, times: Sequence[np.ndarray], column: Callable[..., np.ndarray], remark: str
    ) -> AnyRuns:
        """Return data at other times; new values of a column are a function of a run's number, stamps and values."""
        blocks = self.run_rows

        def moved(values: np.ndarray) -> np.ndarray:
            return np.concatenate([column(i, self.time[rows], values[rows]) for i, rows in enumerate(blocks)])

        run = np.repeat(np.arange(self.n_run), [len(each) for each in times])
        data = replace(self, time=np.concatenate(times), run=run, **self.each_column(moved))
        return data.remarked(f"{remark}{data.n_obs}")

    def _restrict(self: AnyRuns, bounds: Sequence[tuple[int, int]]) -> AnyRuns:
        """Return contiguous rows of each run, as half-open ranges; a run with an empty range is left out."""
        rows = rows_within(self.run_lengths, bounds)
        return self._at(rows, {name: noise.restrict(bounds) for name, noise in self.noise.items()})

    def _at(self: AnyRuns, rows: Int[np.ndarray, " n_row"], noise: Mapping[str, RowNoise]) -> AnyRuns:
        """Return some rows, in order, with the noise of their rates; a run that has none of them is left out."""
        run, number = np.unique(self.run[rows], return_inverse=True)
        columns = self.each_column(lambda values: values[rows])
        names = tuple(self.run_names[i] for i in run)
        return replace(self, time=self.time[rows], run=number, noise=noise, run_names=names, **columns)
