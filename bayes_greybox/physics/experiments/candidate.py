"""Candidates for the next experiment: input signals, start, duration and what is measured."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.writing import unit_text
from bayes_greybox.running.errors import InputError

from .signals import Signal


@dataclass(frozen=True)
class Candidate:
    """One experiment that could be done.

    Attributes:
        inputs: Signal of each input.
        start: State at the start, by name.
        duration: Duration of the run.
        rows: Number of samples, evenly spread over it.
        sensors: Noise standard deviation by channel: states, or, where a study was given rates, states with a rate.
        name: Name in tables; made of the rest by default.
    """

    inputs: Mapping[str, Signal]
    start: Mapping[str, float]
    duration: float
    rows: int
    sensors: Mapping[str, float]
    name: str = field(default="")

    def __post_init__(self) -> None:
        """Refuse impossible values, and fill in the name."""
        if not (np.isfinite(self.duration) and self.duration > 0 and self.rows >= 2):
            what = f"{self.duration} and {self.rows}"
            raise InputError(f"An experiment needs a duration above 0 and two rows, not {what}.")
        if wrong := [name for name, value in self.start.items() if not np.isfinite(value)]:
            raise InputError(f"start: {wrong[0]!r} is {self.start[wrong[0]]}; give it a number.")
        if wrong := [name for name, sd in self.sensors.items() if not (np.isfinite(sd) and sd > 0)]:
            raise InputError(f"sensors: the noise of {wrong[0]!r} must be above 0, not {self.sensors[wrong[0]]}.")
        if not self.sensors:
            raise InputError("An experiment without sensors tells nothing: name at least one channel with its noise.")
        if not self.name:
            object.__setattr__(self, "name", self.in_units({}))

    def in_units(self, units: Mapping[str, str | None]) -> str:
        """Return the name that is made of the rest, with the units of columns and of time, "t"."""
        starts = [f"{name} = {value:.3g} {unit_text(units.get(name))}".rstrip() for name, value in self.start.items()]
        parts = []
        for name, signal in self.inputs.items():
            worded = getattr(signal, "in_units", None)
            parts.append(f"{name}: {worded(units.get(name), units.get('t')) if worded else signal.text}")
        return "; ".join([*parts, f"start at {', '.join(starts)}"])

    def named_in(self, units: Mapping[str, str | None]) -> "Candidate":
        """Return the same experiment, with units in a name that was not given."""
        return replace(self, name=self.in_units(units)) if self.name == self.in_units({}) else self

    @property
    def times(self) -> Float[np.ndarray, " n_row"]:
        """Sampling times, from 0."""
        return np.linspace(0.0, self.duration, self.rows)
