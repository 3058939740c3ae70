"""Covariance of derivative rows that a linear filter computed from noisy samples.

A linear differentiator turns white sensor noise into correlated rows with a known covariance. It is kept as
a correlation shape R (mean diagonal 1) and a factor `scale`, so that the covariance of the rows is
(scale · s)² R when the state samples carry white noise of standard deviation s. The likelihood then needs
only W with W R Wᵀ = I, applied to both sides of the equation.

The covariance of a pure filter is nearly singular: a differentiator removes the mean, smoothing removes high
frequencies, and rows that the filter claims to know exactly would outvote all others. A white share δ stands
for the part of the row noise that is not filtered sensor noise (truncation and model error):

    R = (1 − δ) R_filter + δ I.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.running.errors import InputError

WHITE_SHARE = 0.05
"""Default δ: the share of the row variance that is white."""

FILTER_WHITE_SHARES = (0.0001, 0.0005, 0.002, 0.01, 0.05, 0.15, 0.4)
"""White shares among which the rows themselves choose, where something weighs them."""

PRECISION_COLUMNS = 20
"""Columns of R⁻¹ computed at once: each is as long as the record."""


class RowNoise(ABC):
    """Noise of the stacked rows of one derivative, block by run.

    Attributes:
        run_lengths: rows of each run.
        scale: standard deviation of the derivative rows divided by that of the state samples, in the units
            of the data (1/time for a first derivative).
    """

    run_lengths: tuple[int, ...]
    scale: float

    @property
    def n_obs(self) -> int:
        """Number of rows of all runs."""
        return sum(self.run_lengths)

    @property
    def square(self) -> bool:
        """Whether W is square, that is whether R is invertible."""
        return self.n_white == self.n_obs

    @property
    def local(self) -> bool:
        """Whether a row is whitened by itself, so that rows can be whitened a chunk at a time."""
        return False

    @property
    def triangular(self) -> bool:
        """Whether W is triangular: a row of it knows of no later row."""
        return True

    @property
    def independent(self) -> bool:
        """Whether R is diagonal: rows may differ in their noise, but know nothing of each other."""
        return self.local

    @property
    def derived(self) -> bool:
        """Whether R follows from the noise of samples and a model, so that no other noise of the rows is sought."""
        return False

    @property
    def white_lengths(self) -> tuple[int, ...]:
        """Whitened rows of each run."""
        return self.run_lengths

    @property
    @abstractmethod
    def n_white(self) -> int:
        """Number of whitened rows."""

    @property
    @abstractmethod
    def log_det(self) -> float:
        """log|R|, over the kept coefficients only where R is singular."""

    @abstractmethod
    def whiten(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_white k"]:
        """W rows, with W R Wᵀ = I."""

    @abstractmethod
    def whiten_transpose(self, rows: Float[np.ndarray, "n_white k"]) -> Float[np.ndarray, "n_obs k"]:
        """Wᵀ rows; Wᵀ W is the (pseudo-)inverse of R."""

    @abstractmethod
    def precision_diagonal(self) -> Float[np.ndarray, " n_obs"]:
        """Diagonal of Wᵀ W."""

    @abstractmethod
    def precision_band(self, width: int) -> Float[np.ndarray, "n_obs width"]:
        """Entries (i, i + k) of Wᵀ W for k < width, zero beyond the run of row i."""

    def precision_at(self, index: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n n"]:
        """Entries (i, j) of R⁻¹ at some rows; whitened coefficients, where R is singular, are independent."""
        if not self.square:
            return np.eye(len(index))
        columns = []
        for part in np.array_split(index, -(-len(index) // PRECISION_COLUMNS)):
            unit = np.zeros((self.n_obs, len(part)))
            unit[part, np.arange(len(part))] = 1.0
            columns.append(self.whiten_transpose(self.whiten(unit))[index])
        return np.concatenate(columns, axis=1)

    @abstractmethod
    def covariance(self) -> Float[np.ndarray, "n_obs n_obs"]:
        """R as a dense matrix, for tests and small data."""

    def correlated(self, white: Float[np.ndarray, "n_draw n_obs"]) -> Float[np.ndarray, "n_draw n_obs"]:
        """Draws from N(0, R) made of standard normal ones."""
        values, vectors = np.linalg.eigh(self.covariance())
        return white @ (vectors * np.sqrt(np.maximum(values, 0))).T

    def without_starts(self, rows: Float[np.ndarray, "n_obs k"]) -> Float[np.ndarray, "n_obs k"]:
        """Residuals less what unknown starts of the runs explain of them; rows of rates have no starts."""
        return rows

    def starts_given(
        self, rows: Float[np.ndarray, "n_obs k"], white: Float[np.ndarray, "n_start k"]
    ) -> tuple[Float[np.ndarray, "n_start k"], Float[np.ndarray, "n_obs k"]]:
        """Draws of the unknown starts of runs given residuals, and the residuals less what they explain, all over σ.

        Args:
            rows: Residuals.
            white: Standard normal numbers.
        """
        return white, rows

    @property
    def n_start(self) -> int:
        """Unknown starts; rows of rates have none."""
        return 0

    @property
    def moved(self) -> bool:
        """Whether an unknown force moves the path that rows are of."""
        return self.sensors is not self.error

    @property
    def error(self) -> "RowNoise":
        """The noise of the rows alone, without what unknown starts of the runs allow."""
        return self

    @property
    def sensors(self) -> "RowNoise":
        """The noise of the sensors alone, without what moves the path that rows are of."""
        return self.error

    def with_error(self, error: "RowNoise") -> "RowNoise":
        """The same with other noise of the rows alone."""
        return error

    @property
    def intensities(self) -> Float[np.ndarray, " n"]:
        """Intensities of an unknown force that rows of a path may be moved by; rows of rates have no path."""
        return np.zeros(0)

    def forced(self, intensity: float) -> "RowNoise":
        """The same with an unknown force along the path, white in time.

        Args:
            intensity: One of `intensities`, or between them.
        """
        return self

    def onto(self, rows: "RowNoise") -> "RowNoise":
        """What this noise has beyond that of rows as they come, for the same rows near another path.

        Args:
            rows: Their noise as they come.
        """
        return rows

    def sequences(
        self, white: Float[np.ndarray, "n_draw n_white"]
    ) -> tuple[Float[np.ndarray, "n_draw n_value"], tuple[int, ...], bool]:
        """Whitened rows in an order in which neighbours would be correlated if R were wrong.

        Args:
            white: Whitened residuals, standard normal if R is right.

        Returns:
            The values, the length of each stretch of neighbours, and whether they go along frequency and not time.
        """
        return white, self.white_lengths, False

    def alternatives(self) -> "tuple[RowNoise, ...]":
        """Noise that these rows may have as well, by a share that was assumed and not known; none by default."""
        return ()

    @abstractmethod
    def restrict(self, bounds: Sequence[tuple[int, int]]) -> "RowNoise":
        """Noise of a part of the rows.

        Args:
            bounds: for each run, the half-open range of rows that stay; an empty range leaves it out.

        Returns:
            The noise of these rows, rescaled so that the mean diagonal of R is 1 and scale² R is unchanged.

        Raises:
            InputError: if the rows of a run cannot be parted.
        """

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and lists that `noise_from_dict` reads back."""


def check_white_share(share: float) -> None:
    """Refuse a white share outside (0, 1]."""
    if not 0.0 < share <= 1.0:
        raise InputError(f"white_share must be above 0 and at most 1, not {share}; the default is {WHITE_SHARE}.")
