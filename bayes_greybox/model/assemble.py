"""From data to design: scale, orthogonalise, whiten and compress the rows of each equation."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.errors import InputError
from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.physics.formula.expressions import namespace
from bayes_greybox.physics.terms import Dictionary

from .algebra.compression import CHUNK, triangular_factor
from .algebra.linalg import require_independent
from .coefficient_priors import CoefficientPriors
from .design import DenseDesign, FeatureDesign
from .equation import Equation
from .frame import Frame
from .gp.discrepancy import EXACT_LIMIT, OrthogonalGP
from .gp.features import HilbertBasis, default_features
from .gp.hyper import Hyperparameters
from .gp.orthogonal import box_nodes, orthonormalise
from .rows.equation_rows import EquationRows, Table

FEWEST_STEPS = 8
"""Values on so many steps of a lattice, or more, count as rounded to it."""


def assemble(
    rows: EquationRows,
    dictionary: Dictionary,
    discrepancy: OrthogonalGP | None,
    noise_floor: float,
    coefficients: Sequence[Coefficient | None] | None = None,
) -> Equation:
    """Build frame and design of one equation: the only work that grows with the number of rows.

    Args:
        rows: Rows of the equation.
        dictionary: Terms of its equation.
        discrepancy: The Gaussian process, or None for a purely parametric model.
        noise_floor: Least noise standard deviation over the RMS of the target.
        coefficients: Prior of each term, None where the model's holds alone.

    Raises:
        InputError: Fewer rows than terms; a term that is not finite; collinear terms; a target that is zero;
            too many rows for the exact path; a kernel that is not a covariance.
    """
    equation, n_term = rows.equation, len(dictionary)
    if rows.n_white < n_term:
        raise InputError(
            f"Equation {equation!r} has {n_term} terms but only {rows.n_white} rows of data: give at "
            f"least as many rows as terms."
        )
    target_scale = rows.scale
    frame = _scaled_frame(rows, dictionary, target_scale, discrepancy)
    table = _scaled_table(frame, rows)

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
        frame = _with_measure(frame, discrepancy, rows, plain if discrepancy.measure == "unweighted" else factor)

    n_obs = jnp.asarray(float(rows.n_white))
    common = {
        "n_obs": n_obs,
        "n_prior": n_obs,
        "log_det_R": jnp.asarray(float(rows.noise.log_det)),
        "noise_floor": jnp.asarray(with_rounding(rows.measured / target_scale, noise_floor)),
        "coefficients": CoefficientPriors.of(
            [None] * n_term if coefficients is None else coefficients, frame.coefficient_scale
        ),
    }
    if discrepancy is not None and discrepancy.path == "exact":
        return Equation(rows, frame, _dense_design(frame, discrepancy, rows, table, common))
    Phi, psi, y = np.split(factor, [n_term, factor.shape[1] - 1], axis=1)
    conditioned = discrepancy is not None and discrepancy.variant == "conditioned"
    Psi = np.asarray(frame.orthogonal(Phi, psi))
    design = FeatureDesign(
        Phi=jnp.asarray(Phi),
        Psi=jnp.asarray(Psi),
        gram=jnp.asarray(Psi.T @ Psi),
        y=jnp.asarray(y[:, 0]),
        frequency=jnp.zeros((0, 0)) if frame.basis is None else frame.basis.frequency,
        constraints=jnp.asarray(frame.moments) if conditioned else None,
        kernel="squared_exponential" if discrepancy is None else discrepancy.kernel,
        **common,
    )
    return Equation(rows, frame, design)


def with_rounding(measured: Float[np.ndarray, " n_obs"], relative: float) -> float:
    """Noise floor: the relative one, and the rounding error of the recorded values, in quadrature.

    Values are rounded if some repeat and all differences are multiples of the smallest; of unrounded values the
    smallest difference says nothing but how many there are, and a signal of a few levels may well be exact.

    Args:
        measured: The measured derivative over the RMS of the target.
        relative: Least noise standard deviation over the RMS of the target.
    """
    steps = np.diff(np.unique(measured))
    if steps.size < FEWEST_STEPS or steps.size == measured.size - 1:
        return relative
    multiples = steps / steps.min()
    rounded = bool(np.all(np.abs(multiples - np.rint(multiples)) < 1e-3))
    rounding = steps.min() / np.sqrt(12) if rounded else 0.0
    return float(np.hypot(relative, rounding))


def discrepancy_box(
    discrepancy: OrthogonalGP, columns: Mapping[str, Float[np.ndarray, " n_row"]]
) -> tuple[tuple[str, ...], Float[np.ndarray, " n_var"], Float[np.ndarray, " n_var"]]:
    """Variables that f depends on, and centre and half-width of their box in the data, user's units.

    Raises:
        InputError: A variable that the data do not have, or that is constant.
    """
    variables = tuple(discrepancy.variables or columns)
    unknown = [name for name in variables if name not in columns]
    if unknown:
        raise InputError(
            f"OrthogonalGP(variables=...) names {unknown[0]!r}, which is neither a state nor an input; "
            f"known: {', '.join(columns)}."
        )
    centre, half_width = _box(columns, variables)
    if np.any(half_width == 0):
        constant = variables[int(np.argmin(half_width))]
        raise InputError(
            f"The discrepancy depends on {constant!r}, which is constant on all the data: leave it out of "
            "OrthogonalGP(variables=...)."
        )
    return variables, centre, half_width


def features_per_variable(
    discrepancy: OrthogonalGP, n_var: int, default: tuple[int, ...] | None = None
) -> tuple[int, ...]:
    """Features along each variable: those that the user named, or the default.

    Raises:
        InputError: A number of features below one, or not one for each variable.
    """
    given = discrepancy.features
    if given is None:
        return default or default_features(n_var)
    per_variable = (given,) * n_var if isinstance(given, int) else tuple(given)
    if len(per_variable) != n_var or min(per_variable) < 1:
        raise InputError(
            f"OrthogonalGP(features={given!r}) must be a positive number, or one for each of the {n_var} variables."
        )
    return per_variable


def _scaled_frame(
    rows: EquationRows, dictionary: Dictionary, target_scale: float, discrepancy: OrthogonalGP | None
) -> Frame:
    equation = rows.equation
    variables, centre, half_width = (), np.zeros(0), np.zeros(0)
    if discrepancy is not None:
        variables, centre, half_width = discrepancy_box(discrepancy, rows.columns)
    basis = None
    if discrepancy is not None and discrepancy.path == "hsgp":
        basis = HilbertBasis(discrepancy.boundary, features_per_variable(discrepancy, len(variables)))
    squares = np.zeros(len(dictionary))
    for start in range(0, rows.n_sample, 16 * CHUNK):
        part = rows.at(slice(start, start + 16 * CHUNK))
        squares += np.sum(np.asarray(dictionary.evaluate(part)) ** 2, axis=0)
    if not np.all(np.isfinite(squares)):
        bad = dictionary.names[int(np.argmin(np.isfinite(squares)))]
        raise InputError(f"Term {bad!r} of equation {equation!r} is not finite on all the data: check its domain.")
    if np.any(squares == 0):
        zero = dictionary.names[int(np.argmin(squares))]
        raise InputError(f"Term {zero!r} of equation {equation!r} is zero on all the data: remove it.")
    sizes = np.array([rows.learned[name].size for name in dictionary.acts_on] or [1.0])
    return Frame(
        equation=equation,
        dictionary=dictionary,
        variables=tuple(variables),
        centre=centre,
        half_width=half_width,
        # A state in small units moves by small forces.
        term_scale=np.sqrt(squares / rows.n_sample) / sizes,
        target_scale=target_scale,
        orthonormal=np.zeros((len(dictionary), 0)),
        basis=basis,
        moments=np.zeros((0, 0 if basis is None else basis.size)),
        projected=False,
    )


def _box(columns: Mapping[str, np.ndarray], names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    low = np.array([columns[name].min() for name in names])
    high = np.array([columns[name].max() for name in names])
    return (low + high) / 2, (high - low) / 2


def _scaled_table(frame: Frame, rows: EquationRows) -> Table:
    """[Φ ψ y] by index; of many chunks each is evaluated by one compiled program."""
    y = rows.target / frame.target_scale

    def evaluate(columns: Mapping[str, jax.Array | np.ndarray]) -> jax.Array | np.ndarray:
        parts = [frame.dictionary_rows(columns), frame.plain_features(columns)]
        return namespace(columns.values()).concatenate(parts, axis=1)

    if rows.operator is not None:
        terms = rows.table(lambda columns: np.asarray(evaluate(columns)), frame.dictionary.acts_on)
        return lambda index: np.column_stack([terms(index), y[index]])
    compiled = jax.jit(evaluate)

    def table(index: Int[np.ndarray, " n_chunk"]) -> Float[np.ndarray, "n_chunk n_column"]:
        n = len(index)
        if rows.n_row <= CHUNK:
            values = evaluate(rows.at(index))
        else:
            # A short last chunk is filled up, so that it does not compile anew.
            index = np.concatenate([index, np.full(max(0, CHUNK - n), index[-1])])
            values = compiled({name: jnp.asarray(column) for name, column in rows.at(index).items()})
        return np.column_stack([np.asarray(values)[:n], y[index[:n]]])

    return table


def _with_measure(frame: Frame, gp: OrthogonalGP, rows: EquationRows, factor: np.ndarray) -> Frame:
    """Orthonormal dictionary and ⟨Φₒ, ψᵀ⟩ under the chosen measure; `factor` is that of the rows it is taken on."""
    if gp.measure in ("empirical", "unweighted"):
        # The triangular factor has the Gram matrix of its rows, so it serves as their nodes. With whitened rows
        # ⟨a, b⟩ = aᵀ R⁻¹ b / n, in which least squares with and without f mean the same θ.
        Phi, psi = factor[:, : len(frame.dictionary)], factor[:, len(frame.dictionary) : -1]
        weights = np.full(len(factor), 1.0 / (rows.n_white if gp.measure == "empirical" else rows.n_row))
    else:
        columns, weights = _box_columns(frame, gp, rows)
        Phi, psi = np.asarray(frame.dictionary_rows(columns)), np.asarray(frame.plain_features(columns))
        if not np.all(np.isfinite(Phi)):
            bad = frame.dictionary.names[int(np.argmin(np.isfinite(Phi).all(axis=0)))]
            raise InputError(
                f"Term {bad!r} is not finite on the whole box of the data, which "
                f"OrthogonalGP(measure={gp.measure!r}) integrates over: use measure='empirical'."
            )
    T = orthonormalise(Phi, weights)
    moments = (weights[:, None] * (Phi @ T)).T @ psi
    return replace(frame, orthonormal=T, moments=moments, projected=gp.variant == "projected")


def _box_columns(frame: Frame, gp: OrthogonalGP, rows: EquationRows) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Nodes of the uniform measure on the box of every variable that Φ or f depends on."""
    names = tuple(n for n in rows.columns if n in frame.variables or n in frame.dictionary.symbols)
    nodes, weights = box_nodes(
        len(names), monte_carlo=gp.monte_carlo if gp.measure == "box-monte-carlo" else None, seed=gp.seed
    )
    centre, half_width = _box(rows.columns, names)
    return dict(zip(names, (centre + half_width * nodes).T, strict=True)), weights


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
    points = (x, jnp.asarray(frame.dictionary_rows(rows.columns) @ frame.orthonormal))
    operator = None if rows.operator is None else jnp.asarray(rows.operate(np.eye(rows.n_sample)))
    # ⟨Φₒ, f⟩ = (VΦₒ)ᵀ R⁻¹ V f / n, a sum over samples
    weighted = orthonormal / rows.n_row
    if gp.measure == "empirical" and not rows.noise.local:
        weighted = rows.noise.whiten_transpose(rows.whiten(orthonormal)) / rows.n_white
    at_samples = jnp.asarray(weighted) if operator is None else operator.T @ jnp.asarray(weighted)
    nodes: tuple[jax.Array, jax.Array] = (x, at_samples)
    if gp.measure in ("box", "box-monte-carlo"):
        columns, weights = _box_columns(frame, gp, rows)
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
    _require_covariance(design, gp, len(frame.variables))
    return design


def _require_covariance(design: DenseDesign, gp: OrthogonalGP, n_var: int) -> None:
    if gp.variant != "printed":
        return
    typical = Hyperparameters(design.noise_floor, jnp.asarray(gp.amplitude), jnp.full(n_var, gp.length_scale))
    eigenvalues = np.linalg.eigvalsh(np.asarray(design.covariance(typical)))
    if eigenvalues[0] < -1e-10 * np.abs(eigenvalues).max():
        raise InputError(
            f"OrthogonalGP(variant='printed') is not a covariance here: its smallest eigenvalue is "
            f"{eigenvalues[0]:.3g} at amplitude {gp.amplitude:g} and length scale {gp.length_scale:g}; use "
            "variant='projected'."
        )


def _require_traces(
    whitened: Float[np.ndarray, "n_white n_term"],
    columns: Float[np.ndarray, "n_row n_term_and_more"],
    names: tuple[str, ...],
    equation: str,
) -> None:
    """Refuse terms that whitening wipes out, as the spectral derivative does a constant one."""
    size = np.linalg.norm(columns[:, : len(names)], axis=0)
    lost = np.linalg.norm(whitened, axis=0) < 1e-10 * size
    if np.any(lost):
        raise InputError(
            f"Term {names[int(np.argmax(lost))]!r} of equation {equation!r} leaves no trace in its derivative, which "
            "was computed without its mean: remove the term, or use differentiate(method='savgol')."
        )
