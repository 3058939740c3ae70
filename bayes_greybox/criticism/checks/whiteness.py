"""Is the noise as white as the model says: autocorrelation of whitened residuals over posterior draws."""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import chi2, norm

from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.model.design import EquationDraws

from .p_values import LEVEL, combined_p

DRAWS = 100
"""Posterior draws whose residuals are looked at."""

ROWS = 20_000
"""Most whitened rows looked at, the first ones: lags need neighbours."""

LAGS = 20
"""Most lags, and a fifth of the rows at most."""


@dataclass(frozen=True)
class Whiteness:
    """Autocorrelation of one equation's whitened residuals.

    Attributes:
        equation: Learned state.
        lag: Lags, in rows (in frequencies where the noise is known by frequency only).
        autocorrelation: Mean over posterior draws at each lag.
        bound: What one autocorrelation exceeds with probability 1 % / number of lags under the model.
        standing_out: Lags whose autocorrelation exceeds its bound in more than half of the draws.
        p: p-value of whiteness; see `whiteness`.
        by_frequency: Whether the lags are steps of frequency.
    """

    equation: str
    lag: Int[np.ndarray, " n_lag"]
    autocorrelation: Float[np.ndarray, " n_lag"]
    bound: Float[np.ndarray, " n_lag"]
    standing_out: tuple[int, ...]
    p: float
    by_frequency: bool


def whiteness(posterior: Posterior, equation: str) -> Whiteness:
    """Test the claim ε ~ N(0, σ²R): e = W(y − g − Φθ − f)/σ must be white, W R Wᵀ = I.

    For one posterior draw of θ, f and σ, e ~ N(0, I) exactly if the data come from the model with its prior, because
    that draw and the data then have the joint distribution of a truth and its data (Johnson 2007, Bayesian Analysis
    2:719): no degrees of freedom are lost to fitting. With r_k the autocorrelation at lag k over the n_k pairs that lie
    in one run (Ljung & Box 1978)

        Q = Σ_k z_k²,   z_k = r_k n/√n_k·√((n + 2)/n),

    is compared with χ² of as many degrees of freedom as lags. p-values of the draws are combined by twice their median,
    which keeps the level whatever their dependence. The level holds, as an upper bound, on average over the prior.

    Where the derivative is known by its Fourier coefficients only (spectral noise), neighbours in time have no
    residuals of their own; there the power of neighbouring frequencies is tested, which a wrong spectrum of R would
    correlate.

    Args:
        posterior: Fitted model.
        equation: Learned state.
    """
    posterior.require_rows("Whiteness is found")
    residuals, lengths, by_frequency = _whitened(posterior, equation, posterior.draws(equation, DRAWS))
    n = residuals.shape[1]
    lags = np.arange(1, max(2, min(LAGS, n // 5, max(lengths) - 1) + 1))
    z, r, bound = _autocorrelation(residuals, lengths, lags)
    standing_out = lags[np.median(np.abs(z), axis=0) > norm.isf(LEVEL / 2 / len(lags))]
    return Whiteness(
        equation=equation,
        lag=lags,
        autocorrelation=r.mean(axis=0),
        bound=bound,
        standing_out=tuple(int(lag) for lag in standing_out),
        p=combined_p(chi2.sf(np.sum(z**2, axis=1), len(lags))),
        by_frequency=by_frequency,
    )


def _autocorrelation(
    e: Float[np.ndarray, "n_draw n_row"], lengths: list[int], lags: Int[np.ndarray, " n_lag"]
) -> tuple[Float[np.ndarray, "n_draw n_lag"], Float[np.ndarray, "n_draw n_lag"], Float[np.ndarray, " n_lag"]]:
    """z_k and r_k of every draw, pairs taken within runs only, and the bound of r_k."""
    n = e.shape[1]
    starts = np.concatenate([[0], np.cumsum(lengths)])
    total = np.sum(e**2, axis=1)
    z, r, bound = [], [], []
    for lag in lags:
        products, pairs = np.zeros(len(e)), 0
        for start, stop in zip(starts[:-1], starts[1:], strict=True):
            if stop - start > lag:
                products += np.sum(e[:, start : stop - lag] * e[:, start + lag : stop], axis=1)
                pairs += int(stop - start - lag)
        # For n standard normals of known mean r_k has variance n_k/(n (n + 2)).
        sd = sqrt(max(pairs, 1) / (n * (n + 2)))
        r.append(products / total)
        z.append(r[-1] / sd)
        bound.append(norm.isf(LEVEL / 2 / len(lags)) * sd)
    return np.stack(z, axis=1), np.stack(r, axis=1), np.array(bound)


def _whitened(
    posterior: Posterior, equation: str, draws: EquationDraws
) -> tuple[Float[np.ndarray, "n_draw n_row"], list[int], bool]:
    """Whitened residuals in units of σ, the length of each stretch, and whether they go along frequency."""
    entry = posterior.equations[equation]
    noise = entry.rows.noise
    # Where rows are whitened one by one, no more are evaluated than are looked at.
    index = slice(ROWS) if noise.local else slice(None)
    Phi, Psi, y = entry.parts(index)
    residuals = y - draws.theta @ Phi.T - entry.design.at_data(Psi, index, draws)
    white = noise.whiten(residuals.T).T / np.asarray(draws.hyper.sigma)[:, None]
    values, lengths, by_frequency = noise.sequences(white)
    kept = np.minimum(np.cumsum(lengths), ROWS)
    return values[:, :ROWS], [int(k) for k in np.diff(kept, prepend=0) if k], by_frequency
