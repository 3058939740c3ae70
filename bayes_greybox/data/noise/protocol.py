"""Covariance of derivative rows that a linear filter computed from noisy samples.

A linear differentiator turns white sensor noise of standard deviation s into correlated rows of covariance
(scale · s)² R, the mean diagonal of R being 1. The likelihood then needs only W with W R Wᵀ = I, applied to both sides
of the equation. R of a pure filter is nearly singular: a differentiator removes the mean, smoothing removes high
frequencies, and rows that the filter claims to know exactly would outvote all others. A white share δ stands for the
part of the row noise that is not filtered sensor noise (truncation and model error):

    R = (1 − δ) R_filter + δ I.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any, ClassVar, cast

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.running.errors import InputError

WHITE_SHARE = 0.05  # default δ: the share of the row variance that is white
PRECISION_COLUMNS = 20  # columns of R⁻¹ that are computed at once: each is as long as the record
# Values, the length of each stretch of neighbours, and True if they run along frequency instead of time.
Sequences = tuple[Float[np.ndarray, "n_draw n_value"], tuple[int, ...], bool]


class RowNoise(ABC):
    """Noise of the stacked rows of one derivative, block by run; each kind is a frozen dataclass."""

    kind: ClassVar[str]  # name in files
    unsaved: ClassVar[tuple[str, ...]] = ()  # fields that files leave out
    local: ClassVar[bool] = False  # true if each row is whitened by itself: rows can be whitened a chunk at a time
    triangular: ClassVar[bool] = True  # true if no row of W depends on a later row
    # True if R follows from the noise of the samples and a model, and is not estimated from the rows.
    derived: ClassVar[bool] = False
    run_lengths: tuple[int, ...]
    scale: float  # standard deviation of the rows over that of the state samples, in the units of the data

    @property
    def n_obs(self) -> int:
        """Number of rows of all runs."""
        return sum(self.run_lengths)

    @property
    def square(self) -> bool:
        """True if W is square, that is if R is invertible."""
        return self.n_white == self.n_obs

    @property
    def independent(self) -> bool:
        """True if R is diagonal: rows may differ in variance but are uncorrelated."""
        return self.local

    @property
    def white_lengths(self) -> tuple[int, ...]:
        """Number of whitened rows of each run."""
        return self.run_lengths

    @property
    def n_white(self) -> int:
        """Number of whitened rows: one for each row, unless R is singular."""
        return sum(self.white_lengths)

    @property
    @abstractmethod
    def log_det(self) -> float:
        """log|R|, over the kept coefficients only where R is singular."""

    @abstractmethod
    def whiten(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_white k"]:
        """Return W rows, with W R Wᵀ = I."""

    @abstractmethod
    def whiten_transpose(self, rows: Float[np.ndarray, "n_white k"]) -> Float[np.ndarray, "n_obs k"]:
        """Return Wᵀ rows; Wᵀ W is the (pseudo-)inverse of R."""

    def precision_diagonal(self) -> Float[np.ndarray, " n_obs"]:
        """Return the diagonal of Wᵀ W."""
        return self.precision_band(1)[:, 0]

    @abstractmethod
    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Return the entries (i, i + k) of Wᵀ W for k < width, zero beyond the run of row i."""

    def precision_at(self, index: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n n"]:
        """Return entries (i, j) of R⁻¹ for some rows; where R is singular, the identity of whitened coefficients."""
        if not self.square:
            return np.eye(len(index))
        parts = np.array_split(index, -(-len(index) // PRECISION_COLUMNS))
        columns = [self.whiten_transpose(self.whiten(unit_columns(self.n_obs, part)))[index] for part in parts]
        return np.concatenate(columns, axis=1)

    @abstractmethod
    def covariance(self) -> Float[np.ndarray, "n_obs n_obs"]:
        """Return R as a dense matrix, for tests and small data."""

    def correlated(self, white: Float[np.ndarray, "n_draw n_obs"]) -> Float[np.ndarray, "n_draw n_obs"]:
        """Return draws from N(0, R) made of standard normal ones."""
        values, vectors = np.linalg.eigh(self.covariance())
        return white @ (vectors * np.sqrt(np.maximum(values, 0))).T

    def without_starts(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_obs k"]:
        """Return residuals less the part that unknown starts of the runs explain; rows of rates have no starts."""
        return rows

    def starts_given(
        self, rows: Float[np.ndarray, "n_obs k"], white: Float[np.ndarray, "n_start k"]
    ) -> tuple[Float[np.ndarray, "n_start k"], Float[np.ndarray, "n_obs k"]]:
        """Draw the starts of runs given residuals over σ, from standard normal numbers, and the residuals less them."""
        return white, rows

    @property
    def n_start(self) -> int:
        """Number of unknown starts; rows of rates have none."""
        return 0

    @property
    def moved(self) -> bool:
        """True if an unknown force moves the path that the rows belong to."""
        return self.sensors is not self.error

    @property
    def error(self) -> "RowNoise":
        """Noise of the rows alone, without the freedom of unknown starts."""
        return self

    @property
    def sensors(self) -> "RowNoise":
        """Noise of the sensors alone, without any force that moves the path of the rows."""
        return self.error

    def with_error(self, error: "RowNoise") -> "RowNoise":
        """Return the same noise with another noise of the rows alone."""
        return error

    @property
    def intensities(self) -> Float[np.ndarray, " n"]:
        """Intensities of an unknown force that may move the path of the rows; rows of rates have no path."""
        return np.zeros(0)

    def forced(self, intensity: float) -> "RowNoise":
        """Return the same noise with an unknown force along the path, white in time, of one of `intensities`."""
        return self

    def sequences(self, white: Float[np.ndarray, "n_draw n_white"]) -> Sequences:
        """Order whitened residuals so that neighbours would be correlated if R were wrong."""
        return white, self.white_lengths, False

    @abstractmethod
    def restrict(self, bounds: Sequence[tuple[int, int]]) -> "RowNoise":
        """Return the noise of a part of the rows, its mean diagonal of R again 1 and scale² R unchanged.

        `bounds` is the half-open range of rows that stay, for each run; an empty range leaves the run out. Rows that
        cannot be parted are refused.
        """

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain numbers, lists and mappings, which `noise_from_dict` reads back."""
        names = [field.name for field in fields(cast(Any, self)) if field.name not in self.unsaved]
        return {"kind": self.kind, **{name: _plain(getattr(self, name)) for name in names}}


def check_white_share(share: float) -> None:
    """Refuse a white share outside (0, 1]."""
    if not 0.0 < share <= 1.0:
        raise InputError(f"white_share must be above 0 and at most 1, not {share}; the default is {WHITE_SHARE}.")


def rows_within(run_lengths: Sequence[int], bounds: Sequence[tuple[int, int]]) -> Int[np.ndarray, " k"]:
    """Return the numbers of contiguous rows of each run, as half-open ranges."""
    starts = np.cumsum([0, *run_lengths[:-1]])
    return np.concatenate([np.arange(start + a, start + b) for start, (a, b) in zip(starts, bounds, strict=True)])


def unit_columns(n: int, rows: Int[np.ndarray, " k"]) -> Float[np.ndarray, "n k"]:
    """Return columns of the identity of size n."""
    unit = np.zeros((n, len(rows)))
    unit[rows, np.arange(len(rows))] = 1.0
    return unit


def band_by_columns(
    product: Callable[[Float[np.ndarray, "n k"]], Float[np.ndarray, "n k"]], n: int, width: int
) -> Float[np.ndarray, "n width"]:
    """Return entries (i, i + k), k < width, of a symmetric matrix A [n, n] from products A X of a few columns each."""
    band = np.zeros((n, width))
    for rows in np.array_split(np.arange(n), -(-n // PRECISION_COLUMNS)) if n else []:
        columns = product(unit_columns(n, rows))
        for j, row in enumerate(rows):
            band[row, : n - row] = columns[row : row + width, j]
    return band


def _plain(value: Any) -> Any:
    if isinstance(value, RowNoise):
        return value.to_dict()
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {name: _plain(part) for name, part in value._asdict().items()}  # pyright: ignore[reportAttributeAccessIssue]
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [_plain(part) for part in value] if isinstance(value, tuple) else value
