"""Draws of the exact posterior on steps that are fine enough, which is found before and checked after."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.sites import VECTOR

from .exact_paths import Course
from .linear_start import FirstDraws
from .methods import Method
from .programs import TOGETHER, ExactPrograms, Known

ACCURATE = 1e-6
"""Largest error of a path at the samples, over the size of the state and of the sample: below the noise of sensors."""

MARGIN = 0.1
"""Share of it that the error may be at the draws of the linear rows, from which the exact ones are told."""

USUAL = 0.9
"""Share of these draws at which it must be so: some have no path to speak of."""

RIDGE = 1e-6
"""Share of its variance by which a coordinate is known apart from the others, at least."""

FEWEST = 3
"""Draws per coordinate below which their covariance is that of its diagonal alone."""

PATH_ERROR = "path_error"
"""What the statistics of a sampler have besides: the error of each draw's path as `ACCURATE` has it."""


class Sampled(NamedTuple):
    """What a method of integration has led to.

    Attributes:
        drawn: Sites and what follows from them, each [n_chain, n_draw, ...]; empty where paths are not accurate.
        stats: Of the sampler.
        error: Largest error of a path, infinite where there is none.
    """

    drawn: dict[str, np.ndarray]
    stats: dict[str, np.ndarray]
    error: float


class Paths(NamedTuple):
    """Samples on paths at given points, and how accurate they are.

    Attributes:
        method: Of integration.
        course: Segments and rows.
        programs: Compiled.
        predicted: What the samples are called.
    """

    method: Method
    course: Course
    programs: ExactPrograms
    predicted: str

    def sampled(self, known: Known, first: FirstDraws, sampling: Sampling, progress: bool) -> Sampled:
        """Sample on steps that are fine enough.

        Args:
            known: The model's argument on the coarsest grid.
            first: Draws of the linear rows.
            sampling: Settings.
            progress: Whether to show a progress bar.
        """
        points = self.programs.place(first.sites, known)
        points = points[np.all(np.isfinite(points), axis=1)]
        mean, root = _coordinates(points, first.distinct)
        some = points[np.linspace(0, len(points) - 1, TOGETHER - 1).astype(int)]
        fine, error = self._fine(known, np.concatenate([mean[None], some]))
        while fine is not None:
            argument = jnp.asarray(mean), jnp.asarray(root), fine
            chains = self.programs.chains.run(
                argument, draws=sampling.draws, chains=sampling.chains, key=jax.random.PRNGKey(sampling.seed),
                progress=progress,
            )  # fmt: skip
            eta = chains.samples[VECTOR]
            flat = mean + eta.reshape(-1, len(mean)) @ root.T
            told = self.programs.tell(flat, fine)
            errors = self._errors(told[self.predicted], flat, fine)
            error = _worst(errors)
            if error <= ACCURATE:
                drawn = {name: value.reshape(*eta.shape[:2], *value.shape[1:]) for name, value in told.items()}
                return Sampled(drawn, chains.stats | {PATH_ERROR: errors.reshape(eta.shape[:2])}, error)
            fine = self._finer(fine)
        return Sampled({}, {}, error)

    def _fine(self, known: Known, points: Float[np.ndarray, "n u"]) -> tuple[Known | None, float]:
        """The coarsest grid that is fine enough at the mean, which comes first, and usually; and the last error."""
        fine: Known | None = known
        error = math.inf
        while fine is not None:
            errors = self._errors(self.programs.tell(points, fine)[self.predicted], points, fine)
            error = _worst(errors[:1])
            if math.isfinite(error):
                # Some draws of the linear rows have no path at all.
                error = max(error, float(np.nanquantile(errors, USUAL, method="higher")))
            following = self._finer(fine)
            if error <= (ACCURATE if following is None else MARGIN * ACCURATE):
                return fine, error
            fine = following
        return None, error

    def _errors(
        self, rows: Float[np.ndarray, "n n_row"], points: Float[np.ndarray, "n u"], known: Known
    ) -> Float[np.ndarray, " n"]:
        beyond = self.method.beyond(known.likelihood.along.grid)
        return self.course.error(rows, self.programs.tell(points, known.on(beyond))[self.predicted])

    def _finer(self, known: Known) -> Known | None:
        grid = self.method.finer(known.likelihood.along.grid)
        return None if grid is None else known.on(grid)


def _worst(errors: Float[np.ndarray, " n"]) -> float:
    return float(np.max(np.nan_to_num(errors, nan=math.inf)))


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
