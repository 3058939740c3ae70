"""Runs as they lie in memory: columns stacked row by row, with their names, units and noise."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from bayes_greybox.data.columns import derivative_label, rate_unit
from bayes_greybox.data.noise.protocol import RowNoise
from bayes_greybox.data.noise.weighted import WhiteNoise
from bayes_greybox.data.rates.rate_filter import RateFilter
from bayes_greybox.running.errors import InputError


@dataclass(frozen=True, eq=False, repr=False)
class Runs:
    """Attributes of `Trajectories`, which describe each, and look-ups in them."""

    time: Float[np.ndarray, " n_obs"]
    run: Int[np.ndarray, " n_obs"]
    states: Mapping[str, Float[np.ndarray, " n_obs"]]
    inputs: Mapping[str, Float[np.ndarray, " n_obs"]]
    derivatives: Mapping[str, Float[np.ndarray, " n_obs"]]
    units: Mapping[str, str] = field(default_factory=dict)
    noise: Mapping[str, RowNoise] = field(default_factory=dict)
    run_names: tuple[str, ...] = ("0",)
    dropped: int = 0
    time_name: str = "t"
    filter: RateFilter | None = None
    remarks: tuple[str, ...] = ()

    @property
    def n_obs(self) -> int:
        """Number of rows of all runs."""
        return len(self.time)

    def rate(self, state: str) -> Float[np.ndarray, " n_obs"]:
        """Return the measured derivative of a state, or an output as it was measured; refuse if the data have none."""
        if state not in self.derivatives:
            raise InputError(
                f"The data have no derivative of {state!r}: give it with derivatives={{{state!r}: ...}}, "
                f"or compute it with data.differentiate()."
            )
        return self.derivatives[state]

    def row_noise(self, state: str) -> RowNoise:
        """Return the noise of the rows of a state's derivative: that of its differentiator, or white."""
        return self.noise.get(state) or WhiteNoise(self.run_lengths)

    @property
    def n_run(self) -> int:
        """Number of runs."""
        return len(self.run_names)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        return tuple(self.states)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs, in order."""
        return tuple(self.inputs)

    @property
    def derivative_names(self) -> tuple[str, ...]:
        """States whose derivative is known, in order."""
        return tuple(name for name in self.derivatives if name in self.states)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs, in order: measured quantities whose equations have no derivative in them."""
        return tuple(name for name in self.derivatives if name not in self.states)

    def is_output(self, name: str) -> bool:
        """Return True if an equation is that of an output, and not of a state."""
        return name in self.derivatives and name not in self.states

    def target_label(self, name: str) -> str:
        """Return the left-hand side of the equation of a state or an output, such as d(y)/dt or F."""
        return name if self.is_output(name) else derivative_label(name, self.time_name)

    def target_in_words(self, *names: str, article: str = "") -> str:
        """Name left-hand sides in a sentence, after "measured" or an article: outputs by name, all else as a rate."""
        words = [name if self.is_output(name) else f"{article}rate" for name in names] or [f"{article}rate"]
        return " and ".join(dict.fromkeys(words))

    @property
    def run_lengths(self) -> tuple[int, ...]:
        """Number of rows of each run."""
        return tuple(int(n) for n in np.bincount(self.run, minlength=self.n_run))

    @property
    def run_rows(self) -> list[Int[np.ndarray, " _"]]:
        """Numbers of the rows of each run."""
        return [np.flatnonzero(self.run == i) for i in range(self.n_run)]

    @property
    def usual_step(self) -> float:
        """Median time between two rows of a run."""
        return float(np.median(np.diff(self.time)[np.diff(self.run) == 0]))

    @property
    def row_steps(self) -> Float[np.ndarray, " n_obs"]:
        """Mean time between two rows of the run of each row; 0 where that has one row."""
        times = [self.time[rows] for rows in self.run_rows]
        steps = [(time[-1] - time[0]) / max(len(time) - 1, 1) for time in times]
        return np.repeat(np.asarray(steps, float), self.run_lengths)

    @property
    def columns(self) -> dict[str, Float[np.ndarray, " n_obs"]]:
        """All states, then all inputs, by name."""
        return {**self.states, **self.inputs}

    def each_column(self, work: Callable[[np.ndarray], np.ndarray]) -> dict[str, dict[str, np.ndarray]]:
        """Return states, inputs and derivatives with some work done on each column, as arguments of the class."""
        kinds = {"states": self.states, "inputs": self.inputs, "derivatives": self.derivatives}
        return {kind: {name: work(column) for name, column in columns.items()} for kind, columns in kinds.items()}

    def column(self, name: str) -> Float[np.ndarray, " n_obs"]:
        """Return one state or input; a column that there is not is refused."""
        columns = self.columns
        if name not in columns:
            raise InputError(f'There is no state or input "{name}"; there are {", ".join(columns)}.')
        return columns[name]

    def matrix(self, names: Sequence[str]) -> Float[np.ndarray, "n_obs n_column"]:
        """Return states and inputs side by side, in the order of `names`."""
        if not names:
            return np.empty((self.n_obs, 0))
        return np.column_stack([self.column(name) for name in names])

    def unit(self, name: str) -> str | None:
        """Return the unit of a state, an input, an output or the time ("t"); None if it was not given."""
        return self.units.get(name)

    def derivative_unit(self, name: str) -> str | None:
        """Return the unit of the derivative of a state: as given, else state over time, None if unknown."""
        stated = self.units.get(derivative_label(name, "t"))
        return stated if stated is not None else rate_unit(self.units.get(name), self.units.get("t"))

    def summary(self) -> pd.DataFrame:
        """Tabulate kind, unit, min, max, mean and number of rows of every column."""
        rates = {self.target_label(k): (self.derivative_unit(k), self.derivatives[k]) for k in self.derivative_names}
        rows = [(self.time_name, "time", self.unit("t"), self.time)]
        rows += [(k, "state", self.unit(k), v) for k, v in self.states.items()]
        rows += [(k, "input", self.unit(k), v) for k, v in self.inputs.items()]
        rows += [(label, "derivative", *rate) for label, rate in rates.items()]
        rows += [(k, "output", self.unit(k), self.derivatives[k]) for k in self.output_names]
        table = [
            (k, kind, u or "", *(float(of(x)) for of in (np.min, np.max, np.mean)), len(x)) for k, kind, u, x in rows
        ]
        return pd.DataFrame(table, columns=["column", "kind", "unit", "min", "max", "mean", "n"]).set_index("column")
