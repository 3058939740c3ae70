"""The NumPyro program of the exact trajectory posterior: θ, starts, noise and f are sites, samples are on the path."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jaxtyping import Array, Bool, Float, Int
from numpyro.handlers import condition, scope
from scipy.stats import lognorm, norm

from bayes_greybox.physics.formula.expressions import namespace

from .coefficient import CoefficientPriors
from .design import Design
from .priors import Scales
from .sampling_program import SamplingProgram
from .sites import EquationSites, site

PREDICTED_SITE, START_SITE, SENSOR_SITE = "predicted", "start", "sensor_sigma"
"""Sites: rows without noise, in the sensors' units; states at the starts of the segments; each sensor's own noise."""


@dataclass(frozen=True)
class GivenTerms:
    """The pattern of terms that are in; of bounded ones the number, and if there is a least and a largest value."""

    active: tuple[bool, ...]
    bounded: tuple[tuple[int, bool, bool], ...]

    @classmethod
    def of(cls, active: Bool[np.ndarray, " n_term"], coefficients: CoefficientPriors) -> "GivenTerms":
        """Return the pattern of active terms under priors of coefficients."""
        limits = np.isfinite(np.stack([coefficients.lower, coefficients.upper], axis=-1)).tolist()
        return cls(tuple(map(bool, active)), tuple((j, *limits[j]) for j in coefficients.bounded if active[j]))

    @property
    def free(self) -> Int[np.ndarray, " n_free"]:
        """Terms that are in without bounds."""
        bounded = {j for j, *_ in self.bounded}
        return np.array([j for j in np.flatnonzero(self.active) if j not in bounded], int)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class ExactLikelihood:
    """Samples of sensors on exact paths; a pytree, so that what is compiled for one serves others of the same shapes.

    Attributes:
        predict: Function of `along`, scaled θ, scaled weights of f and the starts of the segments that returns the
            rows, the sensors' units, in which `measured` is too.
        sensor: Number of the sensor of each row.
        whiten: W₀ with W₀ R₀ W₀ᵀ = I, R₀ over the square of the noise of a typical sensor; of independent rows its
            diagonal. `log_det` is log|R₀|.
        unit: Noise of a typical sensor, in its unit, per scaled σ.
        share: Noise of each sensor over that of a typical one, which R₀ has.
        restated: If true, starts or noise have other priors than in the collapsed model.
        sensor_noise: Median and logarithmic standard deviation of each sensor's own σ; None where they have one σ.
    """

    predict: Callable[[Any, Array, Array, Any], Float[Array, " n_row"]] = field(metadata={"static": True})
    measured: Float[Array | np.ndarray, " n_row"]
    sensor: Int[Array | np.ndarray, " n_row"]
    whiten: Float[Array | np.ndarray, "n_row *n_row"]
    log_det: Float[Array, ""] | float
    unit: Float[Array, ""] | float
    share: Float[Array | np.ndarray, " n_sensor"]
    start_mean: Float[Array | np.ndarray, "n_segment n_state"]
    start_sd: Float[Array | np.ndarray, "n_segment n_state"]
    restated: bool = field(default=False, metadata={"static": True})
    sensor_noise: Float[Array | np.ndarray, "n_sensor 2"] | None = None
    along: Any = None

    @property
    def independent(self) -> bool:
        """True if the noise of each row is independent of the others."""
        return self.whiten.ndim == 1

    def sigma(self, sensors: Any, scaled: Any) -> Any:
        """Return the noise of each row [..., n_row] without its share in R₀, from that of each sensor or scaled σ."""
        if self.sensor_noise is not None:
            return (sensors / self.share)[..., self.sensor]
        return (scaled * self.unit)[..., None] * np.ones(len(self.measured))

    def log_prior(self, drawn: Mapping[str, np.ndarray], names: EquationSites) -> dict[str, np.ndarray]:
        """Return log prior densities [n_chain, n_draw] that the collapsed model has not, from draws by variable."""
        starts = norm.logpdf(drawn[names[START_SITE]], self.start_mean, self.start_sd)
        densities = {names[START_SITE]: starts.sum(axis=(-2, -1))}
        if self.sensor_noise is not None:
            median, spread = self.sensor_noise.T
            densities[names[SENSOR_SITE]] = lognorm.logpdf(drawn[names[SENSOR_SITE]], spread, scale=median).sum(axis=-1)
            # In its place σ has no prior of its own.
            densities[names.noise] = np.zeros(starts.shape[:2])
        return densities

    def whitened(self, change: Any, sigma: Any) -> Any:
        """Return a change of the rows over their noise, W₀ change/σ [..., n_row]."""
        z = change / sigma
        return z * self.whiten if self.independent else z @ self.whiten.T

    def log_density(self, predicted: Any, sigma: Any) -> Any:
        """Return the log density of each row [..., n_row]; of correlated rows that of the innovations instead."""
        xp = namespace([predicted, sigma, self.measured])
        z = self.whitened(self.measured - predicted, sigma)
        log_det = -2 * xp.log(self.whiten) if self.independent else self.log_det / len(self.measured)
        return -0.5 * z**2 - xp.log(sigma) - 0.5 * (log_det + math.log(2 * math.pi))


def exact_model(
    program: SamplingProgram, block: str, design: Design, terms: GivenTerms, likelihood: ExactLikelihood
) -> Callable[[], None]:
    """Return the NumPyro model, of no arguments, given the pattern of terms that are in.

        θ_j | scales as in the collapsed model,   x₀ ~ N(m, diag(s²)),   y ~ N(h(x(·; θ, f, x₀)), σ² R₀)

    Sites are those of the collapsed model and, each with the block's prefix, `theta_free`, `theta_j` for the j-th term
    where it has bounds, `start_unit`, standardised weights `z` of f, and `sensor_sigma` where sensors have their own.
    """
    coefficients, free, active = design.coefficients, terms.free, np.array(terms.active)

    def sigma_of() -> tuple[Array | None, Array]:
        """Scaled σ, where it is not the program's, and that of each sensor."""
        if likelihood.sensor_noise is None:
            return None, jnp.ones(())
        median, spread = likelihood.sensor_noise.T
        sensors = site(SENSOR_SITE, dist.LogNormal(jnp.log(median), spread).to_event(1))
        return jnp.sqrt(jnp.mean(sensors**2)) / likelihood.unit, sensors

    def theta_of(scales: Scales) -> Array:
        mean = coefficients.mean if scales.mean is None else scales.mean
        theta = jnp.zeros(len(active))
        if len(free):
            theta = theta.at[free].set(site("theta_free", dist.Normal(mean[free], scales.sd[free]).to_event(1)))
        for j, below, above in terms.bounded:
            limits: dict[str, Any] = {"low": coefficients.lower[j]} if below else {}
            limits |= {"high": coefficients.upper[j]} if above else {}
            theta = theta.at[j].set(site(f"theta_{j}", dist.TruncatedNormal(mean[j], scales.sd[j], **limits)))
        return theta

    def model() -> None:
        with scope(prefix=block, divider="_"):
            scaled, sensors = sigma_of()
            hyper = program.hyper_prior(design.noise_floor, design.n_var).sample(scaled)
            with condition(data={"gamma": jnp.asarray(active, int)}):
                scales = program.scales(design, hyper.sigma)
            if scales.log_odds is not None:
                numpyro.factor("pattern", -jnp.sum(jnp.logaddexp(0.0, jnp.where(active, -1.0, 1.0) * scales.log_odds)))
            theta, weight = theta_of(scales), design.sampled_weights(hyper)
            shape = likelihood.start_mean.shape
            unit = site("start_unit", dist.Normal(0.0, 1.0).expand(shape).to_event(2))
            start = likelihood.start_mean + likelihood.start_sd * unit
            predicted = likelihood.predict(likelihood.along, theta, weight, start)
            density = jnp.sum(likelihood.log_density(predicted, likelihood.sigma(sensors, hyper.sigma)))
            # A path that leaves all bounds has no probability.
            numpyro.factor("samples", jnp.where(jnp.isfinite(density), density, -jnp.inf))
            derived = {"theta": theta, "theta_sd": scales.sd * active, START_SITE: start, PREDICTED_SITE: predicted}
            for name, value in derived.items():
                numpyro.deterministic(name, value)

    return model
