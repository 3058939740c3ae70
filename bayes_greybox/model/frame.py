"""The frame of one equation: everything fixed by the data before sampling starts.

It holds the scaling (internal, never seen by the user), the orthonormal dictionary and the features, and
evaluates them on any rows: those of the fit, held-out ones, a grid, or a state inside an integrator. Of NumPy's arrays
it makes NumPy's arrays.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from bayes_greybox.physics.formula.expressions import namespace
from bayes_greybox.physics.terms import Dictionary

from .gp.features import HilbertBasis
from .rows.equation_rows import Jumps


class Share(NamedTuple):
    """The part of a frame that concerns one learned state: a frame of its own, and its columns of Φ."""

    frame: "Frame"
    columns: slice


@dataclass(frozen=True)
class Frame:
    """Scaling and bases of one equation.

    Attributes:
        equation: The learned state, say "ydot" for d(ydot)/dt, or the name of several that share their rows.
        variables: Variables that f depends on.
        centre: Centre of the data's box in each variable, user's units.
        half_width: Half-width of the box, user's units.
        term_scale: RMS of each term over the data, user's units; where several states are learned on the same rows, in
            the unit of the largest: over the size of the forces on its own.
        target_scale: RMS of the target over the data, user's units.
        orthonormal: T, Φₒ = Φ T orthonormal under μ, which for "empirical" is ⟨a, b⟩ = aᵀ R⁻¹ b / n.
        basis: Hilbert-space features, or None on the exact path or without a discrepancy.
        moments: ⟨Φₒ, ψᵀ⟩ under μ.
        projected: If true, the features have their projection on the dictionary subtracted.
    """

    equation: str
    dictionary: Dictionary
    variables: tuple[str, ...]
    centre: Float[np.ndarray, " n_var"]
    half_width: Float[np.ndarray, " n_var"]
    term_scale: Float[np.ndarray, " n_term"]
    target_scale: float
    orthonormal: Float[np.ndarray, "n_term n_rank"]
    basis: HilbertBasis | None
    moments: Float[np.ndarray, "n_rank n_basis"]
    projected: bool

    @property
    def coefficient_scale(self) -> Float[np.ndarray, " n_term"]:
        """User's coefficient per scaled coefficient."""
        return self.target_scale / self.term_scale

    @property
    def n_column(self) -> int:
        """Number of columns of [Φ ψ y]."""
        return len(self.dictionary) + self.moments.shape[1] + 1

    def shares(self) -> dict[str, Share]:
        """Return frames by learned state: this one, or, of several that share their rows, one for each."""
        if not self.dictionary.parts:
            return {self.equation: Share(self, slice(None))}
        shares, start = {}, 0
        for state, dictionary in self.dictionary.parts:
            columns = slice(start, start + len(dictionary))
            frame = replace(
                self,
                equation=state,
                dictionary=dictionary,
                term_scale=self.term_scale[columns],
                orthonormal=np.zeros((len(dictionary), 0)),
            )
            shares[state], start = Share(frame, columns), columns.stop
        return shares

    def of_terms(self, index: Int[np.ndarray, " n"]) -> "Frame":
        """Return the frame with some of its terms only, at least one; one with features needs them all, and stays."""
        if self.basis is not None:
            return self
        return replace(
            self,
            dictionary=Dictionary(tuple(self.dictionary.terms[j] for j in index)),
            term_scale=self.term_scale[index],
            orthonormal=np.zeros((len(index), 0)),
            moments=np.zeros((0, 0)),
            projected=False,
        )

    @property
    def labels(self) -> list[tuple[str, str]]:
        """Learned state and term of each column of Φ."""
        return [(state, name) for state, share in self.shares().items() for name in share.frame.dictionary.names]

    def dictionary_rows(self, columns: Mapping[str, Array | np.ndarray]) -> Float[Array | np.ndarray, "n_row n_term"]:
        """Return Φ in scaled units."""
        return self.dictionary.evaluate(columns) / self.term_scale

    @property
    def jumps(self) -> Jumps:
        """Columns of Φ that may jump."""
        places = self.dictionary.jumping
        part = Dictionary(tuple(self.dictionary.terms[i] for i in places))
        return Jumps(places, lambda columns: np.asarray(part.evaluate(columns)) / self.term_scale[list(places)])

    def position(self, columns: Mapping[str, Array | np.ndarray]) -> Float[Array | np.ndarray, "n_row n_var"]:
        """Return the variables of f in scaled units: the data's box is [−1, 1]^d."""
        return scaled_position(columns, self.variables, self.centre, self.half_width)

    def plain_features(self, columns: Mapping[str, Array | np.ndarray]) -> Float[Array | np.ndarray, "n_row n_basis"]:
        """Return ψ, before the dictionary is projected out; no columns without a basis."""
        x = self.position(columns)
        if self.basis is None:
            return np.zeros((x.shape[0], 0))
        return held_features(self.basis, x)

    def orthogonal(self, Phi: Array | np.ndarray, psi: Array | np.ndarray) -> Array | np.ndarray:
        """Return ψ̃ = ψ − Φₒ ⟨Φₒ, ψᵀ⟩ for the projected kernel, ψ for the others; any rows with these columns."""
        return psi - Phi @ self.orthonormal @ self.moments if self.projected else psi

    def rows(
        self, columns: Mapping[str, Array | np.ndarray]
    ) -> tuple[Float[Array | np.ndarray, "n_row n_term"], Float[Array | np.ndarray, "n_row n_basis"]]:
        """Return Φ and Ψ̃ in scaled units."""
        Phi = self.dictionary_rows(columns)
        return Phi, self.orthogonal(Phi, self.plain_features(columns))

    def f(
        self, columns: Mapping[str, np.ndarray], Phi: Float[np.ndarray, "n_row n_term"],
        weight: Float[np.ndarray, " n_basis"],
    ) -> Float[np.ndarray, " n_row"]:  # fmt: skip
        """Return Ψ̃ w of one draw in scaled units, without Ψ̃, which long paths of many draws have no time for.

        Φ is `dictionary_rows` of the columns.
        """
        x = self.position(columns)
        if self.basis is None:
            return np.zeros(x.shape[0])
        plain = self.basis.weighted(np.asarray(held_inside(self.basis, x)), weight)
        return plain - Phi @ (self.orthonormal @ (self.moments @ weight)) if self.projected else plain

    def inside(self, columns: Mapping[str, Array | np.ndarray]) -> np.ndarray:
        """Return which rows lie in the box of the data."""
        return np.all(np.abs(np.asarray(self.position(columns))) <= 1 + 1e-9, axis=-1)


def scaled_position(
    columns: Mapping[str, Array | np.ndarray],
    variables: Sequence[str],
    centre: Float[np.ndarray, " n_var"],
    half_width: Float[np.ndarray, " n_var"],
) -> Float[Array | np.ndarray, "n_row n_var"]:
    """Return the variables of f in scaled units: the data's box is [−1, 1]^d."""
    if not variables:
        return np.zeros((len(next(iter(columns.values()))), 0))
    xp = namespace(columns.values())
    x = xp.stack([xp.asarray(columns[name], float) for name in variables], axis=-1)
    return (x - centre) / half_width


def held_features(
    basis: HilbertBasis, x: Float[Array | np.ndarray, "n_row n_var"]
) -> Float[Array | np.ndarray, "n_row n_basis"]:
    """Return ψ, held at its edge value outside the features' domain, where the expansion would repeat itself.

    Of f that holds ψw alone: the projection that is subtracted, Φₒ⟨Φₒ, ψᵀ⟩w, goes on as the terms do.
    """
    return basis(held_inside(basis, x))


def held_inside(
    basis: HilbertBasis, x: Float[Array | np.ndarray, "n_row n_var"]
) -> Float[Array | np.ndarray, "n_row n_var"]:
    """Return the points of the features' domain nearest to given ones."""
    return namespace([x]).clip(x, -basis.half_widths, basis.half_widths)
