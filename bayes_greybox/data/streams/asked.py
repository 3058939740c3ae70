"""Columns and settings by which each piece of a stream is read."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import pandas as pd
from jaxtyping import Bool

from bayes_greybox.data.plain_arrays import first_lost
from bayes_greybox.data.reading.door import read
from bayes_greybox.data.reading.table import Layout, Table, tidy
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError

CHUNK_ROWS, PART_ROWS = 1 << 16, 1 << 20  # rows in memory at a time, and that one worker reads before it answers


@dataclass(frozen=True)
class Asked:
    """Columns and settings by which each piece is read."""

    columns: tuple[str, ...]  # columns by the names that users gave, and once a source was opened by its own
    time: str | None = None  # column of time stamps; rows are numbered without
    missing: Literal["error", "drop"] = "error"
    settings: Mapping[str, Any] = field(default_factory=dict)  # further arguments of `read`
    stamps: str | None = None  # column of time stamps, as a source names it
    labels: str | None = None  # column that tells runs apart, as a source names it

    @property
    def restarts(self) -> bool:
        """True if time that goes back begins another run."""
        return self.settings.get("restart") == "run"

    def among(self, kinds: Mapping[str, str], where: str) -> "Asked":
        """Return the same request with columns as a source names them, whose kinds of NumPy's data types are given."""
        # Two rows of any numbers, as only the names matter: "pos [mm]" is a column pos.
        table = tidy(Table(pd.DataFrame(dict.fromkeys(kinds, [1.0, 2.0])), where), Layout())
        in_source = dict(zip(table.frame.columns, kinds, strict=True))
        columns = tuple(dict.fromkeys(in_source[table.own_name(name)] for name in self.columns))
        run = self.settings.get("run")
        stamps, labels = (None if name is None else in_source[table.own_name(name)] for name in (self.time, run))
        for name in columns:
            if kinds[name] not in "biuf" and name != labels:
                raise InputError(
                    f'The column "{name}" of {where} does not hold numbers. A stream knows no row before its piece: '
                    "give dates as seconds, and text as numbers."
                )
        return replace(self, columns=columns, stamps=stamps, labels=labels)

    def begins(self, frame: pd.DataFrame, before: pd.DataFrame | None) -> Bool[np.ndarray, " n_row"]:
        """Mark the rows that begin a run; `before` is the result of `latest` for earlier rows, or None."""
        begun = np.zeros(len(frame), bool)
        begun[0] = before is None
        last = frame.iloc[:0] if before is None else before
        if self.labels is not None:
            labels = pd.concat([last, frame])[self.labels].to_numpy()
            begun[len(frame) - len(labels) + 1 :] |= labels[1:] != labels[:-1]
        elif self.restarts and self.stamps is not None:
            time = pd.concat([last, frame])[self.stamps].to_numpy(float)
            stamped = np.flatnonzero(np.isfinite(time))
            begun[stamped[1:][np.diff(time[stamped]) < 0] - len(last)] = True
        return begun

    def latest(self, frame: pd.DataFrame, before: pd.DataFrame | None) -> pd.DataFrame:
        """Return the row that decides if the next one begins a run: the last one, or the last one with a stamp."""
        last = frame.iloc[-1:]
        if self.labels is None and self.stamps is not None:
            stamped = frame[np.isfinite(frame[self.stamps].to_numpy(float))].iloc[-1:]
            last = stamped if len(stamped) or before is None else before
        return last

    def usable(self, frame: pd.DataFrame) -> Bool[np.ndarray, " n_row"]:
        """Mark the rows that are read: all, or those without missing values where these are left out."""
        if self.missing == "error":
            return np.ones(len(frame), bool)
        numbers = frame.select_dtypes("number").to_numpy(float)
        return np.asarray(np.isfinite(numbers).all(axis=1))

    def formed(self, table: Any, where: str, first: int, dropped: int, whole: bool = False) -> Trajectories:
        """Build data from a DataFrame or Dataset whose first row has the number `first`, whole runs or a piece."""
        if not whole and self.stamps is not None and first_lost(np.asarray(table[self.stamps])) is not None:
            raise InputError(
                f'The column "{self.stamps}" of {where} holds whole numbers of more digits than a float does, and a '
                "stream knows no row before its piece: give them less the first, or as seconds."
            )
        stamps = {"dt": 1.0} if self.time is None else {"time": self.time}
        try:
            data = read(table, **stamps, **self.settings, missing=self.missing, constant="keep")
        except InputError as error:
            raise InputError(f"In {where}, counted from its row {first}: {error}") from error
        time = data.time + first if self.time is None else data.time
        return replace(data, time=time, dropped=dropped + data.dropped, remarks=())
