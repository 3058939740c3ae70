"""The frame of one equation: scaling, orthonormal dictionary and features, fixed by the data before sampling starts.

It evaluates them on any rows: those of the fit, held-out ones, a grid, or a state inside an integrator. Of NumPy's
arrays it makes NumPy's arrays.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from bayes_greybox.physics.formula.expressions import namespace
from bayes_greybox.physics.terms import Dictionary
from bayes_greybox.running.errors import InputError

from .gp.discrepancy import OrthogonalGP
from .gp.features import HilbertBasis, default_features
from .gp.kernels import box_nodes, orthonormalise
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
        variables: Variables that f depends on; `centre` and `half_width` are those of their box in the data, user's
            units.
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
            orthonormal, scale = np.zeros((len(dictionary), 0)), self.term_scale[columns]
            frame = replace(self, equation=state, dictionary=dictionary, term_scale=scale, orthonormal=orthonormal)
            shares[state], start = Share(frame, columns), columns.stop
        return shares

    def of_terms(self, index: Int[np.ndarray, " n"]) -> "Frame":
        """Return the frame with some of its terms only, at least one; one with features needs them all, and stays."""
        if self.basis is not None:
            return self
        dictionary = Dictionary(tuple(self.dictionary.terms[j] for j in index))
        bases = {"orthonormal": np.zeros((len(index), 0)), "moments": np.zeros((0, 0)), "projected": False}
        return replace(self, dictionary=dictionary, term_scale=self.term_scale[index], **bases)

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
        """Return Ψ̃ w of one draw by `dictionary_rows`, without Ψ̃, which long paths of many draws have no time for."""
        x = self.position(columns)
        if self.basis is None:
            return np.zeros(x.shape[0])
        plain = self.basis.weighted(np.clip(np.asarray(x), -self.basis.half_widths, self.basis.half_widths), weight)
        return plain - Phi @ (self.orthonormal @ (self.moments @ weight)) if self.projected else plain

    def inside(self, columns: Mapping[str, Array | np.ndarray]) -> np.ndarray:
        """Return which rows lie in the box of the data."""
        return np.all(np.abs(np.asarray(self.position(columns))) <= 1 + 1e-9, axis=-1)


def scaled_position(
    columns: Mapping[str, Array | np.ndarray], variables: Sequence[str], centre: Float[np.ndarray, " n_var"],
    half_width: Float[np.ndarray, " n_var"],
) -> Float[Array | np.ndarray, "n_row n_var"]:  # fmt: skip
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
    return basis(namespace([x]).clip(x, -basis.half_widths, basis.half_widths))


def scaled_frame(
    equation: str, dictionary: Dictionary, discrepancy: OrthogonalGP | None,
    columns: Mapping[str, Float[np.ndarray, " n_row"]], term_scale: Float[np.ndarray, " n_term"], target_scale: float,
) -> Frame:  # fmt: skip
    """Return scaling and features of an equation, before the measure is known; the ends of the columns are enough."""
    variables, centre, half_width = (), np.zeros(0), np.zeros(0)
    if discrepancy is not None:
        variables, centre, half_width = discrepancy_box(discrepancy, columns)
    basis = None
    if discrepancy is not None and discrepancy.path == "hsgp":
        basis = HilbertBasis(discrepancy.boundary, features_per_variable(discrepancy, len(variables)))
    if not np.all(np.isfinite(term_scale)):
        bad = dictionary.names[int(np.argmin(np.isfinite(term_scale)))]
        raise InputError(f"Term {bad!r} of equation {equation!r} is not finite on all the data: check its domain.")
    if np.any(term_scale == 0):
        term = dictionary.terms[int(np.argmin(term_scale))]
        zero = f"Term {term.name!r} of equation {equation!r} is zero on all the data"
        idle = [name for name in term.symbols if name in columns and not np.any(columns[name])]
        if not idle:
            raise InputError(f"{zero}: remove it.")
        raise InputError(
            f"{zero}, as is {idle[0]!r}: if that is a hidden state, say where it starts, starts={{{idle[0]!r}: 1.0}} "
            "(in a file [starts]); if not, remove the term."
        )
    orthonormal, moments = np.zeros((len(dictionary), 0)), np.zeros((0, 0 if basis is None else basis.size))
    box, scales = (tuple(variables), centre, half_width), (term_scale, target_scale)
    return Frame(equation, dictionary, *box, *scales, orthonormal, basis, moments, projected=False)


def with_measure(
    frame: Frame, gp: OrthogonalGP, columns: Mapping[str, Float[np.ndarray, " n_row"]],
    factor: Float[np.ndarray, "n_kept n_column"], n_node: int,
) -> Frame:  # fmt: skip
    """Return the frame with the orthonormal dictionary and ⟨Φₒ, ψᵀ⟩ under the chosen measure.

    The ends of the columns are enough. `factor` is that of [Φ ψ y] at the `n_node` rows that the measure is taken on.
    """
    if gp.measure in ("empirical", "unweighted"):
        # The triangular factor has the Gram matrix of its rows, so it serves as their nodes. With whitened rows
        # ⟨a, b⟩ = aᵀ R⁻¹ b / n, in which least squares with and without f mean the same θ.
        Phi, psi = factor[:, : len(frame.dictionary)], factor[:, len(frame.dictionary) : -1]
        weights = np.full(len(factor), 1.0 / n_node)
    else:
        nodes, weights = box_columns(frame, gp, columns)
        Phi, psi = np.asarray(frame.dictionary_rows(nodes)), np.asarray(frame.plain_features(nodes))
        if not np.all(np.isfinite(Phi)):
            bad = frame.dictionary.names[int(np.argmin(np.isfinite(Phi).all(axis=0)))]
            raise InputError(
                f"Term {bad!r} is not finite on the whole box of the data, which "
                f"OrthogonalGP(measure={gp.measure!r}) integrates over: use measure='empirical'."
            )
    T = orthonormalise(Phi, weights)
    moments = (weights[:, None] * (Phi @ T)).T @ psi
    return replace(frame, orthonormal=T, moments=moments, projected=gp.variant == "projected")


def discrepancy_box(
    discrepancy: OrthogonalGP, columns: Mapping[str, Float[np.ndarray, " n_row"]]
) -> tuple[tuple[str, ...], Float[np.ndarray, " n_var"], Float[np.ndarray, " n_var"]]:
    """Return the variables that f depends on, and centre and half-width of their box in the data, user's units."""
    variables = tuple(discrepancy.variables or columns)
    unknown = [name for name in variables if name not in columns]
    if unknown:
        raise InputError(
            f"OrthogonalGP(variables=...) names {unknown[0]!r}, which is neither a state nor an input; "
            f"known: {', '.join(columns)}."
        )
    centre, half_width = box_of(columns, variables)
    if np.any(half_width == 0):
        constant = variables[int(np.argmin(half_width))]
        raise InputError(
            f"The discrepancy depends on {constant!r}, which is constant on all the data: leave it out, "
            f"OrthogonalGP(variables={[name for name in variables if name != constant]}), in a file [discrepancy] "
            "variables."
        )
    return variables, centre, half_width


def features_per_variable(
    discrepancy: OrthogonalGP, n_var: int, default: tuple[int, ...] | None = None
) -> tuple[int, ...]:
    """Return the number of features along each variable: those that the user named, or the default."""
    features = discrepancy.features
    if features is None:
        return default or default_features(n_var)
    per_variable = (features,) * n_var if isinstance(features, int) else tuple(features)
    if len(per_variable) != n_var or min(per_variable) < 1:
        raise InputError(
            f"OrthogonalGP(features={features!r}) must be a positive number, or one for each of the {n_var} variables."
        )
    return per_variable


def box_columns(
    frame: Frame, gp: OrthogonalGP, columns: Mapping[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return nodes of the uniform measure on the box of every variable that Φ or f depends on, and their weights."""
    names = tuple(n for n in columns if n in frame.variables or n in frame.dictionary.symbols)
    nodes, weights = box_nodes(
        len(names), monte_carlo=gp.monte_carlo if gp.measure == "box-monte-carlo" else None, seed=gp.seed
    )
    centre, half_width = box_of(columns, names)
    return dict(zip(names, (centre + half_width * nodes).T, strict=True)), weights


def box_of(columns: Mapping[str, np.ndarray], names: Iterable[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return centre and half-width of the box of some columns; their ends are enough."""
    names = tuple(names)
    low = np.array([columns[name].min() for name in names])
    high = np.array([columns[name].max() for name in names])
    return (low + high) / 2, (high - low) / 2
