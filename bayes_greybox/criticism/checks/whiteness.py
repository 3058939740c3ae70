"""Whiteness of the noise: autocorrelation of whitened residuals over posterior draws."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import chi2, norm

from bayes_greybox.criticism.cross_validation.folds import lagged_products
from bayes_greybox.inference.posterior import Posterior

from .loo_pit import TEST_LEVEL, combined_p

RESIDUAL_DRAWS, WHITENESS_ROWS, MOST_LAGS = 100, 20_000, 20
"""Posterior draws whose residuals are tested; most whitened rows, the first ones, as lags need neighbours; most lags,
which are at most a fifth of the rows."""


@dataclass(frozen=True)
class Whiteness:
    """Autocorrelation of one equation's whitened residuals.

    Attributes:
        equation: Learned state.
        lag: Lags in rows (in frequencies if the noise is known by frequency only).
        autocorrelation: Mean over posterior draws at each lag.
        bound: Value that one autocorrelation exceeds with probability 1 % / number of lags under the model.
        standing_out: Lags whose autocorrelation exceeds its bound in more than half of the draws.
        p: p-value of whiteness; see `whiteness`.
        by_frequency: True if the lags are steps of frequency.
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

    is compared with χ² of as many degrees of freedom as lags. The p-values of the draws are combined by `combined_p`.
    The level holds, as an upper bound, on average over the prior.

    If the derivative is known by its Fourier coefficients only (spectral noise), rows have no residuals of their own.
    Then the power of neighbouring frequencies is tested, which a wrong spectrum of R would correlate.
    """
    posterior.require_rows("Whiteness is found")
    residuals, lengths, by_frequency = _whitened(posterior, equation)
    n = residuals.shape[1]
    lags = np.arange(1, max(2, min(MOST_LAGS, n // 5, max(lengths) - 1) + 1))
    z, r, bound = _autocorrelation(residuals, lengths, lags)
    standing_out = lags[np.median(np.abs(z), axis=0) > norm.isf(TEST_LEVEL / 2 / len(lags))]
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
    """Return z_k and r_k of every draw, with pairs within runs only, and the bound of r_k."""
    n = e.shape[1]
    products, pairs = lagged_products(e, lengths, int(lags[-1]) + 1)
    r = products[:, lags] / np.sum(e**2, axis=1, keepdims=True)
    # For n standard normals of known mean r_k has variance n_k/(n (n + 2)).
    sd = np.sqrt(np.maximum(pairs[lags], 1) / (n * (n + 2)))
    return r / sd, r, norm.isf(TEST_LEVEL / 2 / len(lags)) * sd


def _whitened(posterior: Posterior, equation: str) -> tuple[Float[np.ndarray, "n_draw n_row"], list[int], bool]:
    """Return whitened residuals in units of σ, the length of each stretch, and True if they go along frequency."""
    entry, draws = posterior.equations[equation], posterior.draws(equation, RESIDUAL_DRAWS)
    noise = entry.rows.noise
    # If rows are whitened one by one, only those that are tested are evaluated.
    index = slice(WHITENESS_ROWS) if noise.local else slice(None)
    Phi, Psi, y = entry.parts(index)
    residuals = y - draws.theta @ Phi.T - entry.design.at_data(Psi, index, draws)
    white = noise.whiten(residuals.T).T / np.asarray(draws.hyper.sigma)[:, None]
    values, lengths, by_frequency = noise.sequences(white)
    ends = np.minimum(np.cumsum(lengths), WHITENESS_ROWS)
    return values[:, :WHITENESS_ROWS], [int(k) for k in np.diff(ends, prepend=0) if k], by_frequency
