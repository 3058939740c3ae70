"""Measured runs: time, states, inputs, measured derivatives and outputs, stacked row by row."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import pandas as pd
from jaxtyping import Bool, Int

from .columns import (
    check_names,
    check_times,
    check_units,
    check_varying,
    derivative_label,
    name_runs,
    number_runs,
    rate_unit,
    several,
    split_cuts,
    stack,
    usable_rows,
)
from .errors import InputError
from .noise.files import noise_from_dict
from .noise.protocol import WHITE_SHARE, RowNoise
from .noise.white import WhiteNoise
from .rates.differentiate import differentiate, uniform_step
from .rates.rate_filter import RateFilter
from .resampling import decimated, even_times, interpolated, rows_named
from .runs import Runs


@dataclass(frozen=True, eq=False, repr=False)
class Trajectories(Runs):
    """Rows of one or several runs, stacked; build with `read` or `from_arrays`.

    Attributes:
        time: time stamps, strictly increasing within each run.
        run: number of the run of each row, 0, 1, …, in order.
        states: state columns by name.
        inputs: input columns by name.
        derivatives: time derivative of the state with that name; and under a name that is no state's an output, a
            measured quantity whose equation has no derivative in it.
        units: unit by column name; the time's under "t", a derivative's under "d(name)/dt" if it was given.
        noise: covariance of the rows of derivatives and outputs by name; a missing name means independent rows.
        run_names: name of each run.
        dropped: rows left out so far (missing values, edges of filters).
        time_name: name of the time in expressions and tables.
        filter: what computed the derivatives; None if they were measured, or there are none.
        remarks: what was done to the measurements, in order, in words; shown by repr.
        samples: what the sensors showed, where states are a path through it and rates are that path's; None where the
            states are the samples.
        unseen: rows at which a sensor was known to be at its end before the samples were put right; None where they
            tell it themselves.
    """

    samples: "Trajectories | None" = None
    unseen: Bool[np.ndarray, " n_obs"] | None = None

    @classmethod
    def from_arrays(
        cls,
        t: Any,
        *,
        states: Mapping[str, Any] | None = None,
        derivatives: Mapping[str, Any] | None = None,
        inputs: Mapping[str, Any] | None = None,
        outputs: Mapping[str, Any] | None = None,
        units: Mapping[str, str] | None = None,
        run_names: Sequence[str] | None = None,
        missing: Literal["error", "drop"] = "error",
        constant: Literal["error", "keep"] = "error",
    ) -> "Trajectories":
        """Build from arrays, one for each column, or from lists of arrays, one for each run.

        Args:
            t: time stamps, (n,), or a list of such arrays of any lengths, one for each run; numbers of the rows where
                these have no order in time, as those of a map that was measured point by point.
            states: state columns by name, each shaped as `t`; beside inputs and outputs there may be none.
            derivatives: measured time derivative of the state with that name, if there is one.
            inputs: input columns by name.
            outputs: columns by name that were measured beside states and inputs and follow from these of the same row,
                F = g(x, u) + …, such as a force or a flow.
            units: unit by column name, the time's under "t", a derivative's under "d(name)/dt".
            run_names: names of the runs; "0", "1", … if left out.
            missing: "error" refuses NaN and infinite values, "drop" leaves out their rows and counts them in
                `dropped`; nothing is interpolated.
            constant: "error" refuses a state or input that never changes, "keep" allows it (held-out data
                with the input switched off).

        Returns:
            The checked data.

        Raises:
            InputError: if lengths, names, stamps or values cannot be used; the message says which.
        """
        runs = several(t)
        names = name_runs(run_names, len(runs))
        states, inputs, derivatives, units = states or {}, inputs or {}, derivatives or {}, units or {}
        outputs = outputs or {}
        check_names(states, inputs, derivatives, outputs)
        check_units(units, states, inputs, outputs)
        labels = {"time": ("time", t)}
        labels |= {f"s:{k}": (f'state "{k}"', v) for k, v in states.items()}
        labels |= {f"i:{k}": (f'input "{k}"', v) for k, v in inputs.items()}
        labels |= {f"d:{k}": (f'derivative of "{k}"', v) for k, v in derivatives.items()}
        labels |= {f"o:{k}": (f'output "{k}"', v) for k, v in outputs.items()}
        lengths = [len(stamps) for stamps in runs]
        columns = {key: stack(label, value, names, lengths) for key, (label, value) in labels.items()}
        run = np.repeat(np.arange(len(runs)), lengths)

        keep = usable_rows({labels[k][0]: v for k, v in columns.items()}, run, names, missing)
        dropped = int(np.sum(~keep))
        run, columns = run[keep], {key: value[keep] for key, value in columns.items()}
        check_times(columns["time"], run, names)
        if constant != "keep":
            check_varying({labels[k][0]: v for k, v in columns.items() if k[:2] in ("s:", "i:")})
        return cls(
            time=columns["time"],
            run=run,
            states={k: columns[f"s:{k}"] for k in states},
            inputs={k: columns[f"i:{k}"] for k in inputs},
            derivatives={**{k: columns[f"d:{k}"] for k in derivatives}, **{k: columns[f"o:{k}"] for k in outputs}},
            units=dict(units),
            run_names=names,
            dropped=dropped,
        )

    @classmethod
    def from_frame(
        cls,
        frame: pd.DataFrame,
        *,
        states: Sequence[str],
        inputs: Sequence[str] = (),
        derivatives: Sequence[str] = (),
        outputs: Sequence[str] = (),
        units: Mapping[str, str] | None = None,
        noise: Mapping[str, Mapping[str, Any]] | None = None,
        run_names: Sequence[str] | None = None,
        dropped: int = 0,
        time_name: str = "t",
        filter: Mapping[str, Any] | None = None,
        unseen: Sequence[int] | None = None,
        remarks: Sequence[str] = (),
    ) -> "Trajectories":
        """Inverse of `to_frame`: `Trajectories.from_frame(data.to_frame(), **data.metadata())`.

        Args:
            frame: one row for each sample, columns named as `to_frame` names them; rows of a run lie together, and
                its column "run" has its number or its name.
            states: names of the states.
            inputs: names of the inputs.
            derivatives: states whose derivative is in the table.
            outputs: names of the outputs.
            units: as in `from_arrays`.
            noise: plain records of the row noise, by state or output.
            run_names: name of each run; those that the table has, in order, if left out.
            dropped: rows left out before.
            time_name: name of the time column.
            filter: plain record of the filter of the derivatives.
            unseen: rows at which a sensor was at its end, where the samples do not tell it.
            remarks: what was done to the measurements.

        Returns:
            The data, equal to the last bit.

        Raises:
            InputError: if a column is not in the table, or its runs are not those of `run_names`.
        """
        rates = {k: derivative_label(k, time_name) for k in derivatives} | {k: k for k in outputs}
        wanted = [time_name, "run", *states, *inputs, *rates.values()]
        absent = [name for name in wanted if name not in frame.columns]
        if absent:
            raise InputError(f'The table has no column "{absent[0]}"; it has {", ".join(map(str, frame.columns))}.')

        def column(name: str) -> np.ndarray:
            return frame[name].to_numpy(dtype=float, copy=True)

        run, names = number_runs(frame["run"], run_names)
        return cls(
            time=column(time_name),
            run=run,
            states={k: column(k) for k in states},
            inputs={k: column(k) for k in inputs},
            derivatives={k: column(label) for k, label in rates.items()},
            units=dict(units or {}),
            noise={k: noise_from_dict(v) for k, v in (noise or {}).items()},
            run_names=names,
            dropped=dropped,
            time_name=time_name,
            filter=None if filter is None else RateFilter.from_dict(filter),
            unseen=None if unseen is None else np.isin(np.arange(len(frame)), unseen),
            remarks=tuple(remarks),
        )

    def take(self, run: int | str) -> "Trajectories":
        """One run, by number or name.

        Raises:
            InputError: if there is no such run.
        """
        if isinstance(run, str) and run in self.run_names:
            index = self.run_names.index(run)
        elif isinstance(run, int | np.integer) and -self.n_run <= run < self.n_run:
            index = run % self.n_run
        else:
            raise InputError(f"There is no run {run!r}; there are {', '.join(self.run_names)}.")
        return self._restrict([(0, n if i == index else 0) for i, n in enumerate(self.run_lengths)])

    def keep(self, rows: Bool[np.ndarray, " n_obs"]) -> "Trajectories":
        """Some rows; a run that has none of them is left out.

        Args:
            rows: Whether each row stays.

        Raises:
            InputError: None stays; rows of a filter, whose noise knows of their neighbours.
        """
        if np.all(rows):
            return self
        if not np.any(rows):
            raise InputError("No row is left: keep at least one.")
        if any(not noise.local for noise in self.noise.values()):
            raise InputError("Rows of filtered rates hang together: leave rows out before data.differentiate().")
        kept = self._at(np.flatnonzero(rows), {})
        white = {name: WhiteNoise(kept.run_lengths) for name in self.noise}
        return replace(kept, noise=white, dropped=self.dropped + int(np.sum(~rows)))

    def resample(self, step: float, method: Literal["cubic", "linear", "held"] = "cubic") -> "Trajectories":
        """The same runs at evenly spaced times, each from its first sample on.

        Noise of neighbouring rows is no longer independent: a row between two samples has part of the noise of both.

        Args:
            step: Distance of the times, at most 1.5 times the usual one of the samples; see `decimate` for larger ones.
            method: "cubic" (spline through the samples), "linear" or "held", for all columns.

        Returns:
            Data whose `remarks` say what was done.

        Raises:
            InputError: Rates that were computed before; a gap, in which nothing is invented; a step that is too large.
        """
        if method not in ("cubic", "linear", "held"):
            raise InputError(f'method must be "cubic", "linear" or "held", not {method!r}.')
        if not step > 0.0:
            raise InputError(f"step must be positive, not {step}.")
        times = [even_times(self.time[rows], step, name) for name, rows in self._blocks("resample")]
        by = {"cubic": "a cubic spline", "linear": "lines", "held": "holding each sample"}[method]
        remark = f"resampled every {step:g} by {by} through the samples of each run: {self.n_obs} rows to "
        return self._at_times(times, lambda i, t, x: interpolated(t, x, times[i], method), remark)

    def decimate(self, factor: int) -> "Trajectories":
        """Every so many rows of each run behind a low pass that keeps out what they could not show.

        The filter is SciPy's finite one of `scipy.signal.decimate`, symmetric and therefore without delay: half the
        amplitude at the new Nyquist frequency. The 10 rows at either edge of a run, where it has no samples, are left
        out and counted in `dropped`.

        Args:
            factor: Rows that become one, 2 or more.

        Returns:
            Data whose `remarks` say what was done.

        Raises:
            InputError: Rates that were computed before; uneven stamps; a run too short.
        """
        if not isinstance(factor, int | np.integer) or isinstance(factor, bool) or factor < 2:
            raise InputError(f"factor must be a whole number, 2 or more, not {factor!r}.")
        found = [decimated(self.time[rows], [], int(factor), name) for name, rows in self._blocks("decimate")]
        remark = f"decimated by {factor} behind a symmetric low pass, the rows at edges left out: {self.n_obs} rows to "
        names = self.run_names
        edges = sum(-(-n // int(factor)) - len(t) for n, (t, _) in zip(self.run_lengths, found, strict=True))
        data = self._at_times(
            [t for t, _ in found], lambda i, t, x: decimated(t, [x], int(factor), names[i])[1][0], remark
        )
        return replace(data, dropped=self.dropped + edges)

    def trim(self, start: float | None = None, end: float | None = None) -> "Trajectories":
        """Rows from one time to another, both included, of every run; a run that has none is left out.

        Args:
            start: First time; None for that of each run.
            end: Last time; None for that of each run.

        Returns:
            Data whose `remarks` say what was done.

        Raises:
            InputError: No limit; no row within.
        """
        if start is None and end is None:
            raise InputError("trim needs start, end or both, in the unit of the time.")
        inside = np.ones(self.n_obs, dtype=bool)
        inside &= self.time >= (-np.inf if start is None else start)
        inside &= self.time <= (np.inf if end is None else end)
        if not np.any(inside):
            raise InputError(
                f"No row lies between {start} and {end}: the times of the data run from {self.time.min():g} to "
                f"{self.time.max():g}."
            )
        parts = [np.flatnonzero(inside[self.run == i]) for i in range(self.n_run)]
        bounds = [(int(part[0]), int(part[-1]) + 1) if len(part) else (0, 0) for part in parts]
        where = " ".join(f"{word} {at:g}" for word, at in (("from", start), ("to", end)) if at is not None)
        kept = self._restrict(bounds)
        return kept.remarked(f"trimmed to times {where}: {self.n_obs} rows to {kept.n_obs}")

    def drop(self, rows: Any) -> "Trajectories":
        """The data without some rows; see `keep`.

        Args:
            rows: Numbers of rows from 0, a slice, or whether each row is left out.

        Returns:
            Data whose `remarks` say what was done.

        Raises:
            InputError: Rows that there are not; all of them; rows of a filter, whose noise knows of their neighbours.
        """
        named = rows_named(rows, self.n_obs)
        kept = self.keep(~named)
        return kept.remarked(f"{int(np.sum(named))} of {self.n_obs} rows dropped on request") if np.any(named) else kept

    def remarked(self, *remarks: str) -> "Trajectories":
        """The same data with more to say of what was done to them."""
        return replace(self, remarks=(*self.remarks, *remarks))

    def differentiate(
        self,
        method: Literal["savgol", "bandlimited", "spectral"] | None = None,
        *,
        rates: Mapping[str, str] | None = None,
        window: int | None = None,
        polyorder: int | None = None,
        band: float | None = None,
        white_share: float | None = None,
        like: "Trajectories | None" = None,
    ) -> "Trajectories":
        """Add the derivatives that were not measured, with the covariance of their rows.

        Every column goes through the same smoothing filter, outputs too. The window − 1 rows at the edges of each run
        are dropped and counted in `dropped` (none for "spectral"). Held-out data take the filter of the training data:
        `test.differentiate(like=train)`.

        Args:
            method: "savgol" (local polynomial), "bandlimited" (windowed-sinc filter with a stated pass band)
                or "spectral" (Fourier, exact for records of whole periods, which it needs); "savgol" by default.
            rates: {"y": "ydot"} says that the rate of state y is a state ydot that was not measured: ydot is
                added, the derivative of y is ydot and that of ydot the second derivative of y. Every other
                state without a derivative gets its first derivative.
            window: odd number of samples; "savgol" chooses it by generalised cross-validation (see
                `data.rates.filters.savgol_window`), "bandlimited" from the band.
            polyorder: degree of the local polynomial, default 4 with `rates`, else 3.
            band: edge of the pass band in cycles per unit of time.
            white_share: share of the row variance taken as white, see `bayes_greybox.data.noise.banded`.
            like: differentiated data whose filter is used, with the very window; no other setting can be given then.

        Returns:
            Data with all derivatives and their noise.

        Raises:
            InputError: if sampling is uneven, a run is too short, or the settings do not fit; with `like`, data of
                another sample spacing.
        """
        if self.noise:
            raise InputError("The data are differentiated already; differentiate the measured data once.")
        if like is not None:
            if not all(setting is None for setting in (method, rates, window, polyorder, band, white_share)):
                raise InputError("like=... brings all settings of the filter with it: leave the others out.")
            if like.filter is None:
                raise InputError("The data given as like=... were not differentiated: differentiate them first.")
            like.filter.require_steps({name: uniform_step(self.take(name).time, name) for name in self.run_names})
            return self.differentiate(**like.filter.settings)
        result = differentiate(
            self.time,
            self.run,
            self.run_names,
            states=self.states,
            inputs=self.inputs,
            derivatives=self.derivatives,
            method=method or "savgol",
            rates=rates,
            window=window,
            polyorder=polyorder,
            band=band,
            white_share=WHITE_SHARE if white_share is None else white_share,
        )
        units = dict(self.units)
        for name, rate in (rates or {}).items():
            unit = rate_unit(units.get(name), units.get("t"))
            if unit is not None:
                units[rate] = unit
        return replace(
            self,
            time=self.time[result.rows],
            run=self.run[result.rows],
            states=result.states,
            inputs=result.inputs,
            derivatives=result.derivatives,
            units=units,
            noise=result.noise,
            filter=result.filter,
            dropped=self.dropped + self.n_obs - len(result.rows),
            remarks=(*self.remarks, f"{result.filter.in_words}: {self.n_obs} rows to {len(result.rows)}"),
            unseen=None if self.unseen is None else self.unseen[result.rows],
        )

    def split(
        self, fraction: float, by: Literal["time", "trajectory"] = "time"
    ) -> tuple["Trajectories", "Trajectories"]:
        """Split into a first part to fit and a second part to test.

        Rows that a filter of width w computed share samples with their w − 1 neighbours on either side; split
        before `differentiate` where the parts must not share any.

        Args:
            fraction: share of the first part, between 0 and 1.
            by: "time" cuts every run once, keeping rows contiguous; "trajectory" gives whole runs, in order.

        Returns:
            First and second part.

        Raises:
            InputError: if a part would be empty, or the rows of a run cannot be parted.
        """
        lengths = self.run_lengths
        cuts = split_cuts(lengths, self.run_names, fraction, by)
        first = self._restrict([(0, cut) for cut in cuts])
        second = self._restrict([(cut, n) for cut, n in zip(cuts, lengths, strict=True)])
        return first, second

    def metadata(self) -> dict[str, Any]:
        """What `to_frame` leaves out, as plain values: the keyword arguments of `from_frame`."""
        return {
            "states": list(self.states),
            "inputs": list(self.inputs),
            "derivatives": list(self.derivative_names),
            "outputs": list(self.output_names),
            "units": dict(self.units),
            "noise": {name: noise.to_dict() for name, noise in self.noise.items()},
            "run_names": list(self.run_names),
            "dropped": self.dropped,
            "time_name": self.time_name,
            "filter": None if self.filter is None else self.filter.to_dict(),
            "unseen": None if self.unseen is None else np.flatnonzero(self.unseen).tolist(),
            "remarks": list(self.remarks),
        }

    def to_frame(self) -> pd.DataFrame:
        """Table with one row for each sample: time, run number, states, inputs, derivatives ("d(y)/dt"), outputs."""
        derivatives = {self.target_label(k): v for k, v in self.derivatives.items()}
        columns = {self.time_name: self.time, "run": self.run, **self.states, **self.inputs, **derivatives}
        return pd.DataFrame(columns)

    def __repr__(self) -> str:
        plural = "run" if self.n_run == 1 else "runs"
        dropped = f", {self.dropped} dropped" if self.dropped else ""
        every = {
            "states": self.states, "inputs": self.inputs, "derivatives of": self.derivative_names,
            "outputs": self.output_names,
        }  # fmt: skip
        parts = [f"{what} {', '.join(names)}" for what, names in every.items() if names]
        told = "".join(f"\n  {remark}" for remark in self.remarks)
        return f"Trajectories({self.n_obs} rows in {self.n_run} {plural}{dropped}; {'; '.join(parts)}){told}"

    def _blocks(self, what: str) -> list[tuple[str, np.ndarray]]:
        """Name and rows of each run, of data that are still as they were measured."""
        if self.noise or self.samples is not None or self.unseen is not None:
            raise InputError(f"Rates of these data were computed from neighbouring rows: {what} before differentiate.")
        return [(name, np.flatnonzero(self.run == i)) for i, name in enumerate(self.run_names)]

    def _at_times(
        self, times: Sequence[np.ndarray], column: Callable[[int, np.ndarray, np.ndarray], np.ndarray], remark: str
    ) -> "Trajectories":
        """Data at other times of each run.

        Args:
            times: New times of each run.
            column: Values of a run at its new times, from its number, its stamps and its values.
            remark: What was done, before the number of rows.
        """
        blocks = [np.flatnonzero(self.run == i) for i in range(self.n_run)]

        def part(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
            return {
                name: np.concatenate([column(i, self.time[rows], values[rows]) for i, rows in enumerate(blocks)])
                for name, values in columns.items()
            }

        return replace(
            self,
            time=np.concatenate(times),
            run=np.repeat(np.arange(self.n_run), [len(each) for each in times]),
            states=part(self.states),
            inputs=part(self.inputs),
            derivatives=part(self.derivatives),
        ).remarked(f"{remark}{sum(map(len, times))}")

    def _restrict(self, bounds: Sequence[tuple[int, int]]) -> "Trajectories":
        """Contiguous rows of each run, as half-open ranges; a run with an empty range is left out."""
        starts = np.concatenate([[0], np.cumsum(self.run_lengths)])
        rows = np.concatenate([np.arange(starts[i] + a, starts[i] + b) for i, (a, b) in enumerate(bounds)])
        return self._at(rows, {name: noise.restrict(bounds) for name, noise in self.noise.items()})

    def _at(self, rows: Int[np.ndarray, " n_row"], noise: Mapping[str, RowNoise]) -> "Trajectories":
        """Some rows, in order, with the noise of their rates; a run that has none of them is left out."""
        run, number = np.unique(self.run[rows], return_inverse=True)

        def part(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
            return {name: values[rows] for name, values in columns.items()}

        return replace(
            self,
            time=self.time[rows],
            run=number,
            states=part(self.states),
            inputs=part(self.inputs),
            derivatives=part(self.derivatives),
            noise=noise,
            run_names=tuple(self.run_names[i] for i in run),
            samples=None if self.samples is None else self.samples._at(rows, {}),
            unseen=None if self.unseen is None else self.unseen[rows],
        )


def require_measured(data: object) -> None:
    """Refuse what is not measurements, such as a table that was not read.

    Raises:
        InputError: The class of the object, and how it is read.
    """
    if not isinstance(data, Trajectories):
        raise InputError(
            f"Models take bg.Trajectories, not a {type(data).__name__}, which does not say what is a state or an "
            "input: read it with bg.read(table, time=..., states=[...], inputs=[...]); arrays with "
            "bg.Trajectories.from_arrays(t, states={...})."
        )
