"""Columns and features of f at the rows of one equation, whitened: kept in memory, or evaluated again in passes."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.model.rows.equation_rows import Columns, EquationRows, Evaluate, Jumps

CHUNK = 16_384
"""Rows evaluated at once."""

KEPT = 3e7
"""Numbers up to which the evaluated rows stay in memory; beyond, new columns cost another pass over the data."""


class Products(NamedTuple):
    """What new columns Z add to products of columns X, with R⁻¹ between them, the identity where rows are streamed.

    Attributes:
        with_old: XᵀR⁻¹Z.
        corner: ZᵀR⁻¹Z.
        with_target: ZᵀR⁻¹y.
    """

    with_old: Float[np.ndarray, "n_old n_new"]
    corner: Float[np.ndarray, "n_new n_new"]
    with_target: Float[np.ndarray, " n_new"]


class RowTable(ABC):
    """Columns and features at the rows.

    Attributes:
        rows: The rows.
        features_of: Features of f at samples.
    """

    def __init__(self, rows: EquationRows, features_of: Evaluate) -> None:
        self.rows, self.features_of = rows, features_of

    @cached_property
    def target(self) -> Float[np.ndarray, " n_white"]:
        """W y, scaled."""
        return self.rows.whiten((self.rows.target / self.rows.scale)[:, None])[:, 0]

    @abstractmethod
    def extend(self, values: Float[np.ndarray, "n_row n_new"]) -> Products:
        """Add columns by their values at the rows."""

    @abstractmethod
    def keep(self, indices: Sequence[int]) -> None:
        """Drop all other columns."""

    @abstractmethod
    def at_rows(self, indices: Sequence[int], evaluate: Evaluate, jumps: Jumps) -> Float[np.ndarray, "n_row k"]:
        """Values of some columns, none of which is known at the rows only.

        Args:
            indices: Of the columns.
            evaluate: These columns at samples.
            jumps: Which of these may jump.
        """

    @property
    @abstractmethod
    def with_features(self) -> Float[np.ndarray, "n_column n_basis"]:
        """XᵀR⁻¹ψ."""

    @property
    @abstractmethod
    def features(self) -> tuple[Float[np.ndarray, "n_basis n_basis"], Float[np.ndarray, " n_basis"]]:
        """ψᵀR⁻¹ψ and ψᵀR⁻¹y."""

    @abstractmethod
    def explained(self, weight: Float[np.ndarray, " n_basis"]) -> Float[np.ndarray, " n_row"]:
        """V ψ w."""


class Kept(RowTable):
    """In memory; features are evaluated when they are asked for, once for all noises of the rows.

    Args:
        rows: The rows.
        features_of: Features of f at samples.
        shared: Holds V ψ for the same rows under another noise.
    """

    def __init__(
        self, rows: EquationRows, features_of: Evaluate, shared: dict[str, tuple[Columns, np.ndarray]]
    ) -> None:
        super().__init__(rows, features_of)
        self._shared = shared
        self._values, self._white = np.zeros((rows.n_row, 0)), np.zeros((rows.n_white, 0))
        self._with_features: np.ndarray | None = None

    def extend(self, values: Float[np.ndarray, "n_row n_new"]) -> Products:
        """See `RowTable.extend`."""
        new = self.rows.whiten(values)
        found = Products(self._white.T @ new, new.T @ new, new.T @ self.target)
        self._values, self._white = np.hstack([self._values, values]), np.hstack([self._white, new])
        self._with_features = None
        return found

    def keep(self, indices: Sequence[int]) -> None:
        """See `RowTable.keep`."""
        self._values, self._white = self._values[:, indices], self._white[:, indices]
        if self._with_features is not None:
            self._with_features = self._with_features[indices]

    def at_rows(self, indices: Sequence[int], evaluate: Evaluate, jumps: Jumps) -> Float[np.ndarray, "n_row k"]:
        """See `RowTable.at_rows`."""
        return self._values[:, indices]

    @property
    def with_features(self) -> Float[np.ndarray, "n_column n_basis"]:
        """See `RowTable.with_features`."""
        if self._with_features is None:
            self._with_features = self._white.T @ self._psi
        return self._with_features

    @cached_property
    def features(  # pyright: ignore[reportIncompatibleMethodOverride]
        self,
    ) -> tuple[Float[np.ndarray, "n_basis n_basis"], Float[np.ndarray, " n_basis"]]:
        """See `RowTable.features`."""
        return self._psi.T @ self._psi, self._psi.T @ self.target

    def explained(self, weight: Float[np.ndarray, " n_basis"]) -> Float[np.ndarray, " n_row"]:
        """See `RowTable.explained`."""
        return self._responses @ weight

    @property
    def _responses(self) -> Float[np.ndarray, "n_row n_basis"]:
        """V ψ, which knows nothing of the noise."""
        # Of these very columns: another noise of the rows has them too.
        of, found = self._shared.get("psi", (None, None))
        if of is not self.rows.columns or found is None:
            found = self.rows.table(self.features_of)(np.arange(self.rows.n_row))
            self._shared["psi"] = self.rows.columns, found
        return found

    @cached_property
    def _psi(self) -> Float[np.ndarray, "n_white n_basis"]:
        return self.rows.whiten(self._responses)


class Streamed(RowTable):
    """Rows that are whitened one by one, in passes over the data.

    Args:
        rows: The rows.
        features_of: Features of f at samples.
        columns: All columns so far at the rows.
    """

    def __init__(
        self, rows: EquationRows, features_of: Evaluate, columns: Callable[[], Float[np.ndarray, "n_row n_column"]]
    ) -> None:
        super().__init__(rows, features_of)
        self._columns = columns
        self._with_features = np.zeros((0, self.features[1].shape[0]))

    def extend(self, values: Float[np.ndarray, "n_row n_new"]) -> Products:
        """See `RowTable.extend`."""
        old = self._columns()
        cross = sum(values[start : start + len(psi)].T @ psi for start, psi in self._blocks())
        self._with_features = np.vstack([self._with_features, cross])
        return Products(old.T @ values, values.T @ values, values.T @ self.target)

    def keep(self, indices: Sequence[int]) -> None:
        """See `RowTable.keep`."""
        self._with_features = self._with_features[indices]

    def at_rows(self, indices: Sequence[int], evaluate: Evaluate, jumps: Jumps) -> Float[np.ndarray, "n_row k"]:
        """See `RowTable.at_rows`."""
        return self.rows.table(evaluate, jumps=jumps)(np.arange(self.rows.n_row))

    @property
    def with_features(self) -> Float[np.ndarray, "n_column n_basis"]:
        """See `RowTable.with_features`."""
        return self._with_features

    @cached_property
    def features(  # pyright: ignore[reportIncompatibleMethodOverride]
        self,
    ) -> tuple[Float[np.ndarray, "n_basis n_basis"], Float[np.ndarray, " n_basis"]]:
        """See `RowTable.features`."""
        square, with_target = np.zeros(()), np.zeros(())
        for start, psi in self._blocks():
            square = square + psi.T @ psi
            with_target = with_target + psi.T @ self.target[start : start + len(psi)]
        return square, with_target

    def explained(self, weight: Float[np.ndarray, " n_basis"]) -> Float[np.ndarray, " n_row"]:
        """See `RowTable.explained`."""
        return np.concatenate([psi @ weight for _, psi in self._blocks()])

    def _blocks(self) -> Iterator[tuple[int, Float[np.ndarray, "n n_basis"]]]:
        """First row and features of a stretch."""
        psi = self.rows.table(self.features_of)
        for start in range(0, self.rows.n_row, CHUNK):
            index: Int[np.ndarray, " n"] = np.arange(start, min(start + CHUNK, self.rows.n_row))
            yield start, psi(index)


def table_of(
    rows: EquationRows, features_of: Evaluate, n_basis: int,
    columns: Callable[[], Float[np.ndarray, "n_row n_column"]], shared: dict[str, tuple[Columns, np.ndarray]],
) -> RowTable:  # fmt: skip
    """In memory, where that is small enough or rows are whitened together anyway.

    Args:
        rows: The rows.
        features_of: Features of f at samples.
        n_basis: Number of features.
        columns: All columns so far at the rows, where they are not kept.
        shared: What the same rows under another noise have in common.
    """
    if rows.n_row * (n_basis + 1) <= KEPT or not rows.noise.local:
        return Kept(rows, features_of, shared)
    return Streamed(rows, features_of, columns)
