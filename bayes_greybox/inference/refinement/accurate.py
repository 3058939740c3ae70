"""Draws of the exact posterior on steps that are fine enough, which is found before and checked after."""

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
from .programs import TOGETHER, ExactPrograms, Known

ACCURATE = 1e-6
"""Largest error of a path at the samples, over the size of the state and of the sample."""

MOVED = 0.01
"""Largest error e = W δ/σ of a path at all samples together, root of the sum of squares, in units of their noise.

Where rows S are nearly linear, samples that are off by e move the posterior's mean by A⁻¹Sᵀe, A = SᵀS + P, in no
direction by more than ‖A^-½Sᵀe‖ ≤ ‖e‖ of its standard deviations; the log likelihood moves by zᵀe − ‖e‖²/2, of which
‖e‖ is the standard deviation over the noise z. States that no sensor shows count by what they do to samples.
"""

MARGIN = 0.1
"""Share of these that errors may be at the draws of the linear rows, from which the exact ones are told."""

USUAL = 0.9
"""Share of these draws at which it must be so: some have no path to speak of."""

RIDGE = 1e-6
"""Share of its variance by which a coordinate is known apart from the others, at least."""

FEWEST = 3
"""Draws per coordinate below which their covariance is that of its diagonal alone."""

PATH_ERROR = "path_error"
"""What the statistics of a sampler have besides: the error of each draw's path as `MOVED` has it."""

ESTIMATE, FITTED, EXACT = "at the fit's own estimate", "at more than a tenth of the fit's draws", "at exact draws"
"""Where paths were found not to be accurate, in words; the second is beyond `USUAL`."""


class Sampled(NamedTuple):
    """What a method of integration has led to.

    Attributes:
        drawn: Sites and what follows from them, each [n_chain, n_draw, ...]; empty where paths are not accurate.
        stats: Of the sampler.
        error: Largest error of a path over what it may be, infinite where there is no path.
        where: It was found, in words.
    """

    drawn: dict[str, np.ndarray]
    stats: dict[str, np.ndarray]
    error: float
    where: str


class Errors(NamedTuple):
    """Errors of the paths of draws; infinite where there is a path on finer steps alone, NaN where there is none.

    Attributes:
        of_size: As `ACCURATE` has them.
        of_noise: As `MOVED` has them.
    """

    of_size: Float[np.ndarray, " n"]
    of_noise: Float[np.ndarray, " n"]

    @property
    def share(self) -> Float[np.ndarray, " n"]:
        """Of what they may be, the larger one."""
        return np.maximum(self.of_size / ACCURATE, self.of_noise / MOVED)


class Paths(NamedTuple):
    """Samples on paths at given points, and how accurate they are.

    Attributes:
        method: Of integration.
        course: Segments and rows.
        programs: Compiled.
        own: What sites are called.
    """

    method: Method
    course: Course
    programs: ExactPrograms
    own: EquationSites

    def sampled(
        self, known: Known, first: FirstDraws, sampling: Sampling, progress: bool, checkpoint: Checkpoint | None = None
    ) -> Sampled:
        """Sample on steps that are fine enough.

        Args:
            known: The model's argument on the coarsest grid.
            first: Draws of the linear rows.
            sampling: Settings.
            progress: Whether to show a progress bar.
            checkpoint: Keeps the chains of each time that they are run.
        """
        points = self.programs.place(first.sites, known)
        points = points[np.all(np.isfinite(points), axis=1)]
        mean, root = _coordinates(points, first.distinct)
        some = points[np.linspace(0, len(points) - 1, TOGETHER - 1).astype(int)]
        fine, error, where = self._fine(known, np.concatenate([mean[None], some]))
        while fine is not None:
            argument = jnp.asarray(mean), jnp.asarray(root), fine
            chains = self.programs.chains.run(
                argument, draws=sampling.draws, chains=sampling.chains, key=jax.random.PRNGKey(sampling.seed),
                progress=progress, files=None if checkpoint is None else checkpoint.next_run(),
            )  # fmt: skip
            eta = chains.samples[VECTOR]
            flat = mean + eta.reshape(-1, len(mean)) @ root.T
            told = self.programs.tell(flat, fine)
            errors = self._errors(told, flat, fine)
            error, where = _worst(errors.share), EXACT
            if error <= 1:
                drawn = {name: value.reshape(*eta.shape[:2], *value.shape[1:]) for name, value in told.items()}
                return Sampled(drawn, chains.stats | {PATH_ERROR: errors.of_noise.reshape(eta.shape[:2])}, error, where)
            fine = self._finer(fine)
        return Sampled({}, {}, error, where)

    def _fine(self, known: Known, points: Float[np.ndarray, "n u"]) -> tuple[Known | None, float, str]:
        """The coarsest grid that is fine enough at the mean, which comes first, and usually; and the last error."""
        fine: Known | None = known
        error, where = math.inf, ESTIMATE
        while fine is not None:
            share = self._errors(self.programs.tell(points, fine), points, fine).share
            error, where = _worst(share[:1]), ESTIMATE
            if math.isfinite(error):
                # Some draws of the linear rows have no path at all.
                usual = float(np.nanquantile(share, USUAL, method="higher"))
                error, where = max((error, where), (usual, FITTED))
            following = self._finer(fine)
            if error <= (1.0 if following is None else MARGIN):
                return fine, error, where
            fine = following
        return None, error, where

    def _errors(self, told: Mapping[str, np.ndarray], points: Float[np.ndarray, "n u"], known: Known) -> Errors:
        likelihood, predicted = known.likelihood, self.own[PREDICTED_SITE]
        beyond = self.method.beyond(likelihood.along.grid)
        finer = self.programs.tell(points, known.on(beyond))[predicted]
        sigma = likelihood.sigma(told.get(self.own[SENSOR_SITE]), told[self.own.sigma])
        with np.errstate(invalid="ignore", over="ignore"):
            e = np.asarray(likelihood.whitened(told[predicted] - finer, sigma))
            of_noise = np.sqrt(np.sum(e**2, axis=1))
        of_size = self.course.error(told[predicted], finer)
        # Where there is no path, both say so alike.
        return Errors(of_size, np.where(np.isfinite(of_size), of_noise, of_size))

    def _finer(self, known: Known) -> Known | None:
        grid = self.method.finer(known.likelihood.along.grid)
        return None if grid is None else known.on(grid)


def _worst(errors: Float[np.ndarray, " n"]) -> float:
    return float(np.max(np.where(np.isnan(errors), math.inf, errors)))


def _coordinates(
    points: Float[np.ndarray, "n_draw u"], distinct: int
) -> tuple[Float[np.ndarray, " u"], Float[np.ndarray, "u u"]]:
    """M and L."""
    mean, sd = points.mean(axis=0), points.std(axis=0)
    sd = np.where(sd > 0, sd, 1.0)
    if distinct <= FEWEST * len(mean):
        return mean, np.diag(sd)
    correlation = np.cov(((points - mean) / sd).T, ddof=0).reshape(len(mean), -1)
    # What no draw tells has no spread among them.
    np.fill_diagonal(correlation, 1.0)
    return mean, sd[:, None] * np.linalg.cholesky(correlation + RIDGE * np.eye(len(mean)))
