"""A constant inside an effect's expression, of which only the range is known."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.physics.formula.grammar import check_name
from bayes_greybox.running.errors import InputError

from .effect_tables import nearest

RANGE_SCALES = {
    "size": "the largest |{}|",
    "threshold": "the largest |{}|, and no less than the smallest",
    "period": "the period of a wave with the spread of {} and of its rate",
    "frequency": "the angular frequency of a wave with the spread of {} and of its rate",
    "record": "the duration of the longest run",
    "number": "one",
}
"""Sizes of which the range of a nonlinear parameter may be in shares, in words with the role."""

MOST_PARAMETERS = 4
"""Most nonlinear parameters of an effect: their first values are all combinations of values of each."""


@dataclass(frozen=True)
class InnerParameter:
    """A constant inside an effect's expression, such as the gap of a dead zone.

    Its prior is log-uniform between two shares of a size of a column, which `scale` chooses: by default the largest
    absolute value in it.

    Attributes:
        name: Its name in the expression.
        meaning: A few words that describe it.
        of: Role whose column scales it.
        low, high: Smallest and largest share.
        unit_of: Role whose unit it carries; "" for a plain number; None: that of `of`.
        scale: One of `RANGE_SCALES`.
        values: Number of values that are tried first; a resonance needs enough that its frequency is not missed.
    """

    name: str
    meaning: str
    of: str
    low: float
    high: float
    unit_of: str | None = None
    scale: str = "size"
    values: int = 8

    def __post_init__(self) -> None:
        """Refuse a name that formulas cannot use and a range without a log-uniform prior."""
        if self.unit_of is None:
            object.__setattr__(self, "unit_of", self.of)
        check_name(self.name)
        if self.scale not in RANGE_SCALES:
            raise InputError(
                f"The nonlinear parameter {self.name!r} has scale = {self.scale!r}; "
                f"{nearest(self.scale, [*RANGE_SCALES])}"
            )
        if not 0.0 < self.low < self.high < math.inf:
            raise InputError(
                f"The nonlinear parameter {self.name!r} has low = {self.low:g} and high = {self.high:g}; they are "
                f"shares of {self.scaled_by} with 0 < low < high."
            )

    @property
    def scaled_by(self) -> str:
        """The size of which the range is in shares, in words."""
        return RANGE_SCALES[self.scale].format(self.of)

    def size(self, x: np.ndarray, time: np.ndarray | None, run: np.ndarray | None) -> float:
        """Return the size, of the column of `of`, in which the range has shares; 0 where there is none."""
        if self.scale in ("size", "threshold"):
            return float(np.max(np.abs(x)))
        if self.scale == "number":
            return 1.0
        if time is None or run is None:
            return 0.0
        if self.scale == "record":
            return max(float(np.ptp(time[run == each])) for each in np.unique(run))
        step, moved = np.diff(time), np.diff(x)
        within = (np.diff(run) == 0) & (step > 0)
        speed = float(np.sqrt(np.sum(moved[within] ** 2 / step[within]) / max(float(np.sum(step[within])), 1e-300)))
        # By time, as lines between samples: runs that are padded or cut count for as long as they are.
        weight = step[within] / max(float(np.sum(step[within])), 1e-300)
        first, last = x[:-1][within], x[1:][within]
        mean = float(weight @ (first + last)) / 2
        first, last = first - mean, last - mean
        spread = math.sqrt(float(weight @ (first**2 + first * last + last**2)) / 3)
        if not (speed > 0 and spread > 0):
            return 0.0
        return 2 * math.pi * spread / speed if self.scale == "period" else speed / spread

    def ends(
        self, x: Float[np.ndarray, " n"], time: Float[np.ndarray, " n"] | None, run: Int[np.ndarray, " n"] | None
    ) -> tuple[float, float]:
        """Return the least and largest value, in the unit of the column or of time; both 0 where there are none.

        A time scale needs the times and the runs of the values, a threshold a column on both sides of it. Ends are
        shares of a size in two digits: a path that moved a little then has the same values as the last one, whose
        formulas are not read again.
        """
        size = float(f"{self.size(x, time, run):.1e}")
        least, most = self.low * size, self.high * size
        if self.scale == "threshold":
            # Below the smallest |x| it would never switch, and any smooth law would pass for it; an effect that dies
            # out beyond it would be seen by its tail alone.
            least = max(least, float(np.min(np.abs(x))))
        return (least, most) if least < most else (0.0, 0.0)

    def nodes(self, least: float, most: float) -> Float[np.ndarray, " node"]:
        """Return increasing values between the `ends` that stand for the prior: middles of equally probable parts."""
        if not 0.0 < least < most < math.inf:
            raise InputError(
                f"{self.name} is a share of {self.scaled_by}, which leaves it from {least:g} to {most:g} on the data; "
                f"leave the effect out."
            )
        if self.values < 1:
            raise InputError(f"{self.name} needs at least one value, not {self.values}.")
        # log value = log least + share (log most - log least)
        return least * (most / least) ** ((np.arange(self.values) + 0.5) / self.values)
