"""Trade-offs of f with the coefficients, under the orthogonal kernel and the plain one."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.remembering import remembered
from bayes_greybox.inference.sampler.draws import draw_given
from bayes_greybox.model.design import Design, EquationDraws
from bayes_greybox.model.equation import Equation
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.model.likelihood import CollapsedNormal
from bayes_greybox.model.priors import Scales
from bayes_greybox.physics.units import coefficient_unit, target_unit
from bayes_greybox.running.arrays import on_device
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.traces import kept

from .prediction import PREDICTION_DRAWS


@dataclass(frozen=True)
class TradeOff:
    """The coefficient that f can mimic most: posterior draws of both, user's units.

    Attributes:
        equation: Learned state.
        term: Term of the dictionary.
        theta: Coefficient of the term.
        projection: Coefficient of the term in the least-squares projection of f on the dictionary.
        correlation: Posterior correlation of the two; 0 if f has no such part.
        unit: Unit of both.
    """

    equation: str
    term: str
    theta: Float[np.ndarray, " n_draw"]
    projection: Float[np.ndarray, " n_draw"]
    correlation: float
    unit: str


class TradeOffs(NamedTuple):
    """Draws of θ and of the projection of f on the dictionary, with their correlation and overlap by term."""

    theta: Float[np.ndarray, "n_draw n_term"]
    projection: Float[np.ndarray, "n_draw n_term"]
    correlation: Float[np.ndarray, " n_term"]
    overlap: Float[np.ndarray, " n_term"]


def trade_offs(equation: Equation, draws: EquationDraws, *, plain: bool = False) -> TradeOffs:
    """Compare θ with the least-squares projection (ΦᵀΦ)⁻¹ Φᵀ f of f on the fitted rows, scaled units.

    With `plain` this is for the plain kernel `none`, with θ and f drawn anew given the same hyperparameters.
    """
    design = equation.design
    if plain:
        design = design.plain(equation.frame)
        draws = redrawn(design, draws)
    theta, f = draws.theta, design.on_rows(draws.weight, draws.f)
    Phi = np.asarray(design.Phi)
    projection = f @ np.linalg.pinv(Phi).T
    norms = np.linalg.norm(f, axis=1)
    alive = norms > 0
    cosines = np.abs(f[alive] @ (Phi / np.linalg.norm(Phi, axis=0))) / norms[alive, None]
    overlap = cosines.mean(axis=0) if alive.any() else np.zeros(Phi.shape[1])
    # A projection that is zero up to rounding has no correlation with anything.
    still = np.sqrt(np.mean(projection**2, axis=0)) <= 1e-9 * max(1e-300, float(np.sqrt(np.mean(f**2))))
    correlation = np.zeros(Phi.shape[1])
    for j in np.flatnonzero(~still & (theta.std(axis=0) > 0)):
        correlation[j] = np.corrcoef(theta[:, j], projection[:, j])[0, 1]
    return TradeOffs(theta, projection, correlation, overlap)


@remembered
def plain_trade_offs(posterior: Posterior) -> pd.DataFrame:
    """Return the trade-offs that the plain kernel `none` would have, for which θ and f are drawn anew.

    The table is indexed by equation: overlap and correlation, each the largest among the terms.
    """
    rows = {}
    for name, equation in posterior.equations.items():
        draws = posterior.draws(name, equation.design.worthwhile(PREDICTION_DRAWS))
        both = trade_offs(equation, draws, plain=True)
        rows[name] = {"overlap": float(both.overlap.max()), "correlation": float(np.abs(both.correlation).max())}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("equation")


def strongest_trade_off(posterior: Posterior, equation: str) -> TradeOff:
    """Return the term whose coefficient trades off most with f, for a pair plot."""
    posterior.require_rows("Trade-offs are found")
    entry = known_equation(posterior, equation)
    both = trade_offs(entry, posterior.draws(equation, entry.design.worthwhile(PREDICTION_DRAWS)))
    j = int(np.argmax(np.abs(both.correlation)))
    scale, term = entry.frame.coefficient_scale[j], entry.frame.dictionary.terms[j]
    unit = coefficient_unit(target_unit(equation, posterior.data), term, dict(posterior.data.units))
    draws = both.theta[:, j] * scale, both.projection[:, j] * scale
    return TradeOff(equation, entry.frame.dictionary.names[j], *draws, float(both.correlation[j]), unit)


def known_equation(posterior: Posterior, equation: str) -> Equation:
    """Return an equation by its name; raise InputError if the model has none of it."""
    if equation not in posterior.equations:
        raise InputError(f"There is no equation {equation!r}; the model learns {', '.join(posterior.equations)}.")
    return posterior.equations[equation]


def redrawn(design: Design, draws: EquationDraws) -> EquationDraws:
    """Draw θ and f anew given the hyperparameters and prior scales of other draws, without bounds."""
    keys = jax.random.split(jax.random.PRNGKey(0), len(draws.theta))

    def every(design: Design, items: tuple[Array, Hyperparameters, Array]) -> dict[str, Array]:
        def one(item: tuple[Array, Hyperparameters, Array]) -> dict[str, Array]:
            key, hyper, sd = item
            return draw_given(key, CollapsedNormal(design, hyper, Scales(sd, mean=design.coefficients.mean)))

        return jax.lax.map(one, items)

    drawn = kept(every, (), "redrawn", once=True)(design, (keys, *on_device((draws.hyper, draws.prior_sd))))
    return draws._replace(**{name: np.asarray(drawn[name]) for name in ("theta", "weight", "f") if name in drawn})
