"""Evidence of hypotheses with a discrepancy f: y = X β + f + ε, β ~ N(0, D), f ~ GP(0, k⊥), ε ~ N(0, σ² R).

f is orthogonal to the columns X of its hypothesis in the metric of R⁻¹. Rows in the span of X and rows orthogonal to it
then never mix:

    log p(y | η) = log N(y; 0, X D Xᵀ + σ² R) + gain(η),   gain = log N(y⊥; 0, Ψ S Ψᵀ + σ²) − log N(y⊥; 0, σ²),

with y⊥ and Ψ the target and the features less their projections on X. The first part needs one eigendecomposition a
hypothesis (see `parametric`); the whole is integrated over η by importance sampling around its mode.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import scipy.optimize
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float

from bayes_greybox.inference.bridge import Bridged, bridge
from bayes_greybox.model.algebra.collapsed import scaled_solve
from bayes_greybox.model.gp.hyper import Hyperparameters, HyperPrior
from bayes_greybox.model.gp.kernels import KERNELS, log_spectral_density
from bayes_greybox.running.compiling import compiled

IMPORTANCE_DRAWS = 200
"""Draws of the importance sampler over η."""

DEGREES = 6.0
"""Degrees of freedom of its Student-t proposal, whose tails are heavier than those of any posterior of η here."""

PROPOSAL_SPREAD = 1.2
"""Width of the proposal over that of the Laplace approximation."""


@dataclass(frozen=True)
class WithDiscrepancy:
    """A hypothesis with f, ready to be evaluated: its parametric part for each pattern, and its features.

    Attributes:
        eigenvalues: λ of each inclusion pattern [n_pattern, n_column].
        loading: b of each pattern [n_pattern, n_column].
        log_prior: Log prior probability of each pattern.
        square: yᵀR⁻¹y.
        n_obs: Number of observations.
        gram: ΨᵀR⁻¹Ψ of the features orthogonal to this hypothesis' columns.
        product: ΨᵀR⁻¹y.
    """

    eigenvalues: Float[np.ndarray, "n_pattern n_column"]
    loading: Float[np.ndarray, "n_pattern n_column"]
    log_prior: Float[np.ndarray, " n_pattern"]
    square: float
    n_obs: float | int
    gram: Float[np.ndarray, "n_basis n_basis"]
    product: Float[np.ndarray, " n_basis"]


class Integrated(NamedTuple):
    """Evidence of a hypothesis with f.

    Attributes:
        log_evidence: By importance sampling.
        se: Its Monte Carlo standard error.
        laplace: By Laplace's approximation.
        mode: η = (log s, log amplitude, log ℓ) at the mode.
        covariance: Of the Laplace approximation.
    """

    log_evidence: float
    se: float
    laplace: float
    mode: np.ndarray
    covariance: np.ndarray


class Evaluator:
    """log p(y, η) of hypotheses with f; compiled once for each size of basis, whatever the hypothesis.

    Args:
        prior: Prior of η.
        kernel: Name of the base kernel.
        frequency: Frequencies of the features [n_basis, n_var].
    """

    def __init__(self, prior: HyperPrior, kernel: str, frequency: Float[np.ndarray, "n_basis n_var"]):
        self.prior, self.kernel = prior, kernel
        self.frequency = jnp.asarray(frequency)

    def at(self, hypothesis: WithDiscrepancy, eta: np.ndarray) -> float:
        """Log p(y, η)."""
        return float(_value(jnp.asarray(eta), self.arrays(hypothesis), self.kernel))

    def explained(self, hypothesis: WithDiscrepancy, eta: np.ndarray) -> float:
        """‖E f‖² in the metric of R⁻¹ at η, f by its posterior mean: |Ψ E w|²."""
        return float(_explained(jnp.asarray(eta), self.arrays(hypothesis), self.kernel))

    def integrate(
        self, hypothesis: WithDiscrepancy, start: np.ndarray | None = None, draws: int = IMPORTANCE_DRAWS, seed: int = 0
    ) -> Integrated:
        """Evidence by Laplace's approximation and by importance sampling from a Student-t around the mode.

        Args:
            hypothesis: What to integrate.
            start: η to climb from; the prior's middle by default.
            draws: Draws of the importance sampler; 0: Laplace only.
            seed: Its seed.
        """
        arrays = self.arrays(hypothesis)

        def descend(eta: np.ndarray) -> tuple[float, np.ndarray]:
            value, slope = _value_and_slope(jnp.asarray(eta), arrays, self.kernel)
            return -float(value), -np.asarray(slope)

        best = _minimum(descend, self.prior.start if start is None else start)
        mode, p = best.x, len(best.x)
        covariance = _covariance(descend, mode)
        laplace = -best.fun + 0.5 * (p * math.log(2 * math.pi) + np.linalg.slogdet(covariance)[1])
        if draws == 0:
            return Integrated(laplace, math.nan, laplace, mode, covariance)
        _, log_ratio = self.proposed(hypothesis, mode, covariance, draws, seed)
        top = np.max(log_ratio)
        ratio = np.exp(log_ratio - top)
        se = float(np.std(ratio) / (np.mean(ratio) * math.sqrt(draws)))
        return Integrated(float(top + np.log(np.mean(ratio))), se, laplace, mode, covariance)

    def proposed(
        self, hypothesis: WithDiscrepancy, mode: np.ndarray, covariance: np.ndarray, draws: int = IMPORTANCE_DRAWS,
        seed: int = 0,
    ) -> tuple[Float[np.ndarray, "n_draw n_eta"], Float[np.ndarray, " n_draw"]]:  # fmt: skip
        """η drawn from a Student-t around the mode, and the logarithms of what each weighs for its posterior.

        Args:
            hypothesis: Whose posterior.
            mode: Of it.
            covariance: Of the Laplace approximation.
            draws: How many.
            seed: Their seed.
        """
        rng, root, p = np.random.default_rng(seed), np.linalg.cholesky(covariance), len(mode)
        z = rng.standard_normal((draws, p)) / np.sqrt(rng.chisquare(DEGREES, (draws, 1)) / DEGREES)
        eta = mode + PROPOSAL_SPREAD * z @ root.T
        log_det = 2 * np.sum(np.log(np.diag(root)))
        log_proposal = _log_student(z, DEGREES) - 0.5 * log_det - p * math.log(PROPOSAL_SPREAD)
        log_ratio = self.values(hypothesis, eta) - log_proposal
        return eta, np.where(np.isfinite(log_ratio), log_ratio, -np.inf)

    def values(self, hypothesis: WithDiscrepancy, etas: Float[np.ndarray, "n_point n_eta"]) -> np.ndarray:
        """Log p(y, η) at several points."""
        return np.asarray(_values(jnp.asarray(etas), self.arrays(hypothesis), self.kernel))

    def weights(
        self, hypothesis: WithDiscrepancy, eta: np.ndarray
    ) -> tuple[Float[np.ndarray, " n_basis"], Float[np.ndarray, "n_basis n_basis"]]:
        """Posterior of the features' weights at η: mean, and W with WᵀW their covariance.

        w = √S z, z ~ N(A⁻¹ s r/σ, A⁻¹), A = I + s G s, s = √S/σ, G and r from the hypothesis.
        """
        sigma, amplitude, length_scale = self.prior.unpack(jnp.asarray(eta))
        log_S = log_spectral_density(KERNELS[self.kernel], self.frequency, amplitude, length_scale)
        root_S = np.exp(0.5 * np.asarray(log_S))
        s = root_S / float(sigma)
        L = np.linalg.cholesky(np.eye(len(s)) + s[:, None] * hypothesis.gram * s)
        z = scipy.linalg.cho_solve((L, True), s * hypothesis.product / float(sigma))
        return root_S * z, scipy.linalg.solve_triangular(L, np.diag(root_S), lower=True)

    def bridged(self, hypothesis: WithDiscrepancy, seed: int) -> Bridged:
        """Evidence from NUTS draws of η, by bridge sampling."""
        log_density = partial(log_joint, kernel=self.kernel)
        return bridge(log_density, self.arrays(hypothesis), len(self.prior.start), seed=seed)

    def arrays(self, hypothesis: WithDiscrepancy) -> dict[str, Any]:
        """The argument of `log_joint`."""
        # Padded, so that hypotheses with fewer columns or patterns share one compiled program.
        n_pattern, n_column = hypothesis.eigenvalues.shape
        rows, columns = _padded(n_pattern, 8), _padded(n_column, 4)
        lam, b = np.zeros((2, rows, columns))
        lam[:n_pattern, :n_column], b[:n_pattern, :n_column] = hypothesis.eigenvalues, hypothesis.loading
        log_prior = np.full(rows, -np.inf)
        log_prior[:n_pattern] = hypothesis.log_prior
        return {
            "eigenvalues": jnp.asarray(lam),
            "loading": jnp.asarray(b),
            "log_prior": jnp.asarray(log_prior),
            "square": jnp.asarray(hypothesis.square),
            "n_obs": jnp.asarray(float(hypothesis.n_obs)),
            "gram": jnp.asarray(hypothesis.gram),
            "product": jnp.asarray(hypothesis.product),
            "frequency": self.frequency,
            "prior": self.prior,
        }


def log_joint(eta: Array, a: dict[str, Any], kernel: str) -> Array:
    """Log p(y, η), η packed as `HyperPrior` says, prior included, of what `Evaluator.arrays` holds."""
    prior: HyperPrior = a["prior"]
    hyper = prior.unpack(eta)
    s2 = jnp.square(hyper.sigma)
    # Patterns of the parametric part, as in Spectrum.log_density
    rest = a["square"] - jnp.sum(jnp.square(a["loading"]) / (s2 + a["eigenvalues"]), axis=-1)
    log_det = jnp.sum(jnp.log1p(a["eigenvalues"] / s2), axis=-1)
    patterns = logsumexp(a["log_prior"] - 0.5 * (log_det + rest / s2))
    log_det_f, projected, z = _solved(hyper, a, kernel)
    # gain = ½ (uᵀu − log|I + s G s|), u = L⁻¹ s r/σ
    gain = 0.5 * (jnp.sum(projected * z) - log_det_f)
    return patterns - 0.5 * a["n_obs"] * jnp.log(2 * math.pi * s2) + gain + prior.log_density(eta)


def _solved(hyper: Hyperparameters, a: dict[str, Any], kernel: str) -> tuple[Array, Array, Array]:
    log_S = log_spectral_density(KERNELS[kernel], a["frequency"], hyper.amplitude, hyper.length_scale)
    log_s = 0.5 * log_S - jnp.log(hyper.sigma)
    projected = jnp.exp(log_s) * a["product"] / hyper.sigma
    log_det, Z, _ = scaled_solve(a["gram"], log_s, projected[:, None])
    return log_det, projected, Z[:, 0]


@partial(compiled, often=True, static_argnames="kernel")
def _explained(eta: Array, a: dict[str, Any], kernel: str) -> Array:
    hyper = a["prior"].unpack(eta)
    log_S = log_spectral_density(KERNELS[kernel], a["frequency"], hyper.amplitude, hyper.length_scale)
    weight = jnp.exp(0.5 * log_S) * _solved(hyper, a, kernel)[2]
    return weight @ a["gram"] @ weight


_value = compiled(log_joint, often=True, static_argnames="kernel")
_value_and_slope = compiled(jax.value_and_grad(log_joint), often=True, static_argnames="kernel")


@partial(compiled, often=True, static_argnames="kernel")
def _values(etas: Array, a: dict[str, Any], kernel: str) -> Array:
    return jax.lax.map(lambda eta: log_joint(eta, a, kernel), etas)


def _minimum(descend: Callable, start: np.ndarray) -> scipy.optimize.OptimizeResult:
    bounds = [(-16.0, 3.0), (-16.0, 5.0), *[(-4.0, 4.0)] * (len(start) - 2)]
    return scipy.optimize.minimize(descend, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 100})


def _covariance(descend: Callable, mode: np.ndarray, step: float = 1e-3) -> np.ndarray:
    """Inverse Hessian by central differences of the gradient; the variance along any direction is 10 at most."""
    shifts = step * np.eye(len(mode))
    hessian = np.stack([(descend(mode + h)[1] - descend(mode - h)[1]) / (2 * step) for h in shifts])
    values, vectors = np.linalg.eigh(0.5 * (hessian + hessian.T))
    return (vectors / np.maximum(values, 0.1)) @ vectors.T


def _log_student(z: np.ndarray, nu: float) -> np.ndarray:
    p = z.shape[1]
    constant = math.lgamma(0.5 * (nu + p)) - math.lgamma(0.5 * nu) - 0.5 * p * math.log(nu * math.pi)
    return constant - 0.5 * (nu + p) * np.log1p(np.sum(z**2, axis=1) / nu)


def _padded(n: int, multiple: int) -> int:
    return max(multiple, -(-n // multiple) * multiple)
