"""Draws of the exact posterior on steps that are fine enough, as checked before and after sampling."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_greybox.inference.checkpoint import Checkpoint
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.exact_program import PREDICTED_SITE, SENSOR_SITE
from bayes_greybox.model.sites import VECTOR, EquationSites

from .exact_paths import Course
from .linear_start import FirstDraws
from .methods import Method
from .programs import PATHS_TOGETHER, Argument, ExactPrograms

ACCURATE = 1e-6
"""Largest error of a path at the samples, over the size of the state and of the sample."""

MOVED = 0.01
"""Largest error e = W δ/σ of a path at all samples together, root of the sum of squares, in units of their noise.

Where rows S are nearly linear, samples that are off by e move the posterior's mean by A⁻¹Sᵀe, A = SᵀS + P, in no
direction by more than ‖A^-½Sᵀe‖ ≤ ‖e‖ of its standard deviations; the log likelihood moves by zᵀe − ‖e‖²/2, of which
‖e‖ is the standard deviation over the noise z. States that no sensor shows count by their effect on samples.
"""

ERROR_MARGIN, USUAL_SHARE = 0.1, 0.9
"""Share of these limits that errors may reach at draws of the linear rows, and share of these draws that must keep it:
some have no path at all."""

CORRELATION_RIDGE, DRAWS_PER_COORDINATE = 1e-6, 3
"""Least share of the variance of a coordinate that the others do not explain; draws per coordinate below which only
the diagonal of their covariance is used."""

PATH_ERROR = "path_error"
"""Further statistic of the sampler: the error of each draw's path, in the units of `MOVED`."""

AT_ESTIMATE, AT_LINEAR_DRAWS, AT_EXACT_DRAWS = (
    "at the fit's own estimate", "at more than a tenth of the fit's draws", "at exact draws"
)  # fmt: skip
"""Places where paths were not accurate, in words; the second means that `USUAL_SHARE` was missed."""


class Sampled(NamedTuple):
    """Sites, deterministics and statistics, [n_chain, n_draw, ...], sampled with one integration method.

    There are none if paths are not accurate: then the largest error over its limit, infinite for a missing path, and
    its place in words tell why.
    """

    drawn: dict[str, np.ndarray]
    stats: dict[str, np.ndarray]
    error: float
    where: str


class Paths(NamedTuple):
    """Samples on paths at given points, and how accurate they are; `own` are the names of the sites."""

    method: Method
    course: Course
    programs: ExactPrograms
    own: EquationSites

    def sampled(
        self, coarsest: Argument, first: FirstDraws, sampling: Sampling, progress: bool,
        checkpoint: Checkpoint | None = None,
    ) -> Sampled:  # fmt: skip
        """Sample on steps that are fine enough, from the model's argument on the coarsest grid and first draws."""
        points = self.programs.place(first.sites, coarsest)
        points = points[np.all(np.isfinite(points), axis=1)]
        mean, root = _coordinates(points, first.distinct)
        some = points[np.linspace(0, len(points) - 1, PATHS_TOGETHER - 1).astype(int)]
        fine, error, where = self._fine(coarsest, np.concatenate([mean[None], some]))
        while fine is not None:
            chains = self.programs.chains.run(
                (jnp.asarray(mean), jnp.asarray(root), fine), draws=sampling.draws, chains=sampling.chains,
                key=jax.random.PRNGKey(sampling.seed), progress=progress,
                files=None if checkpoint is None else checkpoint.next_run(),
            )  # fmt: skip
            eta = chains.samples[VECTOR]
            flat = mean + eta.reshape(-1, len(mean)) @ root.T
            values = self.programs.evaluate(flat, fine)
            share, of_noise = self._errors(values, flat, fine)
            error, where = _worst(share), AT_EXACT_DRAWS
            if error <= 1:
                drawn = {name: value.reshape(*eta.shape[:2], *value.shape[1:]) for name, value in values.items()}
                return Sampled(drawn, chains.stats | {PATH_ERROR: of_noise.reshape(eta.shape[:2])}, error, where)
            fine = self._finer(fine)
        return Sampled({}, {}, error, where)

    def _fine(self, coarsest: Argument, points: Float[np.ndarray, "n u"]) -> tuple[Argument | None, float, str]:
        """Return the coarsest grid that is fine enough at the mean, the first point, and usually; and its error."""
        fine: Argument = coarsest
        while True:
            share, _ = self._errors(self.programs.evaluate(points, fine), points, fine)
            error, where = _worst(share[:1]), AT_ESTIMATE
            if math.isfinite(error):
                # Some draws of the linear rows have no path at all.
                usual = float(np.nanquantile(share, USUAL_SHARE, method="higher"))
                error, where = max((error, where), (usual, AT_LINEAR_DRAWS))
            following = self._finer(fine)
            if error <= (1.0 if following is None else ERROR_MARGIN):
                return fine, error, where
            if following is None:
                return None, error, where
            fine = following

    def _errors(
        self, values: Mapping[str, np.ndarray], points: Float[np.ndarray, "n u"], argument: Argument
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return the errors of the paths of draws over their limits, and in the units of `MOVED`.

        Errors are infinite if a path exists on finer steps only, NaN if none exists.
        """
        likelihood, predicted = argument.likelihood, self.own[PREDICTED_SITE]
        beyond = self.method.beyond(likelihood.along.grid)
        finer = self.programs.evaluate(points, argument.on(beyond))[predicted]
        sigma = likelihood.sigma(values.get(self.own[SENSOR_SITE]), values[self.own.sigma])
        with np.errstate(invalid="ignore", over="ignore"):
            e = np.asarray(likelihood.whitened(values[predicted] - finer, sigma))
            of_noise = np.sqrt(np.sum(e**2, axis=1))
        of_size = self.course.error(values[predicted], finer)
        # Both are infinite or NaN for the same draws.
        of_noise = np.where(np.isfinite(of_size), of_noise, of_size)
        return np.maximum(of_size / ACCURATE, of_noise / MOVED), of_noise

    def _finer(self, argument: Argument) -> Argument | None:
        grid = self.method.finer(argument.likelihood.along.grid)
        return None if grid is None else argument.on(grid)


def _worst(errors: Float[np.ndarray, " n"]) -> float:
    return float(np.max(np.where(np.isnan(errors), math.inf, errors)))


def _coordinates(
    points: Float[np.ndarray, "n_draw u"], distinct: int
) -> tuple[Float[np.ndarray, " u"], Float[np.ndarray, "u u"]]:
    """Return m and L of the coordinates u = m + L η."""
    mean, sd = points.mean(axis=0), points.std(axis=0)
    sd = np.where(sd > 0, sd, 1.0)
    if distinct <= DRAWS_PER_COORDINATE * len(mean):
        return mean, np.diag(sd)
    correlation = np.cov(((points - mean) / sd).T, ddof=0).reshape(len(mean), -1)
    # Coordinates without draws have no spread.
    np.fill_diagonal(correlation, 1.0)
    return mean, sd[:, None] * np.linalg.cholesky(correlation + CORRELATION_RIDGE * np.eye(len(mean)))
