"""Scaling, features and measure of an equation: the frame that the data fix before sampling starts."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_greybox.physics.terms import Dictionary
from bayes_greybox.running.errors import InputError

from .frame import Frame
from .gp.discrepancy import OrthogonalGP
from .gp.features import HilbertBasis, default_features
from .gp.kernels import box_nodes, orthonormalise


def scaled_frame(
    equation: str,
    dictionary: Dictionary,
    discrepancy: OrthogonalGP | None,
    columns: Mapping[str, Float[np.ndarray, " n_row"]],
    term_scale: Float[np.ndarray, " n_term"],
    target_scale: float,
) -> Frame:
    """Return scaling and features of an equation, before the measure is known.

    The ends of the columns are enough. Terms and target are scaled by their RMS; terms that are zero or not finite are
    refused.
    """
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
        raise InputError(_zero_term(dictionary, int(np.argmin(term_scale)), equation, columns))
    return Frame(
        equation=equation,
        dictionary=dictionary,
        variables=tuple(variables),
        centre=centre,
        half_width=half_width,
        term_scale=term_scale,
        target_scale=target_scale,
        orthonormal=np.zeros((len(dictionary), 0)),
        basis=basis,
        moments=np.zeros((0, 0 if basis is None else basis.size)),
        projected=False,
    )


def _zero_term(
    dictionary: Dictionary, term: int, equation: str, columns: Mapping[str, Float[np.ndarray, " n_row"]]
) -> str:
    """Say that a term is zero, and of which column that comes."""
    zero = f"Term {dictionary.names[term]!r} of equation {equation!r} is zero on all the data"
    idle = [name for name in dictionary.terms[term].symbols if name in columns and not np.any(columns[name])]
    if not idle:
        return f"{zero}: remove it."
    return (
        f"{zero}, as is {idle[0]!r}: if that is a hidden state, say where it starts, starts={{{idle[0]!r}: 1.0}} (in a "
        "file [starts]); if not, remove the term."
    )


def with_measure(
    frame: Frame,
    gp: OrthogonalGP,
    columns: Mapping[str, Float[np.ndarray, " n_row"]],
    factor: Float[np.ndarray, "n_kept n_column"],
    n_node: int,
) -> Frame:
    """Return the frame with the orthonormal dictionary and ⟨Φₒ, ψᵀ⟩ under the chosen measure.

    The ends of the columns are enough. `factor` is that of [Φ ψ y] at the `n_node` rows that the measure is taken on. A
    term that is not finite on the whole box of the data is refused.
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
    """Return nodes of the uniform measure on the box of every variable that Φ or f depends on, and their weights.

    The ends of the columns are enough.
    """
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
