"""What f does: its share of the variance, its trade-off with the dictionary, and its shape."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float
from scipy.spatial import KDTree

from bayes_greybox.data.errors import InputError
from bayes_greybox.inference.draws import draw_given
from bayes_greybox.inference.posterior import EquationDraws, Posterior
from bayes_greybox.model.assemble import Equation
from bayes_greybox.model.likelihood import CollapsedNormal, DenseDesign, FeatureDesign, Hyperparameters
from bayes_greybox.model.priors import Scales
from bayes_greybox.model.simulation import Simulation
from bayes_greybox.physics.units import coefficient_unit, derivative_unit

from .grid import DiscrepancyGrid
from .prediction import DENSE_DRAWS, PREDICTION_DRAWS, Band, discrepancy_draws

ROWS = 5000
"""Rows, evenly spaced, that variance shares are computed on."""

SUPPORT = 0.2
"""A grid point this close to a measured row, in half-widths of the box, lies inside the data."""


@dataclass(frozen=True)
class TradeOff:
    """The coefficient that f can stand in for most: posterior draws of both, user's units.

    Attributes:
        equation: Learned state.
        term: The dictionary's term.
        theta: Its coefficient.
        projection: The coefficient that f mimics: that of its least-squares projection on the dictionary.
        correlation: Posterior correlation of the two; 0 when f has no such part.
        unit: Unit of both.
    """

    equation: str
    term: str
    theta: Float[np.ndarray, " n_draw"]
    projection: Float[np.ndarray, " n_draw"]
    correlation: float
    unit: str


def discrepancy_table(posterior: Posterior, level: float = 0.9) -> pd.DataFrame:
    """Where the variance goes, and how well f keeps off the dictionary.

    With y = g + Φθ + f + ε the share of a part c is cov(c, y)/var(y), so the four shares add up to one whatever the
    correlations between the parts. `overlap` is the largest |⟨φ_j, f⟩|/(‖φ_j‖ ‖f‖) over the terms on the data, and
    `correlation` the largest posterior |corr(θ_j, j-th coefficient of f projected on Φ)|; `..._none` are the same for
    the plain kernel at the same hyperparameters.

    Args:
        posterior: Fitted model.
        level: Probability of the interval of the discrepancy's share.

    Returns:
        Table indexed by equation: simulation, dictionary, discrepancy, noise (shares), discrepancy_lower,
        discrepancy_upper, rms (of f, user's units), sigma (noise, user's units), overlap, correlation, term (the one it
        belongs to), overlap_none, correlation_none.
    """
    rows = {}
    data = posterior.data
    index = np.unique(np.linspace(0, data.n_obs - 1, min(data.n_obs, ROWS)).astype(int))
    columns = {name: column[index] for name, column in data.columns.items()}
    simulation = Simulation.of(posterior.model.simulation, data.state_names, data.input_names)
    for name, equation in posterior.equations.items():
        frame = equation.frame
        draws = posterior.draws(name, _draw_count(equation))
        y = data.derivatives[name][index]
        g = simulation.on(data, name)[index]
        Phi = np.asarray(frame.dictionary_rows(columns)) * frame.target_scale
        f = discrepancy_draws(equation, draws, columns)
        centred = y - y.mean()

        def share(part: np.ndarray, centred: np.ndarray = centred) -> np.ndarray:
            return np.asarray(part @ centred / (centred @ centred))

        black = share(f)
        parts = {"simulation": share(g), "dictionary": share(draws.theta @ Phi.T).mean(), "discrepancy": black.mean()}
        parts["noise"] = 1.0 - sum(parts.values())
        tail = (1 - level) / 2
        own, beside = trade_offs(equation, draws), trade_offs(equation, draws, plain=True)
        worst = int(np.argmax(np.abs(own.correlation)))
        rows[name] = {
            **{key: float(value) for key, value in parts.items()},
            "discrepancy_lower": float(np.quantile(black, tail)),
            "discrepancy_upper": float(np.quantile(black, 1 - tail)),
            "rms": float(np.sqrt(np.mean(f**2))),
            "sigma": float(np.mean(draws.hyper.sigma) * frame.target_scale),
            "overlap": float(own.overlap.max()),
            "correlation": float(np.abs(own.correlation).max()),
            "term": frame.dictionary.names[worst],
            "overlap_none": float(beside.overlap.max()),
            "correlation_none": float(np.abs(beside.correlation).max()),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("equation")


@dataclass(frozen=True)
class TradeOffs:
    """Draws of θ and of the projection of f on the dictionary, and how they go together, for every term."""

    theta: Float[np.ndarray, "n_draw n_term"]
    projection: Float[np.ndarray, "n_draw n_term"]
    correlation: Float[np.ndarray, " n_term"]
    overlap: Float[np.ndarray, " n_term"]


def trade_offs(equation: Equation, draws: EquationDraws, *, plain: bool = False) -> TradeOffs:
    """θ against the least-squares projection (ΦᵀΦ)⁻¹ Φᵀ f of f on the fitted rows, scaled units.

    Args:
        equation: Equation.
        draws: Posterior draws of it.
        plain: Take the plain kernel `none` instead, with θ and f drawn anew given the same hyperparameters.
    """
    design = equation.design
    if plain:
        theta, f = _plain_draws(equation, draws)
    elif isinstance(design, FeatureDesign):
        theta, f = draws.theta, draws.weight @ np.asarray(design.Psi).T
    else:
        theta, f = _redrawn(design, draws)
    Phi = np.asarray(design.Phi)
    projection = f @ np.linalg.pinv(Phi).T
    norms = np.linalg.norm(f, axis=1)
    alive = norms > 0
    cosines = np.abs(f[alive] @ (Phi / np.linalg.norm(Phi, axis=0))) / norms[alive, None]
    overlap = cosines.mean(axis=0) if alive.any() else np.zeros(Phi.shape[1])
    # A projection that is zero but for rounding has no correlation with anything.
    still = np.sqrt(np.mean(projection**2, axis=0)) <= 1e-9 * max(1e-300, float(np.sqrt(np.mean(f**2))))
    correlation = np.zeros(Phi.shape[1])
    for j in np.flatnonzero(~still & (theta.std(axis=0) > 0)):
        correlation[j] = np.corrcoef(theta[:, j], projection[:, j])[0, 1]
    return TradeOffs(theta, projection, correlation, overlap)


def strongest_trade_off(posterior: Posterior, equation: str) -> TradeOff:
    """The term whose coefficient trades off most with f, for a pair plot."""
    entry = posterior.equations[_known(posterior, equation)]
    both = trade_offs(entry, posterior.draws(equation, _draw_count(entry)))
    j = int(np.argmax(np.abs(both.correlation)))
    scale = entry.frame.coefficient_scale[j]
    units = dict(posterior.data.units)
    return TradeOff(
        equation=equation,
        term=entry.frame.dictionary.names[j],
        theta=both.theta[:, j] * scale,
        projection=both.projection[:, j] * scale,
        correlation=float(both.correlation[j]),
        unit=coefficient_unit(derivative_unit(equation, units), entry.frame.dictionary.terms[j], units),
    )


def discrepancy_grid(
    posterior: Posterior,
    equation: str,
    variables: tuple[str, ...] | None = None,
    size: int = 41,
    level: float = 0.9,
) -> DiscrepancyGrid:
    """Posterior of f over one or two of its variables, the others held at their median.

    Args:
        posterior: Fitted model.
        equation: Learned state.
        variables: One or two of the variables of f; None: the first two.
        size: Grid points in each direction (five times as many for one variable).
        level: Probability of the intervals.

    Raises:
        InputError: Unknown equation or variables; a model without discrepancy.
    """
    entry = posterior.equations[_known(posterior, equation)]
    frame, data = entry.frame, posterior.data
    if not frame.variables:
        raise InputError("The model has no discrepancy to show: fit with bg.OrthogonalGP().")
    variables = tuple(variables or frame.variables[:2])
    unknown = [name for name in variables if name not in frame.variables]
    if unknown or not 1 <= len(variables) <= 2:
        raise InputError(f"variables={variables!r} must be one or two of {', '.join(frame.variables)}.")
    count = size if len(variables) == 2 else 5 * size
    axes = tuple(np.linspace(data.column(n).min(), data.column(n).max(), count) for n in variables)
    mesh = np.meshgrid(*axes, indexing="ij")
    others = {name: float(np.median(column)) for name, column in data.columns.items() if name not in variables}
    columns = {name: np.full(mesh[0].size, value) for name, value in others.items()}
    columns |= {name: values.ravel() for name, values in zip(variables, mesh, strict=True)}
    band = Band.of(discrepancy_draws(entry, posterior.draws(equation, _draw_count(entry)), columns), level)
    points = data.matrix(variables)
    half = np.array([np.ptp(axis) / 2 for axis in axes])
    nodes = np.stack([values.ravel() for values in mesh], axis=1)
    inside = KDTree(points / half).query(nodes / half)[0] <= SUPPORT
    shape = mesh[0].shape
    units = dict(data.units)
    return DiscrepancyGrid(
        equation=equation,
        variables=variables,
        axes=axes,
        mean=band.mean.reshape(shape),
        sd=band.sd.reshape(shape),
        lower=band.lower.reshape(shape),
        upper=band.upper.reshape(shape),
        inside=inside.reshape(shape),
        points=points,
        units=tuple(units.get(name, "") for name in variables),
        unit=derivative_unit(equation, units),
        fixed={name: value for name, value in others.items() if name in frame.variables},
        level=level,
    )


def _plain_draws(equation: Equation, draws: EquationDraws) -> tuple[np.ndarray, np.ndarray]:
    """θ and f on the design's rows under the kernel `none`, given the same hyperparameters and prior scales."""
    design, frame = equation.design, equation.frame
    if isinstance(design, DenseDesign):
        return _redrawn(replace(design, variant="none"), draws)
    Psi = design.Psi
    if frame.projected:
        Psi = Psi + design.Phi @ frame.orthonormal @ frame.moments
    plain = replace(design, Psi=Psi, gram=Psi.T @ Psi, constraints=None)
    theta, weight = _conditional(plain, draws, "weight")
    return theta, weight @ np.asarray(Psi).T


def _redrawn(design: DenseDesign, draws: EquationDraws) -> tuple[np.ndarray, np.ndarray]:
    theta, f = _conditional(design, draws, "f")
    return theta, f if design.whitening is None else f @ np.asarray(design.whitening).T


def _conditional(design: FeatureDesign | DenseDesign, draws: EquationDraws, part: str) -> tuple[np.ndarray, np.ndarray]:
    keys = jax.random.split(jax.random.PRNGKey(0), len(draws.theta))

    def one(item: tuple[Array, Hyperparameters, Array]) -> tuple[Array, Array]:
        key, hyper, sd = item
        drawn = draw_given(key, CollapsedNormal(design, hyper, Scales(sd)))
        return drawn["theta"], drawn[part]

    hyper = Hyperparameters(*(jnp.asarray(value) for value in draws.hyper))
    theta, values = jax.jit(lambda items: jax.lax.map(one, items))((keys, hyper, jnp.asarray(draws.prior_sd)))
    return np.asarray(theta), np.asarray(values)


def _draw_count(equation: Equation) -> int:
    return DENSE_DRAWS if isinstance(equation.design, DenseDesign) else PREDICTION_DRAWS


def _known(posterior: Posterior, equation: str) -> str:
    if equation not in posterior.equations:
        raise InputError(f"There is no equation {equation!r}; the model learns {', '.join(posterior.equations)}.")
    return equation
