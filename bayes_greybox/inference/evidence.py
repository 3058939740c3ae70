"""Evidence p(y | hypothesis) of competing sets of terms on one table of rows, with and without a discrepancy f.

Every hypothesis is y = X β + f + ε with β ~ N(0, D), f ~ GP(0, k⊥), ε ~ N(0, σ² R), and f orthogonal to the columns X
of that hypothesis in the metric of R⁻¹. Rows in the span of X and rows orthogonal to it then never mix:

    log p(y | η) = log N(y; 0, X D Xᵀ + σ² R) + gain(η),   gain = log N(y⊥; 0, Ψ S Ψᵀ + σ²) − log N(y⊥; 0, σ²),

with y⊥ and Ψ the target and the features less their projections on X. The first part needs one eigendecomposition a
hypothesis and is integrated over σ on a grid; the second is integrated over η by importance sampling around its mode.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import scipy.optimize
from jax.scipy.special import logsumexp
from jaxtyping import Array, Float

from bayes_greybox.model.collapsed import scaled_solve
from bayes_greybox.model.kernels import KERNELS, log_spectral_density
from bayes_greybox.physics.expressions import namespace

SIGMA_NODES = 33
"""Nodes of the grid over log σ; the integrand is within 1e-6 of its integral from about 20 on."""

SIGMA_SPAN = 7.0
"""Half-width of that grid in posterior standard deviations of log σ."""

IMPORTANCE_DRAWS = 200
"""Draws of the importance sampler over η."""

DEGREES = 6.0
"""Degrees of freedom of its Student-t proposal, whose tails are heavier than those of any posterior of η here."""

PROPOSAL_SPREAD = 1.2
"""Width of the proposal over that of the Laplace approximation."""


class NoisePrior(NamedTuple):
    """σ² = floor² + s², s ~ HalfNormal(scale), in scaled units."""

    floor: float
    scale: float


class DiscrepancyPrior(NamedTuple):
    """amplitude ~ HalfNormal(amplitude), ℓ ~ LogNormal(log length_scale, spread); names and features of the kernel."""

    amplitude: float
    length_scale: float
    spread: float
    kernel: str
    frequency: Float[np.ndarray, "n_basis n_var"]


@dataclass(frozen=True)
class Spectrum:
    """One hypothesis, or a batch of them, in the eigenbasis of D^½ XᵀR⁻¹X D^½.

    Attributes:
        eigenvalues: λ [..., n_column].
        loading: b = Uᵀ D^½ XᵀR⁻¹y [..., n_column].
        back: D^½ U, which maps eigen-coefficients to β [..., n_column, n_column].
        square: yᵀR⁻¹y.
        n_obs: Number of observations.
    """

    eigenvalues: Float[np.ndarray, "*batch n_column"]
    loading: Float[np.ndarray, "*batch n_column"]
    back: Float[np.ndarray, "*batch n_column n_column"]
    square: float
    n_obs: float | int

    @classmethod
    def of(
        cls,
        gram: Float[np.ndarray, "... n_column n_column"],
        product: Float[np.ndarray, "... n_column"],
        square: float,
        n_obs: float | int,
        sd: Float[np.ndarray, "... n_column"],
    ) -> "Spectrum":
        """Decompose; a column with sd = 0 is out of its hypothesis.

        Args:
            gram: XᵀR⁻¹X.
            product: XᵀR⁻¹y.
            square: yᵀR⁻¹y.
            n_obs: Number of observations.
            sd: Prior standard deviations, the root of diag D.
        """
        values, vectors = np.linalg.eigh(sd[..., :, None] * gram * sd[..., None, :])
        back = sd[..., :, None] * vectors
        loading = np.einsum("...ij,...i->...j", back, product)
        return cls(np.maximum(values, 0.0), loading, back, square, n_obs)

    def log_density(self, sigma: np.ndarray) -> np.ndarray:
        """Log p(y | σ), f = 0; σ of shape [n_node], or [..., n_node] with the shape of the batch: [..., n_node].

        −½ (Σ log(1 + λ/σ²) + (yᵀR⁻¹y − Σ b²/(σ² + λ))/σ² + n log 2πσ²), less ½ log|R|.
        """
        s2 = np.asarray(sigma)[..., None] ** 2
        lam, b = self.eigenvalues[..., None, :], self.loading[..., None, :]
        log_det = np.sum(np.log1p(lam / s2), axis=-1) + self.n_obs * np.log(2 * math.pi * s2[..., 0])
        rest = np.maximum(self.square - np.sum(b**2 / (s2 + lam), axis=-1), 0.0)
        return -0.5 * (log_det + rest / s2[..., 0])


class Marginal(NamedTuple):
    """A hypothesis without f, σ integrated out: log evidence, and the grid with its posterior weights.

    Attributes:
        log_evidence: log p(y), up to −½ log|R|, [*batch].
        sigma: Nodes of σ [*batch, n_node].
        weight: Posterior weights of the nodes, each row sums to one [*batch, n_node].
    """

    log_evidence: np.ndarray
    sigma: np.ndarray
    weight: np.ndarray


def marginal(spectrum: Spectrum, noise: NoisePrior) -> Marginal:
    """Integrate σ out of log p(y | σ) on a grid around the mode of each hypothesis of the batch."""

    def objective(t: np.ndarray) -> np.ndarray:
        return spectrum.log_density(_sigma(t, noise)) + log_half_normal(t, noise.scale)

    # The mode of log s: a coarse grid, then shrinking grids around the best node.
    low, high = math.log(max(noise.floor, 1e-6)) - 2.0, math.log(4.0 * noise.scale)
    width, centre = 0.5 * (high - low), np.full(spectrum.eigenvalues.shape[:-1], 0.5 * (high + low))
    while width > 0.3 / math.sqrt(2 * spectrum.n_obs):
        nodes = centre[..., None] + np.linspace(-width, width, 17)
        centre = np.take_along_axis(nodes, np.argmax(objective(nodes), axis=-1)[..., None], axis=-1)[..., 0]
        width *= 0.2
    step = 1.0 / math.sqrt(2 * spectrum.n_obs)
    below, at, above = np.moveaxis(objective(centre[..., None] + step * np.array([-1.0, 0.0, 1.0])), -1, 0)
    # Below the floor the density in log s falls only as the prior does: no narrower than that, no wider than 1.
    spread = np.clip(step / np.sqrt(np.maximum(2 * at - below - above, 1e-12)), step, 1.0)
    nodes = centre[..., None] + SIGMA_SPAN * spread[..., None] * np.linspace(-1, 1, SIGMA_NODES)
    values = objective(nodes)
    total = np.logaddexp.reduce(values, axis=-1)
    log_step = np.log(2 * SIGMA_SPAN * spread / (SIGMA_NODES - 1))
    return Marginal(total + log_step, _sigma(nodes, noise), np.exp(values - total[..., None]))


def coefficients(spectrum: Spectrum, posterior: Marginal) -> tuple[np.ndarray, np.ndarray]:
    """Posterior mean [..., n_column] and covariance [..., n_column, n_column] of β without f, σ integrated out.

    Given σ, β ~ N(D^½U b/(σ² + λ), σ² D^½U diag 1/(σ² + λ) UᵀD^½); the mean hardly moves with σ, so the covariance is
    the average of the conditional ones plus that of the conditional means.
    """
    s2 = posterior.sigma[..., None] ** 2
    lam, b = spectrum.eigenvalues[..., None, :], spectrum.loading[..., None, :]
    weight = posterior.weight[..., None]
    given = b / (s2 + lam)
    centre = np.sum(weight * given, axis=-2)
    within = np.sum(weight * s2 / (s2 + lam), axis=-2)
    away = given - centre[..., None, :]
    between = np.einsum("...n,...ni,...nj->...ij", posterior.weight, away, away)
    inner = between + np.eye(within.shape[-1]) * within[..., None, :]
    mean = np.einsum("...ij,...j->...i", spectrum.back, centre)
    return mean, np.einsum("...ij,...jk,...lk->...il", spectrum.back, inner, spectrum.back)


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
        noise: Prior of σ.
        discrepancy: Prior of f.
    """

    def __init__(self, noise: NoisePrior, discrepancy: DiscrepancyPrior):
        self.prior = jnp.asarray([*noise, *discrepancy[:3]])
        self.frequency = jnp.asarray(discrepancy.frequency)
        self.kernel = discrepancy.kernel
        n_var = self.frequency.shape[1]
        self.start = np.concatenate(
            [[math.log(0.5), math.log(0.5)], np.full(n_var, math.log(discrepancy.length_scale))]
        )

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

        best = _minimum(descend, self.start if start is None else start)
        mode, p = best.x, len(best.x)
        covariance = _covariance(descend, mode)
        root = np.linalg.cholesky(covariance)
        log_det = 2 * np.sum(np.log(np.diag(root)))
        laplace = -best.fun + 0.5 * (p * math.log(2 * math.pi) + log_det)
        if draws == 0:
            return Integrated(laplace, math.nan, laplace, mode, covariance)
        rng = np.random.default_rng(seed)
        z = rng.standard_normal((draws, p)) / np.sqrt(rng.chisquare(DEGREES, (draws, 1)) / DEGREES)
        eta = mode + PROPOSAL_SPREAD * z @ root.T
        log_proposal = _log_student(z, DEGREES) - 0.5 * log_det - p * math.log(PROPOSAL_SPREAD)
        log_ratio = np.asarray(_values(jnp.asarray(eta), arrays, self.kernel)) - log_proposal
        log_ratio = np.where(np.isfinite(log_ratio), log_ratio, -np.inf)
        top = np.max(log_ratio)
        ratio = np.exp(log_ratio - top)
        se = float(np.std(ratio) / (np.mean(ratio) * math.sqrt(draws)))
        return Integrated(float(top + np.log(np.mean(ratio))), se, laplace, mode, covariance)

    def values(self, hypothesis: WithDiscrepancy, etas: Float[np.ndarray, "n_point n_eta"]) -> np.ndarray:
        """Log p(y, η) at several points."""
        return np.asarray(_values(jnp.asarray(etas), self.arrays(hypothesis), self.kernel))

    def arrays(self, hypothesis: WithDiscrepancy) -> dict[str, Array]:
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


def weights(
    hypothesis: WithDiscrepancy, eta: np.ndarray, noise: NoisePrior, discrepancy: DiscrepancyPrior
) -> tuple[Float[np.ndarray, " n_basis"], Float[np.ndarray, "n_basis n_basis"]]:
    """Posterior of the features' weights at η: mean, and W with WᵀW their covariance.

    w = √S z, z ~ N(A⁻¹ s r/σ, A⁻¹), A = I + s G s, s = √S/σ, G and r from the hypothesis.
    """
    s2 = noise.floor**2 + math.exp(2 * eta[0])
    log_S = log_spectral_density(
        KERNELS[discrepancy.kernel], jnp.asarray(discrepancy.frequency), jnp.exp(eta[1]), jnp.exp(jnp.asarray(eta[2:]))
    )
    root_S = np.exp(0.5 * np.asarray(log_S))
    s = root_S / math.sqrt(s2)
    L = np.linalg.cholesky(np.eye(len(s)) + s[:, None] * hypothesis.gram * s)
    z = scipy.linalg.cho_solve((L, True), s * hypothesis.product / math.sqrt(s2))
    return root_S * z, scipy.linalg.solve_triangular(L, np.diag(root_S), lower=True)


def log_joint(eta: Array, a: dict[str, Array], kernel: str) -> Array:
    """Log p(y, η), η = (log s, log amplitude, log ℓ), prior included, of what `Evaluator.arrays` holds."""
    floor, noise_scale, amplitude_scale, length, spread = a["prior"]
    log_s, log_amplitude, log_length = eta[0], eta[1], eta[2:]
    s2 = floor**2 + jnp.exp(2 * log_s)
    # Patterns of the parametric part, as in Spectrum.log_density
    rest = a["square"] - jnp.sum(a["loading"] ** 2 / (s2 + a["eigenvalues"]), axis=-1)
    log_det = jnp.sum(jnp.log1p(a["eigenvalues"] / s2), axis=-1)
    patterns = logsumexp(a["log_prior"] - 0.5 * (log_det + rest / s2))
    log_det_f, projected, z = _solved(eta, a, kernel, s2)
    # gain = ½ (uᵀu − log|I + s G s|), u = L⁻¹ s r/σ
    gain = 0.5 * (jnp.sum(projected * z) - log_det_f)
    log_prior = (
        log_half_normal(log_s, noise_scale)
        + log_half_normal(log_amplitude, amplitude_scale)
        + jnp.sum(-0.5 * ((log_length - jnp.log(length)) / spread) ** 2 - jnp.log(spread * math.sqrt(2 * math.pi)))
    )
    return patterns - 0.5 * a["n_obs"] * jnp.log(2 * math.pi * s2) + gain + log_prior


def _solved(eta: Array, a: dict[str, Array], kernel: str, s2: Array) -> tuple[Array, Array, Array]:
    log_S = log_spectral_density(KERNELS[kernel], a["frequency"], jnp.exp(eta[1]), jnp.exp(eta[2:]))
    log_s = 0.5 * (log_S - jnp.log(s2))
    projected = jnp.exp(log_s) * a["product"] / jnp.sqrt(s2)
    log_det, Z, _ = scaled_solve(a["gram"], log_s, projected[:, None])
    return log_det, projected, Z[:, 0]


@partial(jax.jit, static_argnames="kernel")
def _explained(eta: Array, a: dict[str, Array], kernel: str) -> Array:
    s2 = a["prior"][0] ** 2 + jnp.exp(2 * eta[0])
    log_S = log_spectral_density(KERNELS[kernel], a["frequency"], jnp.exp(eta[1]), jnp.exp(eta[2:]))
    weight = jnp.exp(0.5 * log_S) * _solved(eta, a, kernel, s2)[2]
    return weight @ a["gram"] @ weight


_value = jax.jit(log_joint, static_argnames="kernel")
_value_and_slope = jax.jit(jax.value_and_grad(log_joint), static_argnames="kernel")


@partial(jax.jit, static_argnames="kernel")
def _values(etas: Array, a: dict[str, Array], kernel: str) -> Array:
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


def _sigma(log_s: np.ndarray, noise: NoisePrior) -> np.ndarray:
    return np.sqrt(noise.floor**2 + np.exp(2 * log_s))


def log_half_normal(log_x: Array | np.ndarray, scale: Array | float) -> Array | np.ndarray:
    """Density of log x for x ~ HalfNormal(scale)."""
    xp = namespace([log_x, scale])
    return 0.5 * math.log(2 / math.pi) - xp.log(scale) - 0.5 * (xp.exp(log_x) / scale) ** 2 + log_x


def _log_student(z: np.ndarray, nu: float) -> np.ndarray:
    p = z.shape[1]
    constant = math.lgamma(0.5 * (nu + p)) - math.lgamma(0.5 * nu) - 0.5 * p * math.log(nu * math.pi)
    return constant - 0.5 * (nu + p) * np.log1p(np.sum(z**2, axis=1) / nu)


def _padded(n: int, multiple: int) -> int:
    return max(multiple, -(-n // multiple) * multiple)
