"""From data to design: scale, orthogonalise, whiten and compress the rows of each equation."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.physics.formula.expressions import namespace
from bayes_greybox.physics.terms import Dictionary
from bayes_greybox.running.arrays import on_device
from bayes_greybox.running.errors import InputError

from .algebra.compression import FACTOR_CHUNK, triangular_factor
from .algebra.linalg import require_independent
from .coefficient import CoefficientPriors
from .design import DenseDesign, FeatureDesign
from .equation import Equation
from .frame import Frame, box_columns, scaled_frame, with_measure
from .gp.discrepancy import EXACT_LIMIT, OrthogonalGP
from .gp.hyper import Hyperparameters
from .rows.equation_rows import EquationRows, Table


def assemble(
    rows: EquationRows, dictionary: Dictionary, discrepancy: OrthogonalGP | None, noise_floor: float,
    coefficients: Sequence[Coefficient | None] | None = None,
) -> Equation:  # fmt: skip
    """Build frame and design of one equation: the only work that grows with the number of rows.

    `noise_floor` is the least σ over the RMS of the target, and `coefficients` has the prior of each term, None where
    the model's holds alone.

    Raises:
        InputError: Fewer rows than terms; a term that is not finite; collinear terms; a target that is zero;
            too many rows for the exact path; a kernel that is not a covariance.
    """
    equation, n_term = rows.equation, len(dictionary)
    require_rows(equation, rows.n_white, n_term)
    target_scale = rows.scale
    # A state in small units moves by small forces.
    sizes = np.array([rows.learned[name].size for name in dictionary.acts_on] or [1.0])
    term_scale = np.sqrt(sums_of_squares(rows, dictionary, 16 * FACTOR_CHUNK) / rows.n_sample) / sizes
    frame = scaled_frame(equation, dictionary, discrepancy, rows.columns, term_scale, target_scale)
    table = scaled_table(frame, rows)

    factor = plain = triangular_factor(table, rows.n_row)
    require_independent(plain[:, :n_term], dictionary.names, equation)

    white = rows.whitened(table)
    if white is not table:
        whitened = white(np.arange(rows.n_white))
        if not rows.noise.square:
            _require_traces(whitened[:, :n_term], plain, dictionary.names, equation)
        factor = triangular_factor(white, rows.n_white)
        # Where W follows from the noise of samples it is invertible, but stretches directions by many powers of ten.
        if not rows.noise.derived:
            require_independent(factor[:, :n_term], dictionary.names, equation)
    if discrepancy is not None:
        unweighted = discrepancy.measure == "unweighted"
        nodes, n_node = (plain, rows.n_row) if unweighted else (factor, rows.n_white)
        frame = with_measure(frame, discrepancy, rows.columns, nodes, n_node)

    floor = with_rounding(rows.measured / target_scale, noise_floor)
    common = common_of(frame, rows.n_white, float(rows.noise.log_det), floor, coefficients)
    if discrepancy is not None and discrepancy.path == "exact":
        return Equation(rows, frame, _dense_design(frame, discrepancy, rows, table, common))
    return Equation(rows, frame, feature_design(frame, discrepancy, factor, common))


def require_rows(equation: str, n_row: int, n_term: int) -> None:
    """Refuse an equation with fewer rows than terms."""
    if n_row < n_term:
        raise InputError(
            f"Equation {equation!r} has {n_term} terms but only {n_row} rows of data: give at least as many rows as "
            "terms."
        )


def common_of(
    frame: Frame, n_obs: int, log_det: float, noise_floor: float, coefficients: Sequence[Coefficient | None] | None
) -> dict[str, Any]:
    """Return the fields of every design beside its rows, from those of the rows; the floor is in scaled units."""
    priors = [None] * len(frame.dictionary) if coefficients is None else coefficients
    numbers = {"n_obs": n_obs, "n_prior": n_obs, "log_det_R": log_det, "noise_floor": noise_floor}
    fields: dict[str, Any] = {name: on_device(np.float64(value)) for name, value in numbers.items()}
    return {**fields, "coefficients": CoefficientPriors.of(priors, frame.coefficient_scale)}


def feature_design(
    frame: Frame, discrepancy: OrthogonalGP | None, factor: Float[np.ndarray, "n_kept n_column"],
    common: Mapping[str, Any],
) -> FeatureDesign:  # fmt: skip
    """Return the design of rows with a known triangular factor of [Φ ψ y], whitened, in scaled units."""
    n_term = len(frame.dictionary)
    Phi, psi, y = np.split(factor, [n_term, factor.shape[1] - 1], axis=1)
    conditioned = discrepancy is not None and discrepancy.variant == "conditioned"
    Psi = np.asarray(frame.orthogonal(Phi, psi))
    return FeatureDesign(
        Phi=on_device(Phi),
        Psi=on_device(Psi),
        gram=on_device(Psi.T @ Psi),
        y=on_device(y[:, 0]),
        frequency=jnp.zeros((0, 0)) if frame.basis is None else frame.basis.frequency,
        constraints=on_device(frame.moments) if conditioned else None,
        kernel="squared_exponential" if discrepancy is None else discrepancy.kernel,
        **common,
    )


def with_rounding(measured: Float[np.ndarray, " n_obs"], relative: float) -> float:
    """Return the noise floor: the relative one, and the rounding error of the recorded values, in quadrature.

    Values are rounded if some repeat and all differences are multiples of the smallest; a signal of a few levels may
    well be exact. Both arguments are over the RMS of the target.
    """
    return with_steps(np.unique(measured), measured.size, relative)


def with_steps(levels: Float[np.ndarray, " n_level"], n_obs: int, relative: float) -> float:
    """Return `with_rounding` of `n_obs` values from their different levels, in increasing order."""
    steps = np.diff(levels)
    # Fewer steps are no lattice.
    if steps.size < 8 or steps.size == n_obs - 1:
        return relative
    multiples = steps / steps.min()
    rounded = bool(np.all(np.abs(multiples - np.rint(multiples)) < 1e-3))
    rounding = steps.min() / np.sqrt(12) if rounded else 0.0
    return float(np.hypot(relative, rounding))


def sums_of_squares(rows: EquationRows, dictionary: Dictionary, at_once: int) -> Float[np.ndarray, " n_term"]:
    """Return the sum of squares of each term over the samples, evaluated at so many of them at once."""
    squares = np.zeros(len(dictionary))
    for start in range(0, rows.n_sample, at_once):
        squares += np.sum(np.asarray(dictionary.evaluate(rows.at(slice(start, start + at_once)))) ** 2, axis=0)
    return squares


def scaled_table(frame: Frame, rows: EquationRows) -> Table:
    """Return [Φ ψ y] in scaled units by index of the rows; many chunks are evaluated by one compiled program."""
    y = rows.target / frame.target_scale

    def evaluate(columns: Mapping[str, jax.Array | np.ndarray]) -> jax.Array | np.ndarray:
        parts = [frame.dictionary_rows(columns), frame.plain_features(columns)]
        return namespace(columns.values()).concatenate(parts, axis=1)

    if rows.operator is not None:
        terms = rows.table(lambda columns: np.asarray(evaluate(columns)), frame.dictionary.acts_on, frame.jumps)
        return lambda index: np.column_stack([terms(index), y[index]])
    compiled = jax.jit(evaluate)

    def table(index: Int[np.ndarray, " n_chunk"]) -> Float[np.ndarray, "n_chunk n_column"]:
        n = len(index)
        if rows.n_row <= FACTOR_CHUNK:
            values = evaluate(rows.at(index))
        else:
            # A short last chunk is filled up, so that it does not compile anew.
            index = np.concatenate([index, np.full(max(0, FACTOR_CHUNK - n), index[-1])])
            values = compiled({name: jnp.asarray(column) for name, column in rows.at(index).items()})
        return np.column_stack([np.asarray(values)[:n], y[index[:n]]])

    return table


def _dense_design(frame: Frame, gp: OrthogonalGP, rows: EquationRows, table: Table, common: dict) -> DenseDesign:
    if rows.n_sample > EXACT_LIMIT:
        raise InputError(
            f"OrthogonalGP(path='exact') is dense and takes at most {EXACT_LIMIT} rows, not {rows.n_sample}: "
            f"use path='hsgp'."
        )
    whole = table(np.arange(rows.n_row))
    Phi, y = whole[:, : len(frame.dictionary)], whole[:, -1]
    x = jnp.asarray(frame.position(rows.columns))
    orthonormal = Phi @ frame.orthonormal
    points = (x, jnp.asarray(rows.at_samples(frame.dictionary_rows, frame.jumps) @ frame.orthonormal))
    operator = None if rows.operator is None else jnp.asarray(rows.operate(np.eye(rows.n_sample)))
    # ⟨Φₒ, f⟩ = (VΦₒ)ᵀ R⁻¹ V f / n, a sum over samples
    weighted = orthonormal / rows.n_row
    if gp.measure == "empirical" and not rows.noise.local:
        weighted = rows.noise.whiten_transpose(rows.whiten(orthonormal)) / rows.n_white
    at_samples = jnp.asarray(weighted) if operator is None else operator.T @ jnp.asarray(weighted)
    nodes: tuple[jax.Array, jax.Array] = (x, at_samples)
    if gp.measure in ("box", "box-monte-carlo"):
        columns, weights = box_columns(frame, gp, rows.columns)
        at_nodes = frame.dictionary_rows(columns) @ frame.orthonormal
        nodes = (jnp.asarray(frame.position(columns)), jnp.asarray(weights[:, None] * at_nodes))
    whitening = None if rows.noise.local else rows.whiten(np.eye(rows.n_row))
    design = DenseDesign(
        Phi=jnp.asarray(Phi if whitening is None else whitening @ Phi),
        y=jnp.asarray(y if whitening is None else whitening @ y),
        points=points,
        nodes=nodes,
        whitening=None if whitening is None else jnp.asarray(whitening),
        operator=operator,
        kernel=gp.kernel,
        variant=gp.variant,
        **common,
    )
    if gp.variant == "printed":
        _require_covariance(design, gp)
    return design


def _require_covariance(design: DenseDesign, gp: OrthogonalGP) -> None:
    length_scale = jnp.full(design.n_var, gp.length_scale)
    typical = Hyperparameters(design.noise_floor, jnp.asarray(gp.amplitude), length_scale)
    eigenvalues = np.linalg.eigvalsh(np.asarray(design.covariance(typical)))
    if eigenvalues[0] < -1e-10 * np.abs(eigenvalues).max():
        raise InputError(
            f"OrthogonalGP(variant='printed') is not a covariance here: its smallest eigenvalue is "
            f"{eigenvalues[0]:.3g} at amplitude {gp.amplitude:g} and length scale {gp.length_scale:g}; use "
            "variant='projected'."
        )


def _require_traces(whitened: np.ndarray, columns: np.ndarray, names: tuple[str, ...], equation: str) -> None:
    """Refuse terms that whitening wipes out, as the spectral derivative does a constant one."""
    size = np.linalg.norm(columns[:, : len(names)], axis=0)
    lost = np.linalg.norm(whitened, axis=0) < 1e-10 * size
    if np.any(lost):
        raise InputError(
            f"Term {names[int(np.argmax(lost))]!r} of equation {equation!r} leaves no trace in its derivative, which "
            "was computed without its mean: remove the term, or use differentiate(method='savgol')."
        )
