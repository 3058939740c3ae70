"""Measured runs: time, states, inputs, measured derivatives and outputs, stacked row by row."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import pandas as pd
from jaxtyping import Bool, Int

from bayes_greybox.data.runs.cut import CutRuns
from bayes_greybox.data.runs.gaps import parted
from bayes_greybox.running.errors import InputError

from .columns import (
    check_names,
    check_times,
    check_units,
    check_varying,
    counted_from_first,
    derivative_label,
    name_runs,
    number_runs,
    require_mappings,
    several,
    stack,
    usable_rows,
)
from .noise.files import noise_from_dict
from .noise.protocol import WHITE_SHARE, RowNoise
from .rates.differentiate import FilterSettings, differentiate, uniform_step
from .rates.rate_filter import RateFilter


@dataclass(frozen=True, eq=False, repr=False)
class Trajectories(CutRuns):
    """Rows of one or several runs, stacked; build with `read` or `from_arrays`.

    Attributes:
        time: time stamps, strictly increasing within each run.
        run: number of the run of each row, 0, 1, …, in order.
        states: state columns by name.
        inputs: input columns by name.
        derivatives: time derivative of the state with that name; under any other name an output, a measured quantity
            whose equation has no derivative in it.
        units: unit by column name; the time's under "t", a derivative's under "d(name)/dt" if it was given.
        noise: covariance of the rows of derivatives and outputs by name; a missing name means independent rows.
        run_names: name of each run.
        dropped: rows left out so far (missing values, edges of filters).
        time_name: name of the time in expressions and tables.
        filter: filter that computed the derivatives; None if they were measured, or there are none.
        remarks: changes to the measurements, in order, in words; shown by repr.
        samples: sensor readings, if states and rates are those of a path through them; None if the states are the
            samples.
        unseen: rows at which a sensor was clipped, if found before the samples were corrected; None if they show it
            themselves.
        computed: states that no sensor read, which follow from a model and the other columns.
        before: earlier rows of the same runs, by name, of data that `split` cut off: hidden states started there.
    """

    samples: "Trajectories | None" = None
    unseen: Bool[np.ndarray, " n_obs"] | None = None
    computed: tuple[str, ...] = ()
    before: "Trajectories | None" = None

    @classmethod
    def from_arrays(
        cls, t: Any, *, states: Mapping[str, Any] | None = None, derivatives: Mapping[str, Any] | None = None,
        inputs: Mapping[str, Any] | None = None, outputs: Mapping[str, Any] | None = None,
        units: Mapping[str, str] | None = None, run_names: Sequence[str] | None = None,
        missing: Literal["error", "drop"] = "error", constant: Literal["error", "keep"] = "error",
    ) -> "Trajectories":  # fmt: skip
        """Build from arrays, one for each column, or from lists of arrays, one for each run.

        Masked values count as missing.

        Args:
            t: time stamps, (n,), or a list of such arrays of any lengths, one for each run; row numbers if the rows
                have no order in time, as for a map measured point by point. Integers with more digits than a float
                holds are counted from the first of each run; `remarks` says so.
            states: state columns by name, each shaped like `t`; optional if there are inputs and outputs.
            derivatives: measured time derivative of the state with that name, if there is one.
            inputs: input columns by name.
            outputs: columns by name, measured with states and inputs and determined by those of the same row, such as a
                force or a flow: F = g(x, u) + ….
            units: unit by column name, the time's under "t", a derivative's under "d(name)/dt".
            run_names: names of the runs; "0", "1", … if left out.
            missing: "error" refuses NaN and infinite values, "drop" leaves out their rows and counts them in
                `dropped`; nothing is interpolated.
            constant: "error" refuses a state or input that never changes, "keep" allows it (held-out data
                with the input switched off).

        Returns:
            The checked data. Without rates and outputs, a run is split at gaps of over ten usual steps, in which its
            inputs are unknown; `remarks` says so.

        Raises:
            InputError: if lengths, names, stamps or values cannot be used; the message says which.
        """
        require_mappings(states=states, inputs=inputs, derivatives=derivatives, outputs=outputs)
        runs = several(t)
        names = name_runs(run_names, len(runs))
        runs, remarks = counted_from_first(runs, names)
        states, inputs, derivatives, units = states or {}, inputs or {}, derivatives or {}, units or {}
        outputs = outputs or {}
        check_names(states, inputs, derivatives, outputs)
        check_units(units, states, inputs, outputs)
        kinds = {"state": states, "input": inputs, "derivative of": derivatives, "output": outputs}
        lengths = [len(stamps) for stamps in runs]
        columns = {"time": stack("time", runs, names, lengths)}
        for kind, chosen in kinds.items():
            for name, values in chosen.items():
                label = f'{kind} "{name}"'
                columns[label] = stack(label, values, names, lengths)
        run = np.repeat(np.arange(len(runs)), lengths)

        keep = usable_rows(columns, run, names, missing)
        run, columns = run[keep], {label: values[keep] for label, values in columns.items()}
        check_times(columns["time"], run, names)
        if inputs and not derivatives and not outputs:
            # Rates and outputs follow from their own row; samples depend on inputs between rows.
            run, names, gaps = parted(columns["time"], run, names)
            remarks += gaps
        if constant not in ("error", "keep"):
            raise InputError(f'constant must be "error" or "keep", not {constant!r}.')
        if constant == "error":
            check_varying({label: v for label, v in columns.items() if label.startswith(("state", "input"))})
        kept = {kind: {name: columns[f'{kind} "{name}"'] for name in chosen} for kind, chosen in kinds.items()}
        return cls(
            columns["time"], run, kept["state"], kept["input"], kept["derivative of"] | kept["output"], dict(units),
            run_names=names, dropped=int(np.sum(~keep)), remarks=remarks,
        )  # fmt: skip

    @classmethod
    def from_frame(
        cls, frame: pd.DataFrame, *, states: Sequence[str], inputs: Sequence[str] = (),
        derivatives: Sequence[str] = (), outputs: Sequence[str] = (), units: Mapping[str, str] | None = None,
        noise: Mapping[str, Mapping[str, Any]] | None = None, run_names: Sequence[str] | None = None,
        dropped: int = 0, time_name: str = "t", filter: Mapping[str, Any] | None = None,
        unseen: Sequence[int] | None = None, remarks: Sequence[str] = (), computed: Sequence[str] = (),
    ) -> "Trajectories":  # fmt: skip
        """Rebuild from `to_frame`: `from_frame(data.to_frame(), **data.metadata())`, equal to the last bit.

        The table has one row for each sample, its columns named as `to_frame` names them; rows of a run lie together,
        and the column "run" has its number or its name. By default run names are those of the table, in order. Noise
        and filter are plain records, `unseen` lists the rows at which a sensor was clipped, if samples do not show it,
        and `computed` the states that no sensor read.

        Raises:
            InputError: if a column is not in the table, or its runs are not those of `run_names`.
        """
        rates = {k: derivative_label(k, time_name) for k in derivatives} | {k: k for k in outputs}
        wanted = [time_name, "run", *states, *inputs, *rates.values()]
        absent = [name for name in wanted if name not in frame.columns]
        if absent:
            raise InputError(f'The table has no column "{absent[0]}"; it has {", ".join(map(str, frame.columns))}.')

        column = {name: frame[name].to_numpy(dtype=float, copy=True) for name in wanted if name != "run"}
        run, names = number_runs(frame["run"], run_names)
        return cls(
            time=column[time_name],
            run=run,
            states={k: column[k] for k in states},
            inputs={k: column[k] for k in inputs},
            derivatives={k: column[label] for k, label in rates.items()},
            units=dict(units or {}),
            noise={k: noise_from_dict(v) for k, v in (noise or {}).items()},
            run_names=names,
            dropped=dropped,
            time_name=time_name,
            filter=None if filter is None else RateFilter.from_dict(filter),
            unseen=None if unseen is None else np.isin(np.arange(len(frame)), unseen),
            remarks=tuple(remarks),
            computed=tuple(computed),
        )

    def differentiate(
        self, method: Literal["savgol", "bandlimited", "spectral"] | None = None, *,
        rates: Mapping[str, str] | None = None, window: int | None = None, polyorder: int | None = None,
        band: float | None = None, white_share: float | None = None, like: "Trajectories | None" = None,
    ) -> "Trajectories":  # fmt: skip
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
            white_share: share of the row variance taken as white, see `bayes_greybox.data.noise.protocol`.
            like: differentiated data whose filter is used, with the same window; no other setting may be given then.

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
        share = WHITE_SHARE if white_share is None else white_share
        settings = FilterSettings(method or "savgol", dict(rates or {}), window, polyorder, band, share)
        result, rows = differentiate(replace(self, unseen=None), settings)
        return result if self.unseen is None else replace(result, unseen=self.unseen[rows])

    def metadata(self) -> dict[str, Any]:
        """Return the keyword arguments of `from_frame` as plain values: all that `to_frame` leaves out."""
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
            # Without any, the record is that of earlier versions, which know no such states.
            **({"computed": list(self.computed)} if self.computed else {}),
        }

    def to_frame(self) -> pd.DataFrame:
        """Tabulate one row for each sample: time, run number, states, inputs, derivatives ("d(y)/dt"), outputs."""
        derivatives = {self.target_label(k): v for k, v in self.derivatives.items()}
        return pd.DataFrame({self.time_name: self.time, "run": self.run, **self.columns, **derivatives})

    def __repr__(self) -> str:
        plural = "run" if self.n_run == 1 else "runs"
        dropped = f", {self.dropped} dropped" if self.dropped else ""
        rates = {"derivatives of": self.derivative_names, "outputs": self.output_names}
        every = {"states": self.states, "inputs": self.inputs, **rates}
        parts = [f"{what} {', '.join(names)}" for what, names in every.items() if names]
        remarks = "".join(f"\n  {remark}" for remark in self.remarks)
        return f"Trajectories({self.n_obs} rows in {self.n_run} {plural}{dropped}; {'; '.join(parts)}){remarks}"

    @property
    def _computed(self) -> bool:
        return super()._computed or self.samples is not None or self.unseen is not None

    def _at(self, rows: Int[np.ndarray, " n_row"], noise: Mapping[str, RowNoise]) -> "Trajectories":
        # Samples and unseen rows are cut separately: columns of one object must have one length at all times.
        cut = super(Trajectories, replace(self, samples=None, unseen=None))._at(rows, noise)
        samples = None if self.samples is None else self.samples._at(rows, {})
        return replace(cut, samples=samples, unseen=None if self.unseen is None else self.unseen[rows])


def require_measured(data: object) -> None:
    """Refuse an object that is not `Trajectories`, such as a table that was not read, and say how to read it."""
    if not isinstance(data, Trajectories):
        # A stream of rows has its own advice.
        raise InputError(
            getattr(data, "instead", "")
            or f"Models take bg.Trajectories, not a {type(data).__name__}, which does not say what is a state or an "
            "input: read it with bg.read(table, time=..., states=[...], inputs=[...]); arrays with "
            "bg.Trajectories.from_arrays(t, states={...})."
        )


def with_filter_of(test: Trajectories, train: Trajectories) -> Trajectories:
    """Differentiate held-out data like the training data, unless their rates are known; refuse another filter."""
    require_measured(test)
    if train.filter is None or test.filter == train.filter:
        return test
    if test.filter is not None:
        one, other = (f"{part.method} with a window of {part.window}" for part in (train.filter, test.filter))
        raise InputError(
            f"Training data were differentiated by {one}, held-out data by {other}, or with other settings: use one "
            "filter for both, test.differentiate(like=train)."
        )
    unknown = any(name not in test.derivatives for name in train.derivatives)
    return test.differentiate(like=train) if unknown else test
