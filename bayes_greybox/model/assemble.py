"""From data to design: scale, orthogonalise, whiten and compress the rows of each equation."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.data.errors import InputError
from bayes_greybox.data.noise import RowNoise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.physics.expressions import namespace
from bayes_greybox.physics.terms import Dictionary

from .compression import CHUNK, triangular_factor
from .discrepancy import EXACT_LIMIT, OrthogonalGP
from .features import HilbertBasis, default_features
from .frame import Frame
from .likelihood import DenseDesign, Design, FeatureDesign, Hyperparameters
from .linalg import require_independent
from .measures import box_nodes
from .orthogonal import orthonormalise

FEWEST_STEPS = 8
"""Values on so many steps of a lattice, or more, count as rounded to it."""

Rows = Callable[[Int[np.ndarray, " n_chunk"]], Float[np.ndarray, "n_chunk n_column"]]


@dataclass(frozen=True)
class Equation:
    """One learned equation, ready for the likelihood: its frame and its design."""

    frame: Frame
    design: Design


def assemble(
    data: Trajectories,
    equation: str,
    dictionary: Dictionary,
    target: Float[np.ndarray, " n_obs"],
    discrepancy: OrthogonalGP | None,
    noise_floor: float,
) -> Equation:
    """Build frame and design of one equation: the only work that grows with the number of rows.

    Args:
        data: Training data.
        equation: Learned state.
        dictionary: Terms of its equation.
        target: Measured derivative less the simulation, user's units.
        discrepancy: The Gaussian process, or None for a purely parametric model.
        noise_floor: Least noise standard deviation over the RMS of the target.

    Raises:
        InputError: Fewer rows than terms; a term that is not finite; collinear terms; a target that is zero;
            too many rows for the exact path; a kernel that is not a covariance.
    """
    noise = data.noise.get(equation)
    n_white = data.n_obs if noise is None else noise.n_white
    if n_white < len(dictionary):
        raise InputError(
            f"Equation {equation!r} has {len(dictionary)} terms but only {n_white} rows of data: give at "
            f"least as many rows as terms."
        )
    measured = data.derivatives[equation]
    target_scale = scale_of(target, measured, equation)
    frame = _scaled_frame(data, equation, dictionary, target_scale, discrepancy)
    rows = _row_evaluator(frame, data, target / target_scale)

    factor = triangular_factor(rows, data.n_obs)
    require_independent(factor[:, : len(dictionary)], dictionary.names, equation)
    if discrepancy is not None:
        frame = _with_measure(frame, discrepancy, data, factor)

    if noise is not None:
        whitened = noise.whiten(rows(np.arange(data.n_obs)))
        _require_traces(whitened[:, : len(dictionary)], factor, dictionary.names, equation)
        factor = triangular_factor(lambda index: whitened[index], len(whitened))
        require_independent(factor[:, : len(dictionary)], dictionary.names, equation)

    n_obs = jnp.asarray(float(n_white))
    common = {
        "n_obs": n_obs,
        "n_prior": n_obs,
        "log_det_R": jnp.asarray(0.0 if noise is None else float(noise.log_det)),
        "noise_floor": jnp.asarray(with_rounding(measured / target_scale, noise_floor)),
    }
    if discrepancy is not None and discrepancy.path == "exact":
        return Equation(frame, _dense_design(frame, discrepancy, data, rows, noise, common))
    Phi, psi, y = np.split(factor, [len(dictionary), factor.shape[1] - 1], axis=1)
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
    return Equation(frame, design)


def scale_of(target: Float[np.ndarray, " n_obs"], measured: Float[np.ndarray, " n_obs"], equation: str) -> float:
    """RMS of the target, which its equation is scaled by.

    Args:
        target: Measured derivative less the simulation, user's units.
        measured: The measured derivative.
        equation: The equation, for the message.

    Raises:
        InputError: Nothing but rounding errors.
    """
    if nothing_left(target, measured):
        raise InputError(
            f"The simulation equals the measured derivative of {equation!r} exactly: there is nothing to learn."
        )
    return float(np.sqrt(np.mean(target**2)))


def nothing_left(target: Float[np.ndarray, " n_obs"], measured: Float[np.ndarray, " n_obs"]) -> bool:
    """Whether the simulation equals the measured derivative but for rounding errors."""
    return bool(np.linalg.norm(target) <= 1e-13 * np.linalg.norm(measured))


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
    discrepancy: OrthogonalGP, data: Trajectories
) -> tuple[tuple[str, ...], Float[np.ndarray, " n_var"], Float[np.ndarray, " n_var"]]:
    """Variables that f depends on, and centre and half-width of their box in the data, user's units.

    Raises:
        InputError: A variable that the data do not have, or that is constant.
    """
    variables = tuple(discrepancy.variables or (*data.state_names, *data.input_names))
    unknown = [name for name in variables if name not in data.columns]
    if unknown:
        raise InputError(
            f"OrthogonalGP(variables=...) names {unknown[0]!r}, which is neither a state nor an input; "
            f"known: {', '.join(data.columns)}."
        )
    centre, half_width = _box(data, variables)
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
    data: Trajectories,
    equation: str,
    dictionary: Dictionary,
    target_scale: float,
    discrepancy: OrthogonalGP | None,
) -> Frame:
    variables, centre, half_width = (), np.zeros(0), np.zeros(0)
    if discrepancy is not None:
        variables, centre, half_width = discrepancy_box(discrepancy, data)
    basis = None
    if discrepancy is not None and discrepancy.path == "hsgp":
        basis = HilbertBasis(discrepancy.boundary, features_per_variable(discrepancy, len(variables)))
    squares = np.zeros(len(dictionary))
    for start in range(0, data.n_obs, 16 * CHUNK):
        part = {name: column[start : start + 16 * CHUNK] for name, column in data.columns.items()}
        squares += np.sum(np.asarray(dictionary.evaluate(part)) ** 2, axis=0)
    if not np.all(np.isfinite(squares)):
        bad = dictionary.names[int(np.argmin(np.isfinite(squares)))]
        raise InputError(f"Term {bad!r} of equation {equation!r} is not finite on all the data: check its domain.")
    if np.any(squares == 0):
        zero = dictionary.names[int(np.argmin(squares))]
        raise InputError(f"Term {zero!r} of equation {equation!r} is zero on all the data: remove it.")
    return Frame(
        equation=equation,
        dictionary=dictionary,
        variables=tuple(variables),
        centre=centre,
        half_width=half_width,
        term_scale=np.sqrt(squares / data.n_obs),
        target_scale=target_scale,
        orthonormal=np.zeros((len(dictionary), 0)),
        basis=basis,
        moments=np.zeros((0, 0 if basis is None else basis.size)),
        projected=False,
    )


def _box(data: Trajectories, names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    low = np.array([data.column(name).min() for name in names])
    high = np.array([data.column(name).max() for name in names])
    return (low + high) / 2, (high - low) / 2


def _row_evaluator(frame: Frame, data: Trajectories, y: Float[np.ndarray, " n_obs"]) -> Rows:
    """Rows [Φ ψ y] by index; of many chunks each is evaluated by one compiled program."""

    def evaluate(columns: Mapping[str, jax.Array | np.ndarray]) -> jax.Array | np.ndarray:
        parts = [frame.dictionary_rows(columns), frame.plain_features(columns)]
        return namespace(columns.values()).concatenate(parts, axis=1)

    compiled = jax.jit(evaluate)

    def rows(index: Int[np.ndarray, " n_chunk"]) -> Float[np.ndarray, "n_chunk n_column"]:
        n = len(index)
        if data.n_obs <= CHUNK:
            values = evaluate({name: column[index] for name, column in data.columns.items()})
        else:
            # A short last chunk is filled up, so that it does not compile anew.
            index = np.concatenate([index, np.full(max(0, CHUNK - n), index[-1])])
            values = compiled({name: jnp.asarray(column[index]) for name, column in data.columns.items()})
        return np.column_stack([np.asarray(values)[:n], y[index[:n]]])

    return rows


def _with_measure(frame: Frame, gp: OrthogonalGP, data: Trajectories, factor: np.ndarray) -> Frame:
    """Orthonormal dictionary and ⟨Φₒ, ψᵀ⟩ under the chosen measure."""
    if gp.measure == "empirical":
        # The triangular factor has the Gram matrix of the data's rows, so it serves as their nodes.
        Phi, psi = factor[:, : len(frame.dictionary)], factor[:, len(frame.dictionary) : -1]
        weights = np.full(len(factor), 1.0 / data.n_obs)
    else:
        columns, weights = _box_columns(frame, gp, data)
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


def _box_columns(frame: Frame, gp: OrthogonalGP, data: Trajectories) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Nodes of the uniform measure on the box of every variable that Φ or f depends on."""
    names = tuple(n for n in data.columns if n in frame.variables or n in frame.dictionary.symbols)
    nodes, weights = box_nodes(
        len(names), monte_carlo=gp.monte_carlo if gp.measure == "box-monte-carlo" else None, seed=gp.seed
    )
    centre, half_width = _box(data, names)
    return dict(zip(names, (centre + half_width * nodes).T, strict=True)), weights


def _dense_design(
    frame: Frame, gp: OrthogonalGP, data: Trajectories, rows: Rows, noise: RowNoise | None, common: dict
) -> DenseDesign:
    if data.n_obs > EXACT_LIMIT:
        raise InputError(
            f"OrthogonalGP(path='exact') is dense and takes at most {EXACT_LIMIT} rows, not {data.n_obs}: "
            f"use path='hsgp'."
        )
    table = rows(np.arange(data.n_obs))
    Phi, y = table[:, : len(frame.dictionary)], table[:, -1]
    x = jnp.asarray(frame.position(data.columns))
    points = (x, jnp.asarray(Phi @ frame.orthonormal))
    nodes: tuple[jax.Array, jax.Array] = (x, points[1] / data.n_obs)
    if gp.measure != "empirical":
        columns, weights = _box_columns(frame, gp, data)
        at_nodes = frame.dictionary_rows(columns) @ frame.orthonormal
        nodes = (jnp.asarray(frame.position(columns)), jnp.asarray(weights[:, None] * at_nodes))
    whitening = None if noise is None else noise.whiten(np.eye(data.n_obs))
    design = DenseDesign(
        Phi=jnp.asarray(Phi if whitening is None else whitening @ Phi),
        y=jnp.asarray(y if whitening is None else whitening @ y),
        points=points,
        nodes=nodes,
        whitening=None if whitening is None else jnp.asarray(whitening),
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
